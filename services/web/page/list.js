// All tracks of a dwell in a table over the whole page: to be sorted, filtered, and saved as CSV.

import { STATE_TEXT } from "./dwells.js";
import { save } from "./files.js";
import { degrees, headingOf, placeOf, speedOf } from "./motion.js";
import { glyph } from "./palette.js";
import { byId, fixed, make, noMatch, percent, put, short } from "./text.js";
import { show, view } from "./view.js";

// `head` and `unit` of a column, its name in CSV files and filters, and how its numbers are shown; `of` gives its value.
const COLUMNS = [
  { name: "track", head: "Track", of: ({ one }) => one.target, text: String },
  { name: "state", head: "State", of: ({ state }) => STATE_TEXT[state], text: String },
  { name: "age_s", head: "Age", unit: "s radar time", of: ({ one, dwell, radar }) => (one.x_hat === null ? null : (dwell.t - (one.born_t ?? 0)) * radar.dt_s), text: short },
  { name: "range_km", head: "Range", unit: "km", of: ({ one }) => placeOf(one)?.range ?? null, text: (value) => fixed(value, 2) },
  { name: "bearing_deg", head: "Bearing", unit: "°", of: ({ one, radar }) => degrees(placeOf(one)?.angle, radar), text: fixed },
  { name: "speed_m_s", head: "Speed", unit: "m/s", of: ({ one }) => speedOf(one), text: (value) => fixed(value, 0) },
  { name: "heading_deg", head: "Heading", unit: "°", of: ({ one, radar }) => degrees(headingOf(one), radar), text: (value) => fixed(value, 0) },
  { name: "existence", head: "Exists", unit: "%", of: ({ one }) => one.existence ?? null, text: percent, needs: (radar) => radar.is_unknown },
  { name: "power", head: "Power", unit: "%", of: ({ one }) => one.share, text: percent },
  { name: "statistic", head: "Statistic", unit: "of threshold", of: ({ one, dwell }) => (one.statistic === null ? null : one.statistic / (one.threshold ?? dwell.threshold)), text: short },
  { name: "seen_s", head: "Last seen", unit: "s radar time ago", of: seen, text: short },
  { name: "error_km", head: "Error", unit: "km", of: ({ one }) => one.error_km, text: short, needs: (radar) => radar.has_truth },
  { name: "latitude_deg", head: "Latitude", unit: "°", of: ({ one }) => one.latitude_hat_deg, text: (value) => fixed(value, 4), needs: (radar) => radar.site !== null },
  { name: "longitude_deg", head: "Longitude", unit: "°", of: ({ one }) => one.longitude_hat_deg, text: (value) => fixed(value, 4), needs: (radar) => radar.site !== null },
];
const LIMIT = /^([a-z]+)(<|>)(-?\d+(?:\.\d+)?)$/; // of a column, as a filter: range<40

// Since it was detected last, as far as the dwells at hand tell.
function seen({ one, dwell, radar, trail }) {
  const last = trail.findLast((past) => past.targets.some((other) => other.target === one.target && other.detected));
  return last ? (dwell.t - last.t) * radar.dt_s : null;
}

