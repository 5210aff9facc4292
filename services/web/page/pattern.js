// Power over angle of the dwell that is shown, in dB, and the bins of the targets.

import { Latest, ask, runPath } from "./api.js";
import { CONFIG, axis, layout, library } from "./plot.js";
import { color, colorOf, symbolOf } from "./palette.js";
import { byId, fixed, make } from "./text.js";

const EVERY_MS = 450;
const MANY = 30; // targets, with which the library takes so long that the scope would wait for it
const MANY_EVERY_MS = 1200;
const ABOVE_DB = 2.5; // the numbers of targets
const NUMBER_PX = 5.5; // half the width of a digit, with what must be free beside it
const NUMBER_DB = 10; // the height of a number
const DEEP_DB = 45; // below the highest power nothing is of interest
const MARGIN = { l: 56, r: 18, t: 12, b: 24 };

export class Pattern {
  constructor() {
    this.node = byId("pattern");
    this.data = null;
    this.latest = new Latest(
      EVERY_MS,
      (run, t) => ask(`${runPath(run)}/beampattern?dwell=${t}`),
      (data, problem) => {
        this.data = data;
        this.problem = problem;
        if (problem) this.key = null;
        this.draw();
      },
    );
  }

  clear() {
    this.latest.forget();
    this.data = this.problem = this.key = null;
    this.blank("");
  }

  blank(text) {
    window.Plotly?.purge(this.node);
    this.node.replaceChildren(make("p", "message", text));
    this.node.setAttribute("aria-label", text || "Beampattern");
  }

  show({ radar, dwell, target }) {
    this.target = target;
    this.kind = radar.is_unknown ? "track" : "target";
    this.latest.everyMs = dwell.targets.length > MANY ? MANY_EVERY_MS : EVERY_MS;
    const key = `${radar.run} ${dwell.t}`;
    if (dwell.isotropic === null) {
      this.latest.forget();
      this.data = null;
      this.problem = { message: "the waveform of this dwell is not stored" };
      this.draw();
    } else if (key === this.key) this.draw();
    else this.latest.want(radar.run, dwell.t);
    this.key = key;
  }

  async draw() {
    if (!this.data && !this.problem) return;
    const Plotly = await library();
    if (!Plotly) return;
    const { data, node, target, kind } = this;
    if (!data) {
      if (this.problem) this.blank(`No beampattern: ${this.problem.message}.`);
      return;
    }
    node.querySelector(".message")?.remove();
    const top = 5 * Math.ceil(Math.max(...data.power_db) / 5); // an axis that does not jump
    const targets = data.beams.map((one) => ({ ...one, target: one[kind] })).filter((one) => one.target !== null);
    const width = node.clientWidth - MARGIN.l - MARGIN.r;
    const named = withNumbers(targets, target, width);
    const searched = data.search;
    const ink = (one) => (one.hit === false ? color("alarm") : colorOf(one.target));
    const traces = [
      { x: [-90, 90], y: [top - DEEP_DB, top - DEEP_DB], mode: "lines", line: { width: 0 }, hoverinfo: "skip" },
      {
        ...highest(data, width), mode: "lines", line: { color: color("ink"), width: 1.25 },
        fill: "tonexty", fillcolor: "rgba(128,150,170,0.18)", hovertemplate: "%{y:.1f} dB at %{x:.1f}°<extra></extra>",
      },
      {
        x: targets.map((one) => one.angle_deg), y: targets.map((one) => one.power_db), mode: "markers",
        marker: {
          size: targets.map((one) => (one.target === target ? 13 : 10)), opacity: 1,
          symbol: targets.map((one) => symbolOf(one.target)), color: targets.map(ink),
          line: { width: targets.map((one) => (one.target === target ? 2 : 0)), color: color("ink") },
        },
        hovertemplate: `${kind} %{customdata}: %{y:.1f} dB at %{x:.1f}°<extra></extra>`, customdata: targets.map((one) => one.target),
        cliponaxis: false,
      },
      {
        x: searched.map((one) => one.angle_deg), y: searched.map((one) => one.power_db), mode: "markers",
        marker: { size: 9, symbol: "line-ns-open", color: color("muted"), line: { width: 2 } },
        hovertemplate: "search: %{y:.1f} dB at %{x:.1f}°<extra></extra>",
      },
      {
        x: named.map((one) => one.angle_deg), y: named.map((one) => one.power_db + ABOVE_DB), mode: "text",
        text: named.map((one) => `<b>${one.target}</b>`), textposition: "top center", hoverinfo: "skip",
        textfont: { size: 14, color: named.map(ink) }, cliponaxis: false,
      },
    ];
    const shape = layout(node, {
      margin: MARGIN,
      xaxis: axis({ range: [-90, 90], dtick: 30, ticksuffix: "°" }),
      yaxis: axis({ range: [top - DEEP_DB, top + 10], ticksuffix: " dB", dtick: 15 }),
    });
    await Plotly.react(node, traces, shape, CONFIG);
    if (data !== this.data) return;
    const strongest = targets.map((one) => `${kind} ${one.target} ${fixed(one.power_db)} dB at ${fixed(one.angle_deg)}°`);
    node.setAttribute("aria-label", `Beampattern of dwell ${data.t}: ${strongest.slice(0, 12).join("; ")}`);
  }
}

// Beams with a number: of each target one, and where numbers would cover each other the one of the target that is chosen,
// or else of the strongest.
export function withNumbers(beams, chosen, width) {
  const rank = (one) => one.power_db + (one.target === chosen ? 1000 : 0);
  const half = (one) => (180 * NUMBER_PX * String(one.target).length) / width;
  const found = [];
  for (const one of [...beams].sort((a, b) => rank(b) - rank(a))) {
    const covers = (other) => Math.abs(other.angle_deg - one.angle_deg) < half(other) + half(one) && Math.abs(other.power_db - one.power_db) < NUMBER_DB;
    if (!found.some((other) => other.target === one.target || covers(other))) found.push(one);
  }
  return found;
}

// The highest power in each column of pixels. Many beams have nulls narrower than that: drawn sample by sample, some are
// seen and some not, and lobes seem to be where none are.
function highest({ angle_deg: angles, power_db: powers }, width) {
  const found = { x: [], y: [] };
  const columnOf = (angle) => Math.floor(((angle + 90) / 180) * width);
  angles.forEach((angle, i) => {
    const last = found.x.length - 1;
    const isNew = last < 0 || columnOf(angle) !== columnOf(found.x[last]);
    if (isNew || powers[i] > found.y[last]) [found.x[last + isNew], found.y[last + isNew]] = [angle, powers[i]];
  });
  return found;
}
