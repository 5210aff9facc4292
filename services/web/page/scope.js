// The scope: the half-plane before the radar. A canvas: 100 tracks are drawn in some 5 ms, which the charts' library
// needs 170 ms for.

import { graticule, surroundings } from "./graticule.js";
import { fit, radians, rings, wedge } from "./scope_frame.js";
import { color, colorOf, symbolOf, trace } from "./palette.js";
import { commanded } from "./scope_orders.js";

const TAU = 2 * Math.PI;
const LOST_IN_WORDS = 6; // with more, the words would hide the picture
const FEW_BEAMS = 12; // of a search, whose outlines are dark; of many they would hide the tracks
const DASH = [3, 2.5]; // of what is tentative
const LEADER_S = 60; // of flight: the line before a track
const SIGMAS = 2.0; // of the ellipse of uncertainty: 86 % of a Gaussian belief

export class Scope {
  constructor(canvas) {
    this.canvas = canvas;
    this.spots = []; // where targets were drawn: to be clicked
    this.frame = null; // of the newest picture
  }

  // `picture`: {radar, dwell, trail, states, target, zoom, cloud}; dwell may be null.
  draw(picture) {
    const frame = fit(this.canvas, picture);
    const { context } = frame;
    this.frame = frame;
    this.spots = [];
    context.clearRect(0, 0, frame.width, frame.height);
    if (!picture.radar || frame.scale <= 0) return;
    context.save();
    context.beginPath();
    context.rect(0, 0, frame.width, frame.height);
    context.clip();
    const { dwell } = picture;
    if (picture.isNorthUp) graticule(frame, picture.radar.site);
    if (dwell) jammers(frame, picture);
    if (dwell) beams(frame, picture);
    commanded(frame, picture);
    if (picture.isNorthUp) surroundings(frame, picture.radar);
    rings(frame);
    if (dwell) {
      rim(frame, picture);
      if (picture.cloud) cloud(frame, picture.cloud);
      trails(frame, picture);
      for (const one of dwell.targets) uncertainty(frame, one, picture);
      this.spots = marks(frame, picture);
    }
    context.restore();
  }

  // Range and angle of a point of the canvas; null beside the half-plane.
  placeAt(px, py) {
    if (!this.frame || this.frame.scale <= 0) return null;
    const [x, y] = this.frame.from(px, py);
    return x < 0 ? null : { range: Math.hypot(x, y), angle: Math.atan2(y, x) };
  }

  // The target drawn nearest to a point of the canvas, within reach of a finger.
  at(x, y) {
    let [found, best] = [null, 28];
    for (const spot of this.spots) {
      const distance = Math.hypot(spot.x - x, spot.y - y);
      if (distance < best) [found, best] = [spot.target, distance];
    }
    return found;
  }
}

// The directions of jammers: a full line while one is on, a dashed one while it is off.
function jammers(frame, { radar, dwell }) {
  const { context, at, polar, reach } = frame;
  const now = dwell.t * radar.dt_s;
  context.strokeStyle = color("warn");
  for (const one of radar.jammers ?? []) {
    const isOn = one.on_s <= now && (one.off_s === null || now < one.off_s);
    const angle = radians(one.angle_deg);
    context.setLineDash(isOn ? [] : [2, 6]);
    context.lineWidth = isOn ? 3 : 1;
    context.globalAlpha = isOn ? 1 : 0.5;
    context.beginPath();
    context.moveTo(...at(0, 0));
    context.lineTo(...polar(reach, angle));
    context.stroke();
  }
  context.setLineDash([]);
  context.globalAlpha = 1;
}

// Each track's beams where they point, the denser the more power they have.
function beams(frame, { dwell, target }) {
  const { context } = frame;
  search(frame, dwell.search?.beams_deg ?? []);
  for (const one of dwell.targets) {
    for (const [i, [, share]] of one.cells.entries()) {
      context.beginPath();
      wedge(frame, ...one.beams_deg[i].map(radians));
      context.globalAlpha = (0.05 + 0.4 * share) * (target === null || target === one.target ? 1 : 0.6);
      context.fillStyle = colorOf(one.target);
      context.fill();
    }
  }
  context.globalAlpha = 1;
}

// Where the search for an unknown number of targets looks.
function search(frame, edges) {
  const { context } = frame;
  context.setLineDash([5, 4]);
  context.lineWidth = 1;
  context.strokeStyle = context.fillStyle = color("muted");
  const ink = Math.max(0.2, Math.min(0.7, FEW_BEAMS / edges.length));
  for (const beam of edges) {
    context.beginPath();
    wedge(frame, ...beam.map(radians));
    context.globalAlpha = 0.08;
    context.fill();
    context.globalAlpha = ink;
    context.stroke();
  }
  context.globalAlpha = 1;
  context.setLineDash([]);
}