export class TrackList {
  constructor() {
    this.table = byId("track-list");
    this.body = this.table.tBodies[0];
    Object.assign(this, { columns: [], sort: "track", isDown: false, picture: null, shown: [] });
    byId("track-filter").addEventListener("input", () => this.redraw());
    byId("track-csv").addEventListener("click", () => this.save());
    this.body.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row) show({ target: Number(row.dataset.target) === view.target ? null : Number(row.dataset.target) });
    });
    this.table.tHead.addEventListener("click", (event) => {
      const name = event.target.closest("th")?.dataset.name;
      if (!name) return;
      this.isDown = this.sort === name && !this.isDown;
      this.sort = name;
      this.redraw();
    });
  }

  open(radar) {
    this.picture = null;
    this.body.replaceChildren();
    put(byId("list-caption"), "");
    noMatch(byId("list-none"), false);
    if (!radar) return;
    this.columns = COLUMNS.filter(({ needs }) => !needs || needs(radar));
    const from = radar.site ? "from north" : "from boresight";
    this.table.tHead.rows[0].replaceChildren(...this.columns.map(({ name, head, unit }) => {
      const cell = make("th");
      cell.scope = "col";
      cell.dataset.name = name;
      const button = make("button", "plain", head);
      button.type = "button";
      button.title = `Sort by ${head.toLowerCase()}`;
      cell.append(button);
      if (unit) cell.append(make("br"), make("small", "", unit === "°" && /ing$/.test(head) ? `° ${from}` : unit));
      return cell;
    }));
  }

  redraw() {
    if (this.picture) this.draw(this.picture);
  }

  // `picture`: as of the scope.
  draw(picture) {
    this.picture = picture;
    const { dwell, radar, states, target } = picture;
    const words = byId("track-filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = dwell.targets.map((one) => {
      const about = { ...picture, one, state: states.get(one.target) };
      return { one, state: about.state, values: new Map(this.columns.map(({ name, of }) => [name, of(about)])) };
    });
    this.shown = rows.filter((row) => words.every((word) => fits(row, word))).sort((a, b) => this.order(a, b));
    const kind = radar.is_unknown ? "tracks" : "targets";
    const unknown = words.map((word) => LIMIT.exec(word)).filter((limit) => limit && !this.columns.some(({ name }) => name.startsWith(limit[1])));
    if (unknown.length) {
      put(byId("list-caption"), `no column ${unknown[0][1]}: ${this.columns.map(({ name }) => name).join(", ")}`);
    } else put(byId("list-caption"), `dwell ${dwell.t}: ${this.shown.length === rows.length ? "" : `${this.shown.length} of `}${rows.length} ${kind}`);
    for (const cell of this.table.tHead.rows[0].cells) {
      if (cell.dataset.name === this.sort) cell.setAttribute("aria-sort", this.isDown ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    }
    while (this.body.rows.length > this.shown.length) this.body.deleteRow(-1);
    this.shown.forEach((row, i) => this.fill(this.body.rows[i] ?? this.body.insertRow(), row, target));
    byId("track-csv").disabled = !this.shown.length;
    noMatch(byId("list-none"), rows.length && !this.shown.length, kind.slice(0, -1), byId("track-filter"));
  }

  // What is not known comes last either way.
  order(a, b) {
    const [x, y] = [a, b].map((row) => row.values.get(this.sort) ?? null);
    if (x === null || y === null) return (x === null) - (y === null) || a.one.target - b.one.target;
    const sign = typeof x === "string" ? x.localeCompare(y) : x - y;
    return (this.isDown ? -sign : sign) || a.one.target - b.one.target;
  }

  fill(line, { one, state, values }, target) {
    line.dataset.target = one.target;
    line.dataset.state = state;
    line.classList.toggle("chosen", one.target === target);
    while (line.cells.length < this.columns.length) line.insertCell();
    while (line.cells.length > this.columns.length) line.deleteCell(-1);
    this.columns.forEach(({ name, text }, i) => {
      const [cell, value] = [line.cells[i], values.get(name)];
      if (name !== "track") put(cell, value === null ? "–" : text(value));
      else if (cell.dataset.track !== String(one.target)) {
        cell.dataset.track = one.target;
        cell.replaceChildren(glyph(one.target), ` ${one.target}`);
      }
    });
  }

  // The rows that are shown, with full numbers.
  save() {
    const { dwell } = this.picture;
    const lines = [this.columns.map(({ name }) => name), ...this.shown.map(({ values }) => this.columns.map(({ name }) => values.get(name) ?? ""))];
    const text = lines.map((line) => `${line.join(",")}\r\n`).join("");
    save(new Blob([text], { type: "text/csv" }), `${dwell.run}-dwell-${dwell.t}-tracks.csv`);
  }
}

// A word is part of the state or the number; a limit is of a column that begins so.
function fits({ values }, word) {
  const limit = LIMIT.exec(word);
  if (!limit) return values.get("state").toLowerCase().includes(word) || String(values.get("track")) === word;
  const name = [...values.keys()].find((one) => one.startsWith(limit[1]));
  const value = name === undefined ? null : values.get(name);
  if (value === null) return false;
  const shown = name === "existence" || name === "power" ? 100 * value : value; // as in its head
  return limit[2] === "<" ? shown < Number(limit[3]) : shown > Number(limit[3]);
}
