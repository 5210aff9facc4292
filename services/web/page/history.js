// The chosen target over the run: share, SNR, statistic against threshold, P_D so far, error against its floor. Where
// nobody knows how many targets there are, the chosen track over its life (`life.js`).

import { Latest, ask, runPath } from "./api.js";
import { STATE_TEXT } from "./dwells.js";
import { LIFE } from "./life.js";
import { color, colorOf, glyph } from "./palette.js";
import { CONFIG, axis, decades, layout, library, lines, tested } from "./plot.js";
import { byId, fixed, make, percent, put, short } from "./text.js";

const EVERY_MS = 1200;
const GAP = 0.035;
const MARGIN = { l: 58, r: 12, t: 6, b: 22 };

export class History {
  constructor(seek) {
    this.node = byId("history");
    this.seek = seek;
    this.data = null;
    this.latest = new Latest(
      EVERY_MS,
      (run, kind, number) => ask(`${runPath(run)}/${kind === LIFE ? "life?track" : "history?target"}=${number}`),
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
    byId("history-title").textContent = "";
    byId("facts").replaceChildren();
  }

  show(picture) {
    this.picture = picture;
    const { radar, dwell, target } = picture;
    const key = `${radar.run} ${target}`;
    const isOther = key !== this.key;
    this.key = key;
    if (isOther) {
      this.latest.forget();
      this.data = this.problem = null;
    }
    this.head();
    if (target === null) {
      if (isOther) this.blank(`Click a ${radar.is_unknown ? "track" : "target"} on the scope or in the table, or press 1 … 9.`);
      return;
    }
    const known = this.data?.t.at(-1) ?? 0;
    this.kind = radar.is_unknown ? LIFE : COURSE;
    if (isOther || this.kind.goesOn(dwell, target, known)) this.latest.want(radar.run, this.kind, target);
    this.now();
  }

  // The newest numbers, to be read from afar.
  head() {
    const { radar, dwell, states, target } = this.picture;
    const kind = radar.is_unknown ? LIFE : COURSE;
    const title = byId("history-title");
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
    this.isHeard = false; // whoever listened to the chart went with it
    this.node.replaceChildren(this.marker(), make("p", "message", text));
    this.node.removeAttribute("aria-label");
  }

  marker() {
    this.line ??= byId("now");
    this.line.hidden = true;
    return this.line;
  }

  async draw() {
    if (!this.picture || this.picture.target === null) return;
    if (!this.data) {
      if (this.problem) this.blank(`No history: ${this.problem.message}.`);
      return;
    }
    const Plotly = await library();
    if (!Plotly) return;
    const { node, data, picture } = this;
    if (!data || picture?.target !== data.target) return;
    node.querySelector(".message")?.remove();
    const { kind } = this;
    await Plotly.react(node, kind.traces(data), this.shape(kind), CONFIG);
    if (data !== this.data) return;
    if (!node.contains(this.line)) node.append(this.marker());
    if (!this.isHeard) node.on("plotly_click", ({ points }) => this.seek(points[0].x));
    this.isHeard = true;
    this.line.style.height = `${node.clientHeight - MARGIN.b}px`;
    this.head();
    this.now();
    node.setAttribute("aria-label", kind.words(data, data.t.length - 1));
  }

  shape(kind) {
    const rows = kind.rows;
    const tall = (1 - GAP * (rows.length - 1)) / rows.length;
    const { data } = this;
    const more = { margin: MARGIN, xaxis: axis({ range: kind.range(data, this.picture.radar), anchor: `y${rows.length}` }) };
    more.annotations = [{ text: "dwell", xref: "paper", x: 0, xanchor: "right", yref: "paper", y: 0, yanchor: "top", yshift: 1, xshift: -6, showarrow: false }];
    rows.forEach((title, i) => {
      const top = 1 - i * (tall + GAP);
      more[`yaxis${i ? i + 1 : ""}`] = axis({ domain: [Math.max(0, top - tall), top], title: { text: title, font: { size: 13 } }, nticks: 4, rangemode: "normal" });
    });
    more.yaxis.rangemode = "tozero";
    Object.assign(more.yaxis3, decades([...data.statistic, ...data.threshold]));
    kind.scale(more, data);
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

function traces(data) {
  const line = lines(data);
  return [
    line(data.share.map((share) => (share === null ? null : 100 * share)), 1),
    line(data.snr_db, 2),
    ...tested(data, 3, { line: { color: colorOf(data.target), width: 1 } }),
    line(data.p_d_low, 4, { line: { width: 0 }, hoverinfo: "skip" }),
    line(data.p_d_high, 4, { line: { width: 0 }, fill: "tonexty", fillcolor: "rgba(128,150,170,0.35)", hoverinfo: "skip" }),
    line(data.p_d, 4),
    line(data.error_km, 5),
    line(data.floor_km, 5, { line: { color: color("ink"), width: 1.5, dash: "dash" }, hovertemplate: "floor (of the rms) %{y:.3~g} km<extra></extra>" }),
  ];
}

// A target.
const COURSE = {
  name: "target",
  title: "Target",
  rows: ["Share %", "SNR dB", "Statistic", "P<sub>D</sub>", "Error km"],
  traces,
  isNone: (target) => `There is no target ${target}`,
  goesOn: (dwell, target, known) => dwell.t > known,
  range: (data, radar) => [1, Math.max(data.t.at(-1) ?? 1, Math.min(radar.dwells, 100)) + 1],
  scale(shape, data) {
    Object.assign(shape.yaxis5, decades([...data.error_km, ...data.floor_km]));
    Object.assign(shape.yaxis4, { range: [0, 1.04], tickvals: [0, 0.5, 1] });
  },
  facts: (one, now) => [
    ["Share", percent(one.share), "%"],
    ["SNR", fixed(one.snr_db), "dB"],
    ["P_D so far", fixed(now("p_d"), 3), now("p_d_low") === null ? "" : `${fixed(now("p_d_low"), 2)}–${fixed(now("p_d_high"), 2)}`],
    ["Error", fixed(one.error_km, 2), `km, floor (of the rms) ${fixed(now("floor_km"), 2)}`],
  ],
  words: (data, last) => `Target ${data.target} up to dwell ${data.t[last]}: probability of detection so far ${fixed(data.p_d[last], 3)}, error ${short(data.error_km[last])} km, floor of the root mean square ${short(data.floor_km[last])} km. The table of targets has the numbers of each dwell.`,
};
