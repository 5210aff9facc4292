// The table beside the scope: what it shows, in words and numbers, and the targets to choose from.

import { STATE_TEXT } from "./dwells.js";
import { glyph } from "./palette.js";
import { byId, fixed, make, percent, put, short } from "./text.js";

const COLUMNS = 7;

export class Tracks {
  constructor(choose) {
    this.choose = choose;
    this.body = byId("tracks").tBodies[0];
    this.rows = new Map();
    this.body.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row) choose(Number(row.dataset.target));
    });
  }

  // Of an unknown number the rows are tracks, which come and go. Without truth there are no errors.
  clear(radar) {
    const isUnknown = radar?.is_unknown;
    this.kind = isUnknown ? "Track" : "Target";
    this.body.replaceChildren();
    this.rows.clear();
    put(byId("tracks-caption"), "");
    put(byId("tracks-title"), `${this.kind}s`);
    const [first, , , fourth] = this.body.parentElement.tHead.rows[0].cells;
    put(first, this.kind);
    this.body.parentElement.classList.toggle("no-truth", radar ? !radar.has_truth : false);
    fourth.replaceChildren(isUnknown ? "Exists" : "SNR", make("br"), make("small", "", isUnknown ? "%" : "dB"));
  }

  // Of a track that has ended the row goes; the others are in the order of their numbers.
  draw({ dwell, states, target }) {
    for (const [number, row] of this.rows) {
      if (states.has(number)) continue;
      row.remove();
      this.rows.delete(number);
    }
    dwell.targets.forEach((one, i) => {
      this.row(one, states.get(one.target), one.threshold ?? dwell.threshold, one.target === target);
      const row = this.rows.get(one.target);
      if (this.body.rows[i] !== row) this.body.insertBefore(row, this.body.rows[i]);
    });
    put(byId("tracks-caption"), (dwell.tracks ? ofTracks : ofTargets)(dwell, [...states.values()]));
  }

  row(one, state, threshold, isChosen) {
    let row = this.rows.get(one.target);
    if (!row) {
      row = this.body.insertRow();
      row.dataset.target = one.target;
      const head = make("th");
      head.scope = "row";
      const button = make("button", "plain", String(one.target));
      button.type = "button";
      button.prepend(glyph(one.target));
      button.setAttribute("aria-label", `${this.kind} ${one.target}`);
      head.append(button);
      row.append(head);
      for (let i = 1; i < COLUMNS; i += 1) row.insertCell();
      this.rows.set(one.target, row);
    }
    const ratio = one.statistic === null ? null : one.statistic / threshold;
    const late = [one.late ? "late" : "", one.stale ? "stale" : "", one.in_doubt ? "in doubt" : ""].filter(Boolean).join(", ");
    const texts = [
      STATE_TEXT[state] + (late ? ` (${late})` : ""),
      percent(one.share),
      one.confirmed === undefined ? fixed(one.snr_db) : percent(one.existence),
      ratio === null ? "–" : `${short(ratio)}×`,
      short(one.error_km),
      fixed(one.beam_deg),
    ];
    for (let i = 0; i < texts.length; i += 1) put(row.cells[i + 1], texts[i]);
    if (row.dataset.state !== state) row.dataset.state = state;
    if (row.classList.contains("chosen") !== isChosen) {
      row.classList.toggle("chosen", isChosen);
      row.querySelector("button").setAttribute("aria-pressed", String(isChosen));
      if (isChosen) reveal(row);
    }
  }
}

const count = (states, state) => states.filter((one) => one === state).length;

function ofTracks({ targets, picture }, states) {
  const confirmed = targets.filter((one) => one.confirmed && !one.is_over).length;
  const tentative = count(states, "tentative");
  const truth = picture.targets === null ? "" : `; ${picture.followed} of ${picture.targets} targets followed`;
  return `${confirmed} confirmed${tentative ? `, ${tentative} tentative` : ""}${truth}`;
}

function ofTargets({ targets }, states) {
  const [lost, absent, unmeasured] = ["lost", "absent", "unmeasured"].map((state) => count(states, state));
  const detected = targets.filter((one) => one.detected).length;
  const truth = targets.some((one) => one.x !== null || one.detected === null) ? "" : " (no truth: a detection is one in the track's bin)";
  const none = unmeasured ? `, ${unmeasured} not measured` : "";
  return `${detected} of ${targets.length - absent - unmeasured} detected${none}${lost ? `, ${lost} lost` : ""}${truth}`;
}

// Scrolls the table, never the page.
function reveal(row) {
  const around = row.closest(".scroll");
  const head = row.closest("table").tHead.offsetHeight;
  if (row.offsetTop - head < around.scrollTop) around.scrollTop = row.offsetTop - head;
  const below = row.offsetTop + row.offsetHeight - around.clientHeight;
  if (below > around.scrollTop) around.scrollTop = below;
}
