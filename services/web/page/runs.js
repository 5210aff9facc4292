// The runs that there are: a table to choose from, and which of them is the newest.

import { Latest, ask } from "./api.js";
import { byId, make, noMatch, put } from "./text.js";
import { link, show, view } from "./view.js";

const MOST = 300; // rows of the table
const PAGES = 50; // of a thousand runs
const EVERY_MS = 3000;

// The runs in the order in which they began. Of those that are known, only what may have changed is asked for again: from
// the first that goes on, or the last. If another one stands in its place now, others are gone, and all are asked for.
async function allRuns(known) {
  const goesOn = known.findIndex((row) => row.status === "running");
  const from = Math.max(0, goesOn < 0 ? known.length - 1 : goesOn);
  const rows = known.slice(0, from);
  for (let page = 0; page < PAGES; page += 1) {
    const answer = await ask(`/runs?offset=${rows.length}`);
    if (!page && from && answer.rows[0]?.run !== known[from].run) return allRuns([]);
    rows.push(...answer.rows);
    if (!answer.next) break;
  }
  return rows;
}

// What a page without a run begins with: one that goes on, else the last one.
export const newestOf = (rows) => rows.find((row) => row.status === "running") ?? rows[0] ?? null;

export class Runs {
  // `told(rows, problem)` is called with every answer.
  constructor(told) {
    this.known = [];
    this.rows = []; // newest first
    this.body = byId("run-table").tBodies[0];
    this.latest = new Latest(EVERY_MS, () => allRuns(this.known), (known, problem) => {
      if (known) [this.known, this.rows] = [known, known.toReversed()];
      if (view.view === "runs") this.draw(problem);
      told(this.rows, problem);
    });
    byId("find").addEventListener("input", () => this.draw(null));
    this.body.addEventListener("click", ({ target }) => {
      const { beside } = target.closest("button")?.dataset ?? {};
      if (beside) show({ beside: beside === view.beside ? null : beside });
    });
  }

  refresh() {
    this.latest.want();
  }

  draw(problem) {
    const words = byId("find").value.toLowerCase().split(/\s+/).filter(Boolean);
    const text = (row) => `${row.run} ${row.scenario} ${row.strategy} ${row.seed} ${resultOf(row)}`.toLowerCase();
    const found = this.rows.filter((row) => words.every((word) => text(row).includes(word)));
    const goOn = this.rows.filter((row) => row.status === "running").length;
    put(byId("runs-caption"), problem ? `${problem.message}: this is what was there before` : `${this.rows.length} stored, ${goOn} live`);
    const focused = document.activeElement?.closest("tr")?.dataset.run;
    const on = document.activeElement?.matches("button") ? "button" : "a";
    this.body.replaceChildren(...found.slice(0, MOST).map(rowOf));
    if (focused) this.body.querySelector(`tr[data-run="${CSS.escape(focused)}"] ${on}`)?.focus();
    const left = found.length - MOST;
    put(byId("runs-more"), left > 0 ? `${left} more: narrow them down with Find.` : this.rows.length || problem ? "" : "No run yet. In a terminal: cogradar run paper --keep");
    noMatch(byId("runs-none"), this.rows.length && !found.length, "run", byId("find"));
  }
}

function rowOf(row) {
  const line = make("tr");
  line.dataset.run = row.run;
  line.dataset.status = row.status;
  if (row.run === view.run) line.className = "chosen";
  const head = make("th");
  head.scope = "row";
  const anchor = make("a", "", row.run);
  anchor.href = link({ run: row.run, follows: false, view: "radar", dwell: null, target: null, zoom: 1, particles: false });
  anchor.dataset.run = row.run;
  head.append(anchor);
  line.append(head);
  const dwells = row.dwells === null ? `${row.t}, no end` : `${row.t} of ${row.dwells}`;
  const texts = [resultOf(row), clock(row.began), span(row.length_s), row.scenario, row.strategy, String(row.seed), dwells, String(row.targets)];
  for (const text of texts) line.append(make("td", "", text));
  line.cells[2].title = row.ended === null ? `began ${row.began}` : `began ${row.began}, ended ${row.ended}`;
  const beside = make("button", "", "Compare");
  beside.type = "button";
  beside.dataset.beside = row.run;
  beside.disabled = row.run === view.run;
  beside.title = beside.disabled ? "This run is the one that is shown" : `Draw it beside ${view.run ?? "a run"}`;
  beside.setAttribute("aria-label", `Compare with ${row.run}`);
  beside.setAttribute("aria-pressed", String(row.run === view.beside && !beside.disabled));
  line.append(make("td"));
  line.lastElementChild.append(beside);
  return line;
}

// How a run ended, or that it goes on.
export function resultOf({ status, reason }) {
  if (status === "running") return "live";
  if (status === "stopped") return `stopped ${reason}`;
  return reason ? `${status}: ${reason}` : status;
}

// When, by the clock of the browser: the time, and of another day the date.
function clock(utc) {
  const when = new Date(utc);
  const time = when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return when.toDateString() === new Date().toDateString() ? time : `${when.toLocaleDateString()} ${time}`;
}

function span(seconds) {
  const whole = Math.round(seconds);
  const two = (value) => String(value).padStart(2, "0");
  const minutes = `${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
  return whole < 3600 ? minutes : `${Math.floor(whole / 3600)}:${minutes}`;
}
