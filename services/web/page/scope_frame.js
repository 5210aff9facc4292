// Where the half-plane lies on its canvas, and its range rings and angles. x points up (broadside), y to the right.

import { color } from "./palette.js";

const EDGE = 18; // px around the half-plane: cells on the rim, angles
const FOOT = 16;

// Sizes the canvas to its place; `at` maps km to px, `scale` is px per km.
export function fit(canvas, { range, dwell, target, zoom }) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const whole = Math.min((width / 2 - EDGE - 14) / range, (height - EDGE - FOOT - 12) / range);
  const scale = whole * zoom;
  const one = zoom > 1 && target !== null ? dwell?.targets.find((found) => found.target === target) : null;
  const middle = one ? [one.x_hat ?? one.x, one.y_hat ?? one.y] : null;
  const [x0, y0] = middle && middle[0] !== null
    ? [width / 2 - middle[1] * scale, height / 2 + middle[0] * scale]
    : [width / 2, height - FOOT];
  return {
    context, width, height, scale, zoom, range,
    at: (x, y) => [x0 + y * scale, y0 - x * scale],
    rim: range * scale,
    reach: zoom > 1 ? 1e5 : range * scale, // of a beam; zoomed in, beyond the edge
  };
}

// Adds a sector around the radar to the path.
export function wedge({ context, at, reach }, from, to) {
  const [x, y] = at(0, 0);
  context.moveTo(x, y);
  context.arc(x, y, reach, from - Math.PI / 2, to - Math.PI / 2);
  context.closePath();
}

export const radians = (degrees) => (degrees * Math.PI) / 180;

// The range of the whole scene in km: what all targets and tracks fit in, in round steps, and not less than before.
export function rangeOf(radar, dwell, before) {
  let far = 0;
  for (const one of [...(dwell?.targets ?? []), ...(dwell?.truths ?? [])]) {
    for (const [x, y] of [[one.x, one.y], [one.x_hat, one.y_hat]]) if (x !== null) far = Math.max(far, Math.hypot(x, y));
  }
  const power = 10 ** Math.floor(Math.log10(Math.max(far, 1)));
  const round = [1, 1.2, 1.6, 2, 2.5, 3, 4, 5, 6, 8, 10, 12].find((n) => n * power >= 1.05 * far) * power;
  return Math.max(before ?? 0, Math.min(round, Math.max(radar.max_range_km, 1.05 * far)));
}

// A ring's distance: 1, 2, 4 or 5 times a power of ten, some five of them to be seen.
export function step(km) {
  const power = 10 ** Math.floor(Math.log10(km / 4));
  return [1, 2, 4, 5, 10].map((n) => n * power).findLast((s) => s <= km / 4) ?? power;
}

export function rings(frame) {
  const { context, at, scale, width, height, zoom, range } = frame;
  const [x, y] = at(0, 0);
  const each = step(zoom > 1 ? Math.max(width, height) / scale : range);
  const far = zoom > 1 ? Math.hypot(Math.max(x, width - x), Math.max(y, height - y)) / scale : range;
  const near = zoom > 1 ? Math.max(0, Math.hypot(width / 2 - x, height / 2 - y) - Math.hypot(width, height) / 2) / scale : 0;
  context.font = `13px ${color("font")}`;
  context.fillStyle = color("muted");
  context.strokeStyle = color("ring");
  context.lineWidth = 1;
  context.textAlign = "center";
  for (let km = Math.max(each, Math.ceil(near / each) * each); km <= far + 1e-9; km += each) {
    context.beginPath();
    context.arc(x, y, km * scale, Math.PI, 0);
    context.stroke();
    ringLabel(frame, km, each);
  }
  context.beginPath();
  context.arc(x, y, range * scale, Math.PI, 0);
  context.closePath();
  context.lineWidth = 1.5;
  context.stroke();
  context.lineWidth = 1;
  for (let degrees = -60; degrees <= 60; degrees += 30) spoke(frame, degrees, range);
  context.textAlign = "left";
}

const said = (km, each) => `${km.toFixed(Math.max(0, -Math.floor(Math.log10(each) + 1e-9)))} km`;

// Along the foot of the whole scene; zoomed in, along the line from the radar through the middle.
function ringLabel({ context, at, scale, width, height, zoom }, km, each) {
  const [x, y] = at(0, 0);
  if (zoom === 1) {
    context.fillText(said(km, each).replace(" km", ""), x + km * scale, y + 13);
    context.fillText(said(km, each).replace(" km", ""), x - km * scale, y + 13);
    if (km === each) context.fillText("km", x, y + 13);
    return;
  }
  const angle = Math.atan2(width / 2 - x, y - height / 2);
  const [px, py] = [x + km * scale * Math.sin(angle), y - km * scale * Math.cos(angle)];
  if (px > 20 && px < width - 30 && py > 12 && py < height - 6) context.fillText(said(km, each), px, py - 3);
}

function spoke({ context, at, scale, zoom }, degrees, range) {
  const [sin, cos] = [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180)];
  const [x, y] = at(0, 0);
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + range * scale * sin, y - range * scale * cos);
  context.stroke();
  if (zoom > 1) return;
  const out = range * scale + 17;
  context.fillText(`${degrees}°`, x + out * sin, y - out * cos + 5);
}
