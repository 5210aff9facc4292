// The chosen target over the run, or with an unknown number of targets, the chosen track over its life.

import { Latest, ask, runPath } from "./api.js";
import { STATE_TEXT } from "./dwells.js";
import { color, glyph } from "./palette.js";
import { CONFIG, axis, decades, layout, library, lines, measured, tested } from "./plot.js";
import { byId, fixed, make, percent, put, short } from "./text.js";

const EVERY_MS = 1200;
const GAP = 0.035;
const MARGIN = { l: 58, r: 12, t: 6, b: 22 };

export class Course {
  constructor(seek) {
    this.node = byId("course");
    this.seek = seek;
    this.data = null;
    this.latest = new Latest(
      EVERY_MS,
      (run, kind, number) => ask(`${runPath(run)}/course?${kind.name}=${number}`),
      (data, problem) => {
        this.data = data && { ...data, target: data.track ?? data.target };
        this.problem = problem;
        this.draw();
      },
    );
  }

  clear() {
    this.latest.forget();
    this.picture = this.data = this.problem = this.key = null;
    this.blank("");
    byId("course-title").textContent = "";
    byId("facts").replaceChildren();
  }

  show(picture) {
    this.picture = picture;
    const { radar, dwell, target } = picture;
    this.kind = radar.is_unknown ? TRACK : TARGET;
    const key = `${radar.run} ${target}`;
    const isOther = key !== this.key;
    this.key = key;
    if (isOther) {
      this.latest.forget();
      this.data = this.problem = null;
    }
    this.head();
    if (target === null) {
      if (isOther) this.blank(`Click a ${this.kind.name} on the scope or in the table, or press 1 … 9.`);
      return;
    }
    const known = this.data?.t.at(-1) ?? 0;
    const isThere = dwell.targets.some((one) => one.target === target);
    if (isOther || (dwell.t > known && isThere)) this.latest.want(radar.run, this.kind, target);
    this.now();
  }

  // The newest numbers, to be read from afar.
  head() {
    const { kind, picture: { dwell, states, target } } = this;
    const title = byId("course-title");
    const one = dwell.targets.find((found) => found.target === target);
    if (!one) {
      title.textContent = target === null ? `Choose a ${kind.name}` : kind.isNone(target, dwell.t);
      byId("facts").replaceChildren();
      return;
    }
    const text = ` ${kind.title} ${target}: ${STATE_TEXT[states.get(target)]}`;
    if (title.textContent !== text || title.dataset.target !== String(target)) title.replaceChildren(glyph(target), text);
    title.dataset.target = target;
    const at = this.data ? this.data.t.findLastIndex((t) => t <= dwell.t) : -1;
    const facts = kind.facts(one, (name) => (at < 0 ? null : this.data[name][at]));
    const list = byId("facts");
    if (list.dataset.kind !== kind.name) list.replaceChildren();
    list.dataset.kind = kind.name;
    if (!list.children.length) list.append(...facts.map(([name]) => fact(name)));
    facts.forEach(([, value, unit], i) => {
      const [number, small] = list.children[i].lastElementChild.childNodes;
      put(number, value);
      put(small, ` ${unit}`);
    });
  }

  blank(text) {
    window.Plotly?.purge(this.node);
    this.isHeard = false; // its listeners went with the chart
    this.node.replaceChildren(this.marker(), make("p", "message", text));
    this.node.setAttribute("aria-label", text || "No course");
  }

  marker() {
    this.line ??= byId("now");
    this.line.hidden = true;
    return this.line;
  }

  async draw() {
    if (!this.picture || this.picture.target === null) return;
    if (!this.data) {
      if (this.problem) this.blank(`No course: ${this.problem.message}.`);
      return;
    }
    const Plotly = await library();
    if (!Plotly) return;
    const { node, data, picture } = this;
    if (!data || picture?.target !== data.target) return;
    node.querySelector(".message")?.remove();
    const { kind } = this;
    const panels = PANELS.filter(({ column }) => data[column]);
    const line = lines(data);
    await Plotly.react(node, panels.flatMap(({ traces }, i) => traces(data, line, i + 1)), this.shape(panels), CONFIG);
    if (data !== this.data) return;
    if (!node.contains(this.line)) node.append(this.marker());
    if (!this.isHeard) node.on("plotly_click", ({ points }) => this.seek(Math.round(points[0].x)));
    this.isHeard = true;
    this.line.style.height = `${node.clientHeight - MARGIN.b}px`;
    this.head();
    this.now();
    node.setAttribute("aria-label", kind.words(data, data.t.length - 1));
  }

