// Two runs over their dwells: the one that is shown, and another one that was chosen beside it.

import { Latest, ask, runPath } from "./api.js";
import { color, onTheme } from "./palette.js";
import { CONFIG, axis, layout, library, parted } from "./plot.js";
import { byId, put, short } from "./text.js";
import { show } from "./view.js";

const EVERY_MS = 2000;
const GAP = 0.06;
// One above the other: what any of the two runs has.
const PANELS = [
  ["Detected %", (one) => percents(one.detected)],
  ["Tracked %", (one) => percents(one.missed.map((share) => (share === null ? null : 1 - share)))],
  ["GOSPA km", (one) => one.gospa_km],
  ["Error km", (one) => one.error_km],
];

const percents = (shares) => shares.map((share) => (share === null ? null : 100 * share));

export class Compare {
  // `seek(t)` goes to a dwell that was clicked on; `rows()` are the runs that are known.
  constructor(seek, rows) {
    Object.assign(this, { rows, panel: byId("compare-panel"), node: byId("compare"), seek, pair: null, answers: null });
    const both = (...runs) => Promise.all(runs.map((run) => ask(`${runPath(run)}/timeline`)));
    this.latest = new Latest(EVERY_MS, both, (answers, problem) => {
      put(byId("compare-caption"), problem ? `${problem.message}` : "");
      if (answers) this.answers = answers;
      this.names();
      this.draw();
    });
    byId("compare-end").addEventListener("click", () => show({ beside: null }));
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.node);
  }

  // These two runs; none, if one is missing or both are the same.
  show(run, other, isSeen) {
    const key = run === null || other === null || run === other || !isSeen ? null : `${run} ${other}`;
    this.panel.hidden = key === null;
    if (key === null) this.latest.forget();
    else this.latest.want(run, other);
    if (key === this.key) return;
    Object.assign(this, { key, answers: null, pair: [run, other] });
    this.names();
    window.Plotly?.purge(this.node);
    this.isHeard = false;
    put(byId("compare-caption"), "Loading …");
  }

  // What tells the two apart beside their names.
  names() {
    for (const [id, run] of [["compare-first", this.pair[0]], ["compare-second", this.pair[1]]]) {
      const row = this.rows().find((one) => one.run === run);
      put(byId(id), row ? `${run}: ${row.strategy}, seed ${row.seed}` : run);
    }
  }

  async draw() {
    if (this.panel.hidden || !this.answers) return;
    const Plotly = await library();
    const { answers, node } = this;
    if (!Plotly || !answers || this.panel.hidden) return;
    const panels = PANELS.filter(([, of]) => answers.some((one) => of(one).some((value) => value !== null)));
    if (!panels.length) {
      put(byId("compare-caption"), "Neither run has scores: they need dwells, and truth.");
      return;
    }
    const tall = (1 - GAP * (panels.length - 1)) / panels.length;
    const more = { margin: { l: 62, r: 12, t: 6, b: 34 }, hovermode: "closest", xaxis: axis({ anchor: `y${panels.length > 1 ? panels.length : ""}`, title: { text: "dwell", font: { size: 13 } } }) };
    panels.forEach(([title], i) => {
      const top = 1 - i * (tall + GAP);
      more[`yaxis${i ? i + 1 : ""}`] = axis({ domain: [Math.max(0, top - tall), top], title: { text: title, font: { size: 13 } }, nticks: 4, rangemode: "tozero" });
    });
    const traces = panels.flatMap(([title, of], i) => answers.map((one, which) => ({
      ...parted(one.first.map((first, j) => (first + one.last[j]) / 2), of(one), (j) => one.first[j] > one.last[j - 1] + 1), yaxis: `y${i ? i + 1 : ""}`, mode: "lines",
      line: { color: color(which ? "warn" : "accent"), width: which ? 1.5 : 2, dash: which ? "dash" : "solid" },
      hovertemplate: `${title} %{y:.3~g} at dwell %{x:.0f}<extra>${one.run}</extra>`,
    })));
    await Plotly.react(node, traces, layout(node, more), CONFIG);
    if (!this.isHeard) node.on("plotly_click", ({ points }) => this.seek(Math.round(points[0].x)));
    this.isHeard = true;
    node.setAttribute("aria-label", `${panels.map(([title]) => title).join(", ")} of both runs over their dwells. ${answers.map(words).join(" ")}`);
  }
}

// A run's means over all of its dwells.
function words(one) {
  const parts = PANELS.map(([title, of]) => {
    const known = of(one).filter((value) => value !== null);
    return known.length ? `${title} ${short(known.reduce((sum, value) => sum + value, 0) / known.length)}` : null;
  });
  return `${one.run}: ${parts.filter(Boolean).join(", ") || "no scores"}.`;
}
