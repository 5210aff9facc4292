// The map around the radar, where north is up: parallels and meridians, coasts and borders, airports.

import { color } from "./palette.js";

const [AXIS_KM, E2] = [6378.137, 0.00669437999014]; // WGS 84: equatorial radius, squared eccentricity
const STEPS = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10]; // degrees between lines,
const LINES = 6; // ... about so many of each
const POINTS = 24; // of a line
const FARTHEST = 80; // degrees of latitude: beyond, meridians are too close
const KM = 111; // of a degree of latitude

const radians = (degrees) => (degrees * Math.PI) / 180;

// How far east and north of the site a position is seen, km: distance and azimuth along the ellipsoid, by Gauss's
// mid-latitude formula, within 0.1 km up to 300 km.
export function seen({ latitude_deg: latitude, longitude_deg: longitude }, toLatitude, toLongitude) {
  const [north, east] = [radians(toLatitude - latitude), radians(((toLongitude - longitude + 540) % 360) - 180)];
  const middle = radians((latitude + toLatitude) / 2);
  const w = 1 - E2 * Math.sin(middle) ** 2;
  const across = (AXIS_KM / Math.sqrt(w)) * east * Math.cos(middle);
  const along = ((AXIS_KM * (1 - E2)) / w ** 1.5) * north * Math.cos(east / 2);
  const azimuth = Math.atan2(across, along) - (east * Math.sin(middle)) / 2;
  const distance = Math.hypot(across, along);
  return [distance * Math.sin(azimuth), distance * Math.cos(azimuth)];
}

export function graticule({ context, at, scale, width, height }, site) {
  if (Math.abs(site.latitude_deg) > FARTHEST) return;
  const [x0, y0] = at(0, 0);
  const [south, north] = [(y0 - height) / scale, y0 / scale].map((km) => site.latitude_deg + km / KM);
  const wide = KM * Math.cos(radians(Math.min(FARTHEST + 5, Math.max(Math.abs(south), Math.abs(north)))));
  const [west, east] = [-x0 / scale, (width - x0) / scale].map((km) => site.longitude_deg + km / wide);
  const point = (latitude, longitude) => {
    const [right, up] = seen(site, latitude, longitude);
    return [x0 + right * scale, y0 - up * scale];
  };
  context.strokeStyle = color("line");
  context.fillStyle = color("muted");
  context.font = `11px ${color("font")}`;
  context.lineWidth = 1;
  context.textAlign = "left";
  for (const latitude of round(south, north)) {
    const line = spread(west, east).map((longitude) => point(latitude, longitude));
    draw(context, line);
    label(context, line, ([x]) => Math.abs(x - 3), hemisphere(latitude, "N", "S"), [0, -3], width);
  }
  for (const longitude of round(west, east)) {
    const line = spread(south, north).map((latitude) => point(latitude, longitude));
    draw(context, line);
    label(context, line, ([, y]) => Math.abs(y - 12), hemisphere(((longitude + 540) % 360) - 180, "E", "W"), [3, 0], width);
  }
}

// Coasts and borders, then airports; without packages of data the radar has none.
export function surroundings({ context, at, scale, width, height }, radar) {
  if (!radar.surroundings) return;
  if (placed.radar !== radar) place(radar);
  const [x0, y0] = at(0, 0);
  context.strokeStyle = color("ink");
  context.globalAlpha = 0.6;
  context.lineWidth = 1.25;
  context.beginPath();
  for (const line of placed.lines) line.forEach(([east, north], i) => context[i ? "lineTo" : "moveTo"](x0 + east * scale, y0 - north * scale));
  context.stroke();
  context.globalAlpha = 1;
  context.fillStyle = color("muted");
  context.font = `11px ${color("font")}`;
  context.textAlign = "left";
  for (const { code, east, north } of placed.airports) {
    const [x, y] = [x0 + east * scale, y0 - north * scale];
    if (x < 0 || x > width || y < 0 || y > height) continue;
    context.beginPath();
    airport(context, x, y);
    context.stroke();
    if (x + 6 + context.measureText(code).width < width) context.fillText(code, x + 6, y + 4);
  }
}

// A square with its runway.
export function airport(context, x, y) {
  context.rect(x - 3, y - 3, 6, 6);
  context.moveTo(x - 5, y + 5);
  context.lineTo(x + 5, y - 5);
}

const placed = { radar: null, lines: [], airports: [] }; // km east and north of the site

function place(radar) {
  const km = (latitude, longitude) => seen(radar.site, latitude, longitude);
  placed.radar = radar;
  placed.lines = radar.surroundings.lines.map((line) => line.map((point) => km(...point)));
  placed.airports = radar.surroundings.airports.map(({ code, latitude_deg, longitude_deg }) => {
    const [east, north] = km(latitude_deg, longitude_deg);
    return { code, east, north };
  });
}

// Round degrees between two.
function round(from, to) {
  const each = STEPS.find((step) => (to - from) / step <= LINES) ?? STEPS.at(-1);
  const first = Math.ceil(from / each);
  return Array.from({ length: Math.max(0, Math.floor(to / each) - first + 1) }, (_, i) => Number(((first + i) * each).toFixed(2)));
}

const spread = (from, to) => Array.from({ length: POINTS + 1 }, (_, i) => from + ((to - from) * i) / POINTS);

const hemisphere = (degrees, positive, negative) => `${Number(Math.abs(degrees).toFixed(2))}°${degrees < 0 ? negative : positive}`;

function draw(context, line) {
  context.beginPath();
  for (const [x, y] of line) context.lineTo(x, y);
  context.stroke();
}

// At the point of a line for which `far` is least, unless it would be cut off.
function label(context, line, far, text, [right, down], width) {
  const [x, y] = line.reduce((best, one) => (far(one) < far(best) ? one : best));
  const from = Math.max(x, 2) + right;
  if (from + context.measureText(text).width < width) context.fillText(text, from, Math.max(y, 11) + down);
}
