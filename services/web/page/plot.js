// What all charts are drawn with: their library, which is large and comes once the scope is there, their axes and lines.

import { color, colorOf } from "./palette.js";

const LIBRARY = "/page/plotly.min.js";
export const CONFIG = { displayModeBar: false, responsive: false, doubleClick: false, showTips: false };

let loading = null;

// The library, or null if it cannot be had now: the next drawing asks again.
export function library() {
  loading ??= new Promise((resolve) => {
    const script = document.createElement("script");
    script.src = LIBRARY;
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => {
      loading = null;
      script.remove();
      resolve(null);
    };
    document.head.append(script);
  });
  return loading;
}

// What all charts look like; an axis adds to `axis()`.
export function layout(node, more) {
  return {
    width: Math.max(60, node.clientWidth),
    height: Math.max(60, node.clientHeight),
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: color("font"), size: 13, color: color("muted") },
    showlegend: false,
    hovermode: "x",
    hoverlabel: { font: { size: 13 } },
    dragmode: false,
    ...more,
  };
}

export const axis = (more) => ({
  gridcolor: color("line"),
  linecolor: color("line"),
  zeroline: false,
  fixedrange: true,
  ticks: "",
  tickfont: { size: 12 },
  ...more,
});

const STUB = 0.4; // dwells: of a line that has one dwell, which would not be seen

// Values over dwells with a break where `isBroken(i)` says that one does not follow the one before: a line does not go
// across, and an area whose edges meet in `middle` there has no height.
export function parted(x, y, isBroken, middle = null) {
  const found = { x: [], y: [] };
  const add = (at, value) => (found.x.push(at), found.y.push(value));
  const isEnd = (i) => i === 0 || i === y.length || isBroken(i);
  y.forEach((value, i) => {
    if (i && isBroken(i)) for (const j of middle ? [i - 1, i] : [i]) add(x[j], middle ? middle[j] : null);
    add(x[i], value);
    if (!middle && isEnd(i) && isEnd(i + 1)) add(x[i] + STUB, value);
  });
  return found;
}

// A line of a course over dwells, `row` from 1, in the colour of its target or track. It breaks where dwells are missing,
// and where measuring ended or began again, as in a pause of the transmission.
export function lines(data) {
  const isBroken = (i) => data.t[i] - data.t[i - 1] > data.every || isMeasured(data, i) !== isMeasured(data, i - 1);
  return (y, row, { middle, ...more } = {}) => ({
    ...(more.mode === "markers" ? { x: data.t, y } : parted(data.t, y, isBroken, middle)), yaxis: `y${row === 1 ? "" : row}`, mode: "lines", line: { color: colorOf(data.target), width: 1.75 },
    hovertemplate: "%{y:.3~g} at dwell %{x:.0f}<extra></extra>", ...more,
  });
}

const isMeasured = (data, i) => data.detected[i] !== null;

// Scores of the dwells that were measured: the others are none of theirs; `instead` stands for them.
export const measured = (data, y, instead = null) => y.map((value, i) => (isMeasured(data, i) ? value : instead && instead[i]));

// The statistic against its threshold, with a cross where it was not detected.
export function tested(data, row) {
  const line = lines(data);
  const alarm = color("alarm");
  return [
    line(data.statistic, row, { line: { color: colorOf(data.target), width: 1 } }),
    line(data.statistic.map((value, i) => (data.detected[i] === false ? value ?? data.threshold[i] : null)), row, { mode: "markers", marker: { color: alarm, size: 6, symbol: "x-thin", line: { width: 2, color: alarm } }, hovertemplate: "not detected at dwell %{x}<extra></extra>" }),
    line(measured(data, data.threshold), row, { line: { color: color("ink"), width: 1.5, dash: "dash" }, hovertemplate: "threshold %{y:.3~g}<extra></extra>" }),
  ];
}

// A logarithmic axis with a few round numbers.
export function decades(values) {
  const logs = values.filter((value) => value > 0).map(Math.log10);
  const [low, high] = logs.length ? [Math.min(...logs) - 0.1, Math.max(...logs) + 0.1] : [0, 1];
  const steps = high - low > 2.4 ? [1] : high - low > 1.1 ? [1, 3] : [1, 2, 5];
  const tickvals = [];
  for (let power = Math.floor(low); power <= high; power += 1) tickvals.push(...steps.map((step) => step * 10 ** power));
  return { type: "log", range: [low, high], tickvals, ticktext: tickvals.map((value) => (value >= 1e4 ? value.toExponential(0).replace("e+", "e") : String(Number(value.toPrecision(1))))) };
}