// Around the edge: cells that were looked at, those over the threshold, of these the false alarms, blind cells, and in
// another colour those that were not measured.
function rim(frame, { radar, dwell }) {
  const { context, arc, polar, rim: radius } = frame;
  const { cells } = dwell;
  const edges = radar.bin_edges_deg;
  if (!cells || !edges || frame.zoom > 1) return;
  const isFalse = new Set(dwell.false_alarms ?? []);
  context.lineWidth = 6;
  context.strokeStyle = color("alarm");
  context.setLineDash([2, 4]);
  for (const bin of cells.unmeasured ?? []) {
    context.beginPath();
    arc(radius + 4, radians(edges[bin]), radians(edges[bin + 1]));
    context.stroke();
  }
  context.setLineDash([]);
  for (let i = 0; i < cells.bin.length; i += 1) {
    const [from, to] = [radians(edges[cells.bin[i]]), radians(edges[cells.bin[i] + 1])];
    const isOver = cells.detected[i];
    const isBlind = cells.blind?.[i] ?? false;
    context.beginPath();
    arc(radius + 4, from, to);
    context.lineWidth = isOver || isBlind ? 6 : 2;
    context.setLineDash(isBlind ? [2, 2] : []);
    context.strokeStyle = isBlind ? color("warn") : isOver ? color("ink") : color("muted");
    context.stroke();
    context.setLineDash([]);
    if (!isFalse.has(cells.bin[i])) continue;
    const [cx, cy] = polar(radius + 4, (from + to) / 2);
    context.beginPath();
    for (const [dx, dy] of [[-5, -5], [-5, 5]]) {
      context.moveTo(cx + dx, cy + dy);
      context.lineTo(cx - dx, cy - dy);
    }
    context.lineWidth = 2.5;
    context.strokeStyle = color("warn");
    context.stroke();
  }
}

function cloud({ context, at }, { x, y, target }) {
  context.fillStyle = colorOf(target);
  context.globalAlpha = 0.45;
  for (let i = 0; i < x.length; i += 1) {
    const [px, py] = at(x[i], y[i]);
    context.fillRect(px - 1, py - 1, 2, 2);
  }
  context.globalAlpha = 1;
}

// Where each track has been; the line stops where there was none.
function trails({ context, at }, { trail, dwell, states, target }) {
  const lines = new Map(dwell.targets.map((one) => [one.target, []]));
  for (const past of trail) {
    for (const one of past.targets) lines.get(one.target)?.push(one.x_hat === null ? null : at(one.x_hat, one.y_hat));
  }
  context.lineJoin = "round";
  for (const [number, points] of lines) {
    context.beginPath();
    let isDown = false;
    for (const point of points) {
      if (point) context[isDown ? "lineTo" : "moveTo"](...point);
      isDown = point !== null;
    }
    const isTentative = states.get(number) === "tentative";
    context.setLineDash(isTentative ? DASH : []);
    context.lineWidth = number === target ? 2.5 : isTentative ? 1 : 1.5;
    context.globalAlpha = number === target ? 0.9 : 0.45;
    context.strokeStyle = colorOf(number);
    context.stroke();
  }
  context.setLineDash([]);
  context.globalAlpha = 1;
}

function uncertainty({ context, at, scale, turn: turned }, one, { states, target }) {
  if (!one.covariance || one.x_hat === null) return;
  const [xx, xy, yy] = one.covariance;
  const [middle, half] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  const [a, b] = [middle + half, Math.max(0, middle - half)].map((value) => SIGMAS * Math.sqrt(value) * scale);
  const turn = 0.5 * Math.atan2(2 * xy, xx - yy); // from the x axis, which points up
  const [x, y] = at(one.x_hat, one.y_hat);
  context.beginPath();
  context.ellipse(x, y, a, b, turn + turned - Math.PI / 2, 0, TAU);
  context.fillStyle = context.strokeStyle = colorOf(one.target);
  context.globalAlpha = 0.12;
  context.fill();
  context.globalAlpha = one.target === target ? 1 : 0.7;
  const isTentative = states.get(one.target) === "tentative";
  context.setLineDash(isTentative ? DASH : []);
  context.lineWidth = one.target === target ? 2 : isTentative ? 0.75 : 1.25;
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
}

