// The marks of the scope and what they mean.

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
const OF_UNKNOWN = [
  ["tentative", (c) => { c.setLineDash([2.5, 2]); stroke(c, "muted", 1.25, () => trace(c, "circle", 0, 0, 5)); }],
  ["search beam", (c) => { c.setLineDash([3, 2]); stroke(c, "muted", 1, () => { c.moveTo(-8, 7); c.lineTo(2, -8); c.moveTo(-8, 7); c.lineTo(8, -3); }); }],
];

const OF_JAMMERS = [
  ["jammer", (c) => stroke(c, "warn", 3, () => { c.moveTo(-6, 8); c.lineTo(4, -8); })],
  ["blind cell", (c) => { c.setLineDash([2, 2]); stroke(c, "warn", 5, () => c.arc(0, 12, 12, -2.1, -1)); }],
];

function stroke(context, name, width, path) {
  context.strokeStyle = color(name);
  context.lineWidth = width;
  context.beginPath();
  path();
  context.stroke();
}

export function drawLegend(list, isUnknown, hasJammers) {
  const ratio = window.devicePixelRatio || 1;
  const marks = [...MARKS, ...(isUnknown ? OF_UNKNOWN : []), ...(hasJammers ? OF_JAMMERS : [])];
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
