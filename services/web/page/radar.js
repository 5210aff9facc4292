// The radar's picture of one dwell: scope, table, charts. Drawn at most once a frame, and the newest wins.

import { states, TRAIL } from "./dwells.js";
import { record, saveCanvas } from "./files.js";
import { drawLegend } from "./legend.js";
import { TrackList } from "./list.js";
import { directions } from "./orders.js";
import { degrees, headingOf, speedOf } from "./motion.js";
import { color, onTheme } from "./palette.js";
import { Particles } from "./particles.js";
import { AirPicture } from "./picture.js";
import * as says from "./says.js";
import { Scope } from "./scope.js";
import { rangeOf } from "./scope_frame.js";
import { byId, fixed, put } from "./text.js";
import { Tracks } from "./tracks.js";
import { show, view } from "./view.js";

const READ_MS = 450; // numbers that change faster cannot be read

export class Radar {
  constructor(charts, orders, command) {
    Object.assign(this, { charts, orders, command, radar: null, dwells: null, dwell: null, drawn: null, due: 0, began: null, read: 0, occurred: new Set() });
    this.scope = new Scope(byId("scope"));
    this.tracks = new Tracks((target) => show({ target: target === view.target ? null : target }));
    this.list = new TrackList();
    this.particles = new Particles(() => this.redraw());
    this.all = new AirPicture();
    byId("scope").addEventListener("click", (event) => {
      if (this.isForCommand) return;
      const target = this.scope.at(event.offsetX, event.offsetY);
      show({ target: target === view.target ? null : target });
    });
    for (const kind of ["down", "move", "up"]) byId("scope").addEventListener(`pointer${kind}`, (event) => this.point(event, kind));
    byId("scope").addEventListener("pointerleave", () => {
      this.under = null;
      put(byId("pointer"), "");
    });
    new ResizeObserver(() => this.redraw()).observe(byId("scope"));
    onTheme(() => {
      this.legend();
      this.redraw();
    });
    this.legend();
  }

  // What has occurred in this run stays in the legend.
  legend(dwell = null, told = null) {
    if (dwell?.cells?.unmeasured?.length) this.occurred.add("unmeasured");
    for (const { search } of told?.sectors ?? []) this.occurred.add(search);
    if (told?.looks.length) this.occurred.add("look");
    if (told?.isPaused) this.occurred.add("pause");
    if (this.radar?.is_unknown) this.occurred.add("unknown");
    if (this.radar?.surroundings && view.north) this.occurred.add("map");
    const isJammed = Boolean(this.radar?.jammers?.length);
    if (isJammed) this.occurred.add("jammers");
    if (isJammed || dwell?.cells?.blind?.some(Boolean)) this.occurred.add("blind");
    const key = [...this.occurred].join(" ");
    if (dwell && key === this.legendOf) return;
    this.legendOf = key;
    drawLegend(byId("legend"), this.occurred);
  }

  open(radar, dwells) {
    Object.assign(this, { radar, dwells, dwell: null, drawn: null, before: null, range: null, occurred: new Set() });
    clearTimeout(this.trailing);
    this.tracks.clear(radar);
    this.list.open(radar);
    this.particles.clear();
    this.all.clear();
    this.charts.clear();
    this.legend();
    byId("north").hidden = !radar?.site;
    says.noEvents(radar?.is_unknown);
    put(byId("dwell"), "–");
    put(byId("dwell-of"), "");
    put(byId("clock"), "");
    this.redraw();
  }

  // `began`: when it was asked for, `isCalm`: nothing will follow at once.
  show(dwell, began, isCalm) {
    this.dwell = dwell;
    this.began ??= began;
    this.isCalm = isCalm;
    this.redraw();
  }

  redraw() {
    this.due ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.due = 0;
    const isList = !byId("list").hidden;
    if (byId("radar").hidden && !isList) return; // it is drawn when it is looked at
    const { radar, dwell } = this;
    const trail = dwell ? [...this.dwells.before(dwell.t - 1, TRAIL - 1), dwell] : [];
    const found = dwell ? states(dwell, this.dwells.get(dwell.t - 1)) : new Map();
    const cloud = this.particles.of(this.dwells?.run, dwell, this.isCalm);
    if (dwell) this.range = rangeOf(radar, dwell, this.range);
    const range = this.range ?? radar?.max_range_km;
    const picture = { radar, range, dwell, trail, states: found, target: view.target, zoom: view.zoom, cloud, isNorthUp: view.north && Boolean(radar?.site) };
    picture.told = { ...directions(this.orders.of(dwell)), asked: this.command.asked };
    this.legend(dwell, picture.told);
    if (isList && dwell) this.detail(picture);
    if (isList) return;
    this.scope.draw(picture);
    this.readOut();
    if (!dwell) return;
    says.empty(null);
    put(byId("dwell"), String(dwell.t));
    put(byId("dwell-of"), radar.dwells === null ? "" : ` of ${Math.max(radar.dwells, dwell.t)}`);
    put(byId("clock"), times(dwell, radar));
    this.tell(picture);
    this.detail(picture);
    this.drawn = dwell;
    if (this.began !== null) measure(this.began);
    this.began = null;
  }