  shape(panels) {
    const tall = (1 - GAP * (panels.length - 1)) / panels.length;
    const { data, kind } = this;
    const more = { margin: MARGIN, xaxis: axis({ range: kind.range(data, this.picture.radar), anchor: `y${panels.length}` }) };
    more.annotations = [{ text: "dwell", xref: "paper", x: 0, xanchor: "right", yref: "paper", y: 0, yanchor: "top", yshift: 1, xshift: -6, showarrow: false }];
    panels.forEach(({ title, scale }, i) => {
      const top = 1 - i * (tall + GAP);
      more[`yaxis${i ? i + 1 : ""}`] = axis({ domain: [Math.max(0, top - tall), top], title: { text: title, font: { size: 13 } }, nticks: 4, rangemode: "normal", ...scale?.(data) });
    });
    return layout(this.node, { ...more, hovermode: "closest" });
  }

  // Where the shown dwell is: a line over the chart, which is not drawn again for it.
  now() {
    const { node, picture, data } = this;
    const line = this.line ?? byId("now");
    const shown = node._fullLayout?.xaxis;
    if (!shown || !data || !node.contains(line)) return;
    const x = shown._offset + shown.l2p(picture.dwell.t);
    line.hidden = x < shown._offset || x > shown._offset + shown._length;
    line.style.transform = `translateX(${x}px)`;
  }
}

function fact(name) {
  const item = make("div");
  const number = make("dd");
  number.append(make("span"), make("small"));
  item.append(make("dt", "", name), number);
  return item;
}

const PROBABILITY = { range: [0, 1.04], tickvals: [0, 0.5, 1] };

// What is drawn, one above the other: the columns that a course has.
const PANELS = [
  { title: "Share %", column: "share", scale: () => ({ rangemode: "tozero" }), traces: (data, line, row) => [line(data.share.map((share) => (share === null ? null : 100 * share)), row)] },
  { title: "SNR dB", column: "snr_db", traces: (data, line, row) => [line(data.snr_db, row)] },
  { title: "Exists", column: "existence", scale: () => PROBABILITY, traces: (data, line, row) => [line(data.existence, row)] },
  { title: "Statistic", column: "statistic", scale: (data) => decades([...data.statistic, ...data.threshold]), traces: (data, line, row) => tested(data, row) },
  {
    title: "P<sub>D</sub>", column: "p_d", scale: () => PROBABILITY,
    traces: (data, line, row) => [
      line(measured(data, data.p_d_low, data.p_d), row, { middle: data.p_d, line: { width: 0 }, hoverinfo: "skip" }),
      line(measured(data, data.p_d_high, data.p_d), row, { middle: data.p_d, line: { width: 0 }, fill: "tonexty", fillcolor: "rgba(128,150,170,0.35)", hoverinfo: "skip" }),
      line(measured(data, data.p_d), row),
    ],
  },
  {
    title: "Error km", column: "error_km", scale: (data) => decades([...data.error_km, ...(data.floor_km ?? [])]),
    traces: (data, line, row) => [
      line(measured(data, data.error_km), row),
      line(measured(data, data.floor_km ?? []), row, { line: { color: color("ink"), width: 1.5, dash: "dash" }, hovertemplate: "floor (of the rms) %{y:.3~g} km<extra></extra>" }),
    ],
  },
];

const TARGET = {
  name: "target",
  title: "Target",
  isNone: (target) => `There is no target ${target}`,
  range: (data, radar) => [1, Math.max(data.t.at(-1) ?? 1, Math.min(radar.dwells ?? 100, 100)) + 1],
  facts: (one, now) => [
    ["Share", percent(one.share), "%"],
    ["SNR", fixed(one.snr_db), "dB"],
    ["P_D so far", fixed(now("p_d"), 3), now("p_d_low") === null ? "" : `${fixed(now("p_d_low"), 2)}–${fixed(now("p_d_high"), 2)}`],
    ["Error", fixed(one.error_km, 2), `km, floor (of the rms) ${fixed(now("floor_km"), 2)}`],
  ],
  words: (data, last) => `Target ${data.target} up to dwell ${data.t[last]}: probability of detection so far ${fixed(data.p_d[last], 3)}, error ${short(data.error_km[last])} km, floor of the root mean square ${short(data.floor_km[last])} km. The table of targets has the numbers of each dwell.`,
};

const TRACK = {
  name: "track",
  title: "Track",
  isNone: (track, t) => `Track ${track} is not there in dwell ${t}`,
  range: (data) => [data.t[0] - 1, Math.max(data.t.at(-1), data.t[0] + 20) + 1],
  facts: (one) => [
    ["Share", percent(one.share), "%"],
    ["Exists", percent(one.existence), one.modes ? `%, turns ${percent(one.modes[1], 0)} %, hard ${percent(one.modes[2], 0)} %` : "%"],
    ["Since", String(one.born_t), "dwell"],
    ["Error", fixed(one.error_km, 2), one.follows === null ? "km" : `km, of target ${one.follows}`],
  ],
  words: (data, last) => `Track ${data.target} from dwell ${data.t[0]} to ${data.t[last]}: existence ${fixed(data.existence[last], 2)}, error ${short(data.error_km[last])} km. The table of tracks has the numbers of each dwell.`,
};
