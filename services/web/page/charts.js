// The charts beside the scope. Their library comes once the scope is there: it is large.

import { color, colorOf, onTheme } from "./palette.js";
import { History } from "./history.js";
import { Pattern } from "./pattern.js";

const LIBRARY = "/page/plotly.min.js";
export const CONFIG = { displayModeBar: false, responsive: false, doubleClick: false, showTips: false };

let loading = null;

// The library, or null if it cannot be had now: whoever draws next asks again.
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

// A line of a course over dwells, `row` from 1, in the colour of its target or track.
export const lines = (data) => (y, row, more = {}) => ({
  x: data.t, y, yaxis: `y${row === 1 ? "" : row}`, mode: "lines", line: { color: colorOf(data.target), width: 1.75 },
  hovertemplate: "%{y:.3~g} at dwell %{x}<extra></extra>", ...more,
});

export class Charts {
  // `seek(t)` goes to a dwell that was clicked on.
  constructor(seek) {
    this.pattern = new Pattern();
    this.history = new History(seek);
    onTheme(() => this.redraw());
    const sizes = new ResizeObserver(() => this.redraw());
    for (const chart of [this.pattern, this.history]) sizes.observe(chart.node);
  }

  // Another run: nothing of the one before stays.
  clear() {
    this.pattern.clear();
    this.history.clear();
  }

  // What is not seen is not drawn.
  show(picture) {
    this.pattern.show(picture);
    this.history.show(picture);
  }

  redraw() {
    if (!this.pattern.node.clientWidth) return;
    this.pattern.draw();
    this.history.draw();
  }
}