  // Table and charts; while dwells follow each other, as often as they can be read.
  detail(picture) {
    const now = performance.now();
    const isNew = this.shownTarget !== view.target || this.drawn === null;
    const early = READ_MS - (now - this.read);
    clearTimeout(this.trailing);
    if (!this.isCalm && !isNew && early > 0) {
      this.trailing = setTimeout(() => this.detail(picture), early); // the last one is shown in any case
      return;
    }
    this.read = now;
    this.shownTarget = view.target;
    if (!byId("list").hidden) {
      this.list.draw(picture);
      return;
    }
    this.tracks.draw(picture);
    this.all.show(picture);
    // After the scope is on the screen.
    setTimeout(() => picture.radar === this.radar && this.charts.show(picture));
  }

  // What is under the pointer: where it is, and how the track there flies.
  point({ offsetX, offsetY, pointerId }, kind) {
    const place = this.radar && this.scope.placeAt(offsetX, offsetY);
    const isForCommand = this.command.pointed(kind, place?.angle ?? null);
    if (kind === "down" && isForCommand) byId("scope").setPointerCapture(pointerId); // a sector may be left beside the scope
    if (kind === "up") this.isForCommand = isForCommand; // and not to choose a target
    if (!place || kind !== "move") return;
    this.under = [offsetX, offsetY];
    this.readOut();
  }

  // The picture may move under a pointer that rests.
  readOut() {
    const place = this.under && this.radar && this.scope.placeAt(...this.under);
    if (!place) return;
    const one = this.dwell?.targets.find((found) => found.target === this.scope.at(...this.under));
    const [speed, heading] = one ? [speedOf(one), headingOf(one)] : [null, null];
    const flies = speed === null ? "" : `; ${one.target}: ${fixed(speed, 0)} m/s, heading ${fixed(degrees(heading, this.radar), 0)}°`;
    put(byId("pointer"), `${fixed(place.range)} km, ${fixed(degrees(place.angle, this.radar))}°${flies}`);
  }

  // The scope as a file.
  snapshot() {
    if (this.dwell) saveCanvas(byId("scope"), color("panel"), `${this.dwell.run}-dwell-${this.dwell.t}.png`);
  }

  // Begins to record the scope, or ends that and hands the film out.
  film() {
    const { dwell, endFilm } = this;
    this.endFilm = endFilm || !dwell ? null : record(byId("scope"), color("panel"), `${dwell.run}-from-${dwell.t}.webm`);
    endFilm?.();
    byId("film").setAttribute("aria-pressed", String(Boolean(this.endFilm)));
  }

  // What became of targets or tracks since the last picture, if this one follows it.
  tell({ radar, dwell, states: now }) {
    const follows = this.drawn && this.before && dwell.t > this.drawn.t && dwell.t - this.drawn.t <= TRAIL;
    const events = !follows ? [] : radar.is_unknown ? changes(this.before, now) : losses(this.before, now);
    for (const [text, kind] of events) says.event(`Dwell ${dwell.t}: ${text}`, kind);
    this.before = now;
    const lost = [...now].filter(([, state]) => state === "lost").map(([target]) => target);
    const text = radar.is_unknown
      ? `Scope at dwell ${dwell.t}: confirmed tracks: ${[...now.values()].filter(isConfirmed).length}. The table of tracks says the same in numbers.`
      : `Scope at dwell ${dwell.t}: ${now.size} targets, ${lost.length ? `lost: ${lost.join(", ")}` : "none lost"}. The table of targets says the same in numbers.`;
    if (this.isCalm) byId("scope").setAttribute("aria-label", text);
  }
}

// When a dwell was: by the clock of the radar, and if it is known in UTC.
function times({ t, utc_s: utc }, { dt_s: dt }) {
  const seconds = `${Number((t * dt).toFixed(3))} s radar time`;
  return utc === null ? seconds : `${seconds}\n${new Date(1000 * utc).toISOString().replace("T", " ").slice(0, dt < 1 ? 21 : 19)} UTC`;
}

// Targets that were lost or found.
function losses(before, now) {
  const found = [];
  for (const [target, state] of now) {
    const [was, is] = [before.get(target), state].map((one) => one === "lost" || one === "found");
    if (!was && is && before.has(target)) found.push([`target ${target} lost`, "alarm"]);
    if (was && !is) found.push([`target ${target} found again`, "good"]);
  }
  return found;
}

// Tracks, with an unknown number of targets, that were confirmed or have ended; tentative ones come and go.
function changes(before, now) {
  const began = [...now].filter(([track, state]) => isConfirmed(state) && !isConfirmed(before.get(track)));
  const ended = [...before].filter(([track, state]) => isConfirmed(state) && !isConfirmed(now.get(track)));
  return [...began.map(([track]) => [`track ${track} confirmed`, "good"]), ...ended.map(([track]) => [`track ${track} ended`, ""])];
}

const isConfirmed = (state) => state !== undefined && state !== "tentative" && state !== "ended";

// From what caused it until it is on the screen; shows the page's speed.
function measure(start) {
  requestAnimationFrame(() => {
    performance.measure("dwell", { start, end: performance.now() });
    performance.clearMeasures("dwell");
  });
}
