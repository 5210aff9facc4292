// The marks of the scope and what they mean.

import { airport } from "./graticule.js";
import { color, trace } from "./palette.js";

const TAU = 2 * Math.PI;
const MARKS = [
  ["truth", (c) => stroke(c, "ink", 1.75, () => { c.moveTo(-8, 0); c.lineTo(-3, 0); c.moveTo(3, 0); c.lineTo(8, 0); c.moveTo(0, -8); c.lineTo(0, -3); c.moveTo(0, 3); c.lineTo(0, 8); })],
  ["detected", (c) => { c.fillStyle = color("muted"); c.beginPath(); trace(c, "circle", 0, 0, 5); c.fill(); }],
  ["not detected", (c) => stroke(c, "muted", 2, () => trace(c, "circle", 0, 0, 5))],
  ["2σ", (c) => stroke(c, "muted", 1.25, () => c.ellipse(0, 0, 8, 4, -0.5, 0, TAU))],
  ["a minute of flight", (c) => { stroke(c, "muted", 2, () => trace(c, "circle", -5, 4, 3)); stroke(c, "muted", 1.25, () => { c.moveTo(-3, 2); c.lineTo(8, -7); }); }],
  ["beam, by power", (c) => {
    c.fillStyle = color("muted"); c.globalAlpha = 0.4;
    c.beginPath(); c.moveTo(-8, 7); c.lineTo(2, -8); c.lineTo(8, -3); c.fill(); c.globalAlpha = 1;
  }],
  ["detected cell", (c) => stroke(c, "ink", 5, () => c.arc(0, 12, 12, -2.1, -1))],
  ["false alarm", (c) => stroke(c, "warn", 2.5, () => { c.moveTo(-5, -5); c.lineTo(5, 5); c.moveTo(-5, 5); c.lineTo(5, -5); })],
  ["lost", (c) => stroke(c, "alarm", 3, () => c.arc(0, 0, 7, 0, TAU))],
];
// What is not in every run, by what makes it occur.
const OCCURRING = {};
OCCURRING.unknown = [
  ["tentative", (c) => { c.setLineDash([2.5, 2]); stroke(c, "muted", 1.25, () => trace(c, "circle", 0, 0, 5)); }],
  ["search beam", (c) => { c.setLineDash([3, 2]); stroke(c, "muted", 1, () => { c.moveTo(-8, 7); c.lineTo(2, -8); c.moveTo(-8, 7); c.lineTo(8, -3); }); }],
];
OCCURRING.jammers = [
  ["jammer", (c) => stroke(c, "warn", 3, () => { c.moveTo(-6, 8); c.lineTo(4, -8); })],
];
OCCURRING.blind = [
  ["blind cell", (c) => { c.setLineDash([2, 2]); stroke(c, "warn", 5, () => c.arc(0, 12, 12, -2.1, -1)); }],
];
OCCURRING.unmeasured = [
  ["cell not measured", (c) => { c.setLineDash([2, 4]); stroke(c, "alarm", 5, () => c.arc(0, 12, 12, -2.1, -1)); }],
];
OCCURRING.blank = [
  ["blanked sector", (c) => stroke(c, "warn", 1.25, () => { for (const x of [-8, -3, 2]) { c.moveTo(x, 7); c.lineTo(x + 6, -7); } })],
];
OCCURRING.double = [
  ["searched twice", (c) => stroke(c, "accent", 1.5, () => { c.arc(0, 12, 14, -2.1, -1); c.moveTo(5.5, 2); c.arc(0, 12, 10, -1, -2.1, true); })],
];
OCCURRING.look = [
  ["commanded look", (c) => { c.setLineDash([6, 2, 1, 2]); stroke(c, "accent", 2, () => { c.moveTo(-6, 8); c.lineTo(4, -8); }); }],
];
OCCURRING.map = [
  ["coast, border", (c) => { c.globalAlpha = 0.7; stroke(c, "muted", 1, () => { c.moveTo(-8, 4); for (const [x, y] of [[-4, 1], [-2, 4], [2, -3], [5, -1], [8, -6]]) c.lineTo(x, y); }); c.globalAlpha = 1; }],
  ["airport", (c) => stroke(c, "muted", 1, () => airport(c, 0, 0))],
];
OCCURRING.pause = [
  ["transmission paused", (c) => stroke(c, "alarm", 4, () => { for (const x of [-4, 4]) { c.moveTo(x, 7); c.lineTo(x, -7); } })],
];

function stroke(context, name, width, path) {
  context.strokeStyle = color(name);
  context.lineWidth = width;
  context.beginPath();
  path();
  context.stroke();
}

// `occurred`: names of OCCURRING.
export function drawLegend(list, occurred) {
  const ratio = window.devicePixelRatio || 1;
  const marks = [...MARKS, ...Object.keys(OCCURRING).flatMap((name) => (occurred.has(name) ? OCCURRING[name] : []))];
  list.replaceChildren(...marks.map(([text, draw]) => {
    const item = document.createElement("li");
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 18 * ratio;
    canvas.setAttribute("aria-hidden", "true");
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.translate(9, 9);
    draw(context);
    item.append(canvas, text);
    return item;
  }));
}
