// Where the half-plane lies on its canvas, and its range rings and angles. x points up (broadside) and y to the right; or
// north is up, and all of it is turned by the bearing of the boresight.

import { color } from "./palette.js";

const EDGE = 18; // px around the half-plane: cells on the rim, angles
const FOOT = 16;

// Sizes the canvas to its place; `at` maps km to px, `from` px to km, `scale` is px per km. Angles are from the boresight:
// `polar` is the point at a distance in px from the radar, `arc` adds an arc around it to the path.
export function fit(canvas, { radar, range, dwell, target, zoom, isNorthUp }) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const turn = isNorthUp && radar?.site ? radians(radar.site.boresight_deg) : 0;
  const [sin, cos] = [Math.sin(turn), Math.cos(turn)];
  const { left, right, up, down } = extents(turn);
  const [across, high] = [width - 2 * (EDGE + 14), height - EDGE - FOOT - 12 - (down ? EDGE : 0)];
  const whole = Math.min(across / (left + right), high / (up + down)) / range;
  const scale = whole * zoom;
  const one = zoom > 1 && target !== null ? dwell?.targets.find((found) => found.target === target) : null;
  const middle = one ? [one.x_hat ?? one.x, one.y_hat ?? one.y] : null;
  const [x0, y0] = middle && middle[0] !== null
    ? [width / 2 - (middle[0] * sin + middle[1] * cos) * scale, height / 2 + (middle[0] * cos - middle[1] * sin) * scale]
    : [(width + (left - right) * range * whole) / 2, height - FOOT - (down ? EDGE + (high + (down - up) * range * whole) / 2 : 0)];
  return {
    context, width, height, scale, zoom, range, turn, isTurned: isNorthUp,
    at: (x, y) => [x0 + (x * sin + y * cos) * scale, y0 - (x * cos - y * sin) * scale],
    from: (px, py) => [((px - x0) * sin + (y0 - py) * cos) / scale, ((px - x0) * cos - (y0 - py) * sin) / scale],
    polar: (radius, angle) => [x0 + radius * Math.sin(angle + turn), y0 - radius * Math.cos(angle + turn)],
    arc: (radius, begin, end) => context.arc(x0, y0, radius, begin + turn - Math.PI / 2, end + turn - Math.PI / 2),
    rim: range * scale,
    reach: zoom > 1 ? 1e5 : range * scale, // of a beam; zoomed in, beyond the edge
  };
}

// How far a half-plane that is turned reaches from the radar to each side, of its radius.
function extents(turn) {
  const angles = [-90, 90].map((degrees) => radians(degrees) + turn);
  const peak = (at) => (Math.cos(turn - at) >= 0 ? 1 : 0); // whether the direction `at` lies in it
  const reach = (at) => Math.max(peak(at), ...angles.map((angle) => Math.cos(angle - at)), 0);
  const [up, right, down, left] = [0, 1, 2, 3].map((quarter) => reach((quarter * Math.PI) / 2));
  return { up, right, left, down: down < 1e-9 ? 0 : down };
}

// Adds a sector around the radar to the path.
export function wedge({ context, at, arc, reach }, from, to) {
  context.moveTo(...at(0, 0));
  arc(reach, from, to);
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
  const { context, at, arc, scale, width, height, zoom, range } = frame;
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
    arc(km * scale, -Math.PI / 2, Math.PI / 2);
    context.stroke();
    ringLabel(frame, km, each);
  }
  context.beginPath();
  arc(range * scale, -Math.PI / 2, Math.PI / 2);
  context.closePath();
  context.lineWidth = 1.5;
  context.stroke();
  context.lineWidth = 1;
  // Round angles from the boresight, or from north.
  const boresight = (frame.turn * 180) / Math.PI;
  for (let degrees = 30 * Math.ceil((boresight - 89.9) / 30); degrees < boresight + 89.9; degrees += 30) {
    spoke(frame, radians(degrees - boresight), frame.isTurned ? `${((degrees % 360) + 360) % 360}°` : `${degrees}°`);
  }
  context.textAlign = "left";
}

const said = (km, each) => `${km.toFixed(Math.max(0, -Math.floor(Math.log10(each) + 1e-9)))} km`;

// Along the foot of the whole scene; zoomed in, along the line from the radar through the middle.
function ringLabel({ context, at, polar, turn, scale, width, height, zoom }, km, each) {
  const [x, y] = at(0, 0);
  if (zoom === 1) {
    const label = (text, radius, angle) => {
      const [px, py] = polar(radius, angle);
      context.fillText(text, px - 13 * Math.sin(turn), py + 13 * Math.cos(turn));
    };
    for (const side of [-1, 1]) label(said(km, each).replace(" km", ""), km * scale, (side * Math.PI) / 2);
    if (km === each) label("km", 0, 0);
    return;
  }
  const angle = Math.atan2(width / 2 - x, y - height / 2);
  const [px, py] = [x + km * scale * Math.sin(angle), y - km * scale * Math.cos(angle)];
  if (px > 20 && px < width - 30 && py > 12 && py < height - 6) context.fillText(said(km, each), px, py - 3);
}

function spoke({ context, at, polar, scale, zoom, range }, angle, text) {
  context.beginPath();
  context.moveTo(...at(0, 0));
  context.lineTo(...polar(range * scale, angle));
  context.stroke();
  if (zoom > 1) return;
  const [px, py] = polar(range * scale + 17, angle);
  context.fillText(text, px, py + 5);
}
