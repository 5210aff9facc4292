// The timeline under everything: how the whole run went, where it is shown, and the buttons.

import { Latest, ask, runPath } from "./api.js";
import { color } from "./palette.js";
import { byId, put, short } from "./text.js";
import { SPEEDS } from "./view.js";

const EVERY_MS = 2000;
const THUMB = 8; // px: half of the slider's thumb, which its ends are inset by

export class Timeline {
  constructor(player, { chooseSpeed, toggle, seek, live }) {
    this.player = player;
    [this.scrub, this.strip, this.button, this.liveButton, this.speed] =
      ["scrub", "strip", "play", "live", "speed"].map(byId);
    this.key = byId("strip-key");
    [this.oldest, this.end] = [1, 1];
    this.buckets = [];
    this.planned = 1;
    this.latest = new Latest(EVERY_MS, (run) => ask(`${runPath(run)}/timeline`), (answer) => this.answered(answer));
    this.scrub.addEventListener("input", () => seek(Number(this.scrub.value)));
    this.button.addEventListener("click", toggle);
    this.liveButton.addEventListener("click", live);
    this.speed.addEventListener("change", () => chooseSpeed(Number(this.speed.value)));
    for (const name of ["pointerdown", "pointermove"]) {
      this.strip.addEventListener(name, (event) => {
        if (event.buttons !== 1) return;
        const share = (event.offsetX - THUMB) / Math.max(1, this.strip.clientWidth - 2 * THUMB);
        seek(Math.round(this.oldest + Math.min(Math.max(share, 0), 1) * (this.axis() - this.oldest)));
      });
    }
    new ResizeObserver(() => this.draw()).observe(this.strip);
  }

  reset(run, planned, isUnknown) {
    put(this.key.children[0], isUnknown ? "targets without a track" : "not detected");
    put(this.key.children[1], isUnknown ? "swapped" : "lost");
    this.buckets = [];
    this.planned = planned;
    this.since(1);
    this.run = run;
    this.latest.forget();
    this.refresh();
    this.moved();
    this.draw();
  }

  refresh() {
    if (this.run) this.latest.want(this.run);
  }

  // The oldest dwell that is kept: those of a run without an end are cut behind it.
  since(oldest) {
    this.oldest = this.player.oldest = oldest;
    this.scrub.min = oldest;
  }

  answered(answer) {
    if (!answer) return; // the slider does without
    if (answer.oldest_t !== this.oldest) this.since(answer.oldest_t);
    this.buckets = answer.first.map((first, i) => ({
      first, last: answer.last[i], detected: answer.detected[i], lost: answer.lost[i], late: answer.late[i], stale: answer.stale[i],
      error_km: answer.error_km[i], missed: answer.missed[i], swaps: answer.swaps[i],
    }));
    this.draw();
  }

  // The end of the axis: the planned one, but a run of a million dwells does not begin as a dot.
  axis() {
    let end = 1000;
    while (end < this.player.newest) end *= 2;
    return Math.max(1, Math.min(end, Math.max(this.planned, this.player.newest)));
  }

  moved() {
    const { player, scrub } = this;
    const end = this.axis();
    if (end !== this.end) {
      this.end = end;
      scrub.max = end;
      this.draw();
    }
    scrub.disabled = player.newest < 1;
    if (scrub.value !== String(player.t)) scrub.value = player.t;
    scrub.setAttribute("aria-valuetext", `dwell ${player.t} of ${player.newest}`);
    this.turned();
  }

  turned() {
    const { player } = this;
    put(this.button, player.mode === "playing" || (player.mode === "live" && player.isRunning) ? "Freeze" : "Play");
    this.button.disabled = player.newest < 1;
    this.liveButton.hidden = !player.isRunning;
    this.liveButton.classList.toggle("on", player.mode === "live");
    this.liveButton.setAttribute("aria-pressed", String(player.mode === "live"));
    if (SPEEDS.includes(player.speed)) this.speed.value = player.speed;
  }

  // What went wrong: targets not detected, as a height; lost tracks over all of it; late and stale plans at the foot.
  // The line is the largest error. Of an unknown number: targets without a track, and tracks that were swapped.
  draw() {
    const { strip, oldest, end, player } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [strip.clientWidth, strip.clientHeight];
    strip.width = Math.round(width * ratio);
    strip.height = Math.round(height * ratio);
    const context = strip.getContext("2d");
    context.scale(ratio, ratio);
    const inner = width - 2 * THUMB;
    const x = (t) => THUMB + (end > oldest ? ((Math.max(t, oldest) - oldest) / (end - oldest)) * inner : 0);
    context.fillStyle = color("band");
    context.fillRect(THUMB, 0, Math.max(0, x(player.newest) - THUMB), height);
    this.buckets.forEach(({ first }, i) => {
      const ended = x((this.buckets[i - 1]?.last ?? oldest - 1) + 0.5);
      if (this.isBroken(i)) context.clearRect(ended, 0, x(first - 0.5) - ended, height);
    });
    const bar = ({ first, last }, share, ink, top) => {
      const left = Math.max(THUMB, x(first - 0.5));
      context.fillStyle = color(ink);
      context.fillRect(left, top ?? height - share * height, Math.max(2, x(last + 0.5) - left), share * height);
    };
    for (const one of this.buckets) {
      if (one.detected !== null && one.detected < 1) bar(one, 1 - one.detected, "bar");
      if (one.missed) bar(one, one.missed, "bar");
      if (one.lost || one.swaps) bar(one, 1, "alarm");
      if (one.late || one.stale) bar(one, 0.15, "warn");
    }
    this.errors(context, x, height);
  }

  // Whether dwells are missing before a bucket.
  isBroken(i) {
    return this.buckets[i].first > (this.buckets[i - 1]?.last ?? this.oldest - 1) + 1;
  }

  errors(context, x, height) {
    const known = this.buckets.filter((one) => one.error_km !== null);
    const most = Math.max(...known.map((one) => one.error_km), 1e-9);
    context.beginPath();
    this.buckets.forEach(({ first, last, error_km: error }, i) => {
      if (error === null) return;
      const follows = i && !this.isBroken(i) && this.buckets[i - 1].error_km !== null;
      context[follows ? "lineTo" : "moveTo"](x((first + last) / 2), height - 2 - (error / most) * (height - 5));
    });
    context.lineWidth = 1.25;
    context.strokeStyle = color("ink");
    context.stroke();
    this.key.hidden = !this.buckets.length;
    put(this.key.lastElementChild, known.length ? `error, up to ${short(most)} km` : "");
  }
}