// Truths, tracks and their numbers. Returns where the tracks are.
function marks(frame, { dwell, states, target }) {
  const { context, at } = frame;
  const [spots, labels] = [[], []];
  for (const one of dwell.truths ?? []) {
    cross(context, at(one.x, one.y));
    if (one.lost) ring(context, at(one.x, one.y));
  }
  const order = [...dwell.targets].sort((a, b) => rank(a, states, target) - rank(b, states, target));
  for (const one of order) {
    const state = states.get(one.target) ?? "detected";
    const isAlarm = state === "lost" || state === "off" || state === "found";
    const truth = one.x === null ? null : at(one.x, one.y);
    const track = one.x_hat === null ? null : at(one.x_hat, one.y_hat);
    const ink = isAlarm ? color("alarm") : colorOf(one.target);
    if (truth && track) tie(context, truth, track, isAlarm);
    if (truth && !dwell.truths) cross(context, truth);
    if (track) leader(frame, one, ink, state);
    if (track) symbol(context, track, one, ink, state);
    if (state === "lost") ring(context, truth ?? track);
    if (one.target === target && track) brackets(context, track);
    const place = track ?? truth;
    if (!place) continue;
    spots.push({ x: place[0], y: place[1], target: one.target });
    labels.push([place, one.target, state, ink]);
  }
  const taken = [];
  const lost = [...states.values()].filter((state) => state === "lost").length;
  for (const one of labels.reverse()) label(frame, taken, target, lost <= LOST_IN_WORDS, ...one);
  return spots;
}

// What must not be covered is drawn last, and gets its label first.
function rank(one, states, target) {
  const state = states.get(one.target);
  return (one.target === target ? 4 : 0) + (state === "lost" ? 2 : 0) - (state === "tentative" ? 1 : 0);
}

function tie(context, [x0, y0], [x1, y1], isAlarm) {
  if (Math.hypot(x1 - x0, y1 - y0) < 6) return;
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.setLineDash(isAlarm ? [5, 4] : []);
  context.lineWidth = isAlarm ? 2 : 1;
  context.strokeStyle = isAlarm ? color("alarm") : color("muted");
  context.stroke();
  context.setLineDash([]);
}

function cross(context, [x, y]) {
  context.beginPath();
  for (const [dx, dy] of [[1, 0], [0, 1], [-1, 0], [0, -1]]) {
    context.moveTo(x + 4 * dx, y + 4 * dy);
    context.lineTo(x + 12 * dx, y + 12 * dy);
  }
  context.lineWidth = 1.75;
  context.strokeStyle = color("ink");
  context.stroke();
}

// Where a track will be in a minute, if it flies straight on.
function leader({ context, at }, { x_hat: x, y_hat: y, vx_hat: vx, vy_hat: vy }, ink, state) {
  if (vx === null || vx === undefined || state === "ended") return;
  context.beginPath();
  context.moveTo(...at(x, y));
  context.lineTo(...at(x + LEADER_S * vx, y + LEADER_S * vy));
  context.setLineDash(state === "tentative" ? DASH : []);
  context.lineWidth = 1.25;
  context.strokeStyle = ink;
  context.stroke();
  context.setLineDash([]);
}

// Filled: detected in this dwell. Hollow: not, or tentative.
function symbol(context, [x, y], one, ink, state) {
  const isFaint = state === "tentative" || state === "ended";
  context.beginPath();
  trace(context, symbolOf(one.target), x, y, isFaint ? 5 : 6.5);
  context.fillStyle = one.detected && state !== "lost" && !isFaint ? ink : color("panel");
  context.fill();
  context.setLineDash(isFaint ? DASH : []);
  context.lineWidth = isFaint ? 1.25 : 2;
  context.strokeStyle = ink;
  context.stroke();
  context.setLineDash([]);
}

function ring(context, [x, y]) {
  context.beginPath();
  context.arc(x, y, 18, 0, TAU);
  context.lineWidth = 3.5;
  context.strokeStyle = color("alarm");
  context.stroke();
}

function brackets(context, [x, y]) {
  context.beginPath();
  for (const [sx, sy] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    context.moveTo(x + 15 * sx, y + 8 * sy);
    context.lineTo(x + 15 * sx, y + 15 * sy);
    context.lineTo(x + 8 * sx, y + 15 * sy);
  }
  context.lineWidth = 2;
  context.strokeStyle = color("ink");
  context.stroke();
}

// A number beside its track, on a side with room for it; always for what is chosen, or one of few that are lost.
function label({ context, width }, taken, target, inWords, [x, y], number, state, ink) {
  const text = inWords && state === "lost" ? `${number} LOST` : String(number);
  context.font = state === "tentative" || state === "ended" ? `400 13px ${color("font")}` : `700 ${state === "lost" ? 18 : 16}px ${color("font")}`;
  const wide = context.measureText(text).width;
  const left = x + 17 + wide > width ? x - 15 - wide : x + 15;
  const places = [[left, y - 6], [left, y + 18], [2 * x - wide - left, y - 6], [2 * x - wide - left, y + 18]];
  const boxes = places.map(([px, py]) => [px, py - 14, px + wide, py + 2]);
  const isFree = (box) => !taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3]);
  const free = boxes.findIndex(isFree);
  if (free < 0 && number !== target && !(inWords && state === "lost")) return;
  const [box, place] = [boxes[Math.max(free, 0)], places[Math.max(free, 0)]];
  taken.push(box);
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = color("panel");
  context.strokeText(text, ...place);
  context.fillStyle = ink;
  context.fillText(text, ...place);
}
