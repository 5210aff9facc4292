// The dwells of a run that are at hand: as events brought them, or asked for by hundreds. Bounded.

import { ask, runPath } from "./api.js";

const MOST = 60_000; // targets times dwells, about 30 MB,
const MOST_DWELLS = 2000; // ... and so many at most; at least 200: far more than a picture needs
const AT_ONCE = 100; // dwells in an answer
export const TRAIL = 40; // dwells before one that its picture needs

export class Dwells {
  constructor(run, targets) {
    this.run = run;
    this.most = Math.min(MOST_DWELLS, Math.max(2 * AT_ONCE, Math.floor(MOST / Math.max(1, targets))));
    this.kept = new Map();
    this.at = 0; // the dwell that is shown
    this.asked = new Map(); // first dwell of a hundred under way
    this.over = new AbortController();
  }

  close() {
    this.over.abort();
    this.kept.clear();
  }

  // With too many, the one farthest from what is shown goes.
  put(dwell) {
    this.kept.set(dwell.t, byTrack(dwell));
    if (this.kept.size <= this.most) return;
    let [farthest, far] = [null, -1];
    for (const t of this.kept.keys()) {
      const distance = Math.abs(t - this.at);
      if (t !== dwell.t && distance > far) [farthest, far] = [t, distance];
    }
    this.kept.delete(farthest);
  }

  get(t) {
    return this.kept.get(t) ?? null;
  }

  // Dwells up to t that are at hand, oldest first.
  before(t, n = TRAIL) {
    const found = [];
    for (let i = Math.max(1, t - n + 1); i <= t; i += 1) if (this.kept.has(i)) found.push(this.kept.get(i));
    return found;
  }

  // Dwell t, alone if nothing of it is here: it is drawn while the others come.
  async one(t) {
    if (!this.kept.has(t)) await this.fetch(t, t);
    return this.get(t);
  }

  // Those around dwell t that a picture, or the next seconds of playing, need. Returns whether any came.
  async around(t, newest, ahead = 30) {
    const first = Math.max(1, t - TRAIL + 1);
    const last = Math.min(newest, t + ahead);
    let came = false;
    for (let begin = first - ((first - 1) % AT_ONCE); begin <= last; begin += AT_ONCE) {
      const end = Math.min(newest, begin + AT_ONCE - 1);
      // What is under way may have been asked for from another dwell: others of its hundred may still be missing then.
      await this.asked.get(begin);
      let [from, to] = [Math.max(begin, first), Math.min(end, last)];
      while (from <= to && this.kept.has(from)) from += 1;
      if (from > to) continue;
      if (to > t) to = end;
      while (to > from && this.kept.has(to)) to -= 1;
      if (this.asked.has(begin)) continue; // by one that waited, too, and was first
      const work = this.fetch(from, to).finally(() => this.asked.delete(begin));
      this.asked.set(begin, work);
      await work;
      came = true;
    }
    return came;
  }

  async fetch(from, to) {
    const answer = await ask(`${runPath(this.run)}/dwells?dwells=${from}:${to}`, this.over.signal);
    for (const dwell of answer.dwells) this.put(dwell);
  }
}

// With an unknown number of targets, the tracks are what is listed, coloured and chosen, by their
// numbers, each with what is known of the target that it follows; `truths` are the targets.
function byTrack(dwell) {
  if (!dwell.tracks) return dwell;
  const truths = new Map(dwell.targets.map((one) => [one.target, one]));
  const targets = dwell.tracks.map((one) => {
    const { x = null, y = null, hit = null, true_bin = null, snr_db = null } = truths.get(one.target) ?? {};
    return { ...one, target: one.track, follows: one.target, x, y, hit, true_bin, stale: dwell.stale, snr_db, lost: null };
  });
  return { ...dwell, targets, truths: dwell.targets.filter((one) => one.x !== null) };
}

// State of each target in a dwell, by its number. `before` is the dwell before it, or null.
export function states(dwell, before) {
  const earlier = new Map(before?.targets.map((one) => [one.target, one]));
  return new Map(dwell.targets.map((one) => [one.target, stateOf(one, earlier.get(one.target))]));
}

// The service says what is lost: by what the track believes, which may find its target later than its beam does.
function stateOf(one, before) {
  if (one.is_over) return "ended";
  if (one.confirmed === false) return "tentative";
  if (one.confirmed && one.x_hat === null) return "late";
  if (one.detected === null) return (one.x ?? one.x_hat) === null ? "absent" : "unmeasured";
  if (one.x_hat === null) return "no track";
  if ((before ?? one).lost && isOn(one)) return "found";
  if (one.lost) return "lost";
  if (one.hit === false) return one.cells.length ? "off" : "dark";
  return one.detected ? "detected" : "missed";
}

const isOn = (one) => (one.true_bin === null ? one.detected : one.hit);

export const STATE_TEXT = {
  detected: "detected",
  missed: "not detected",
  off: "beam off",
  dark: "no beam",
  lost: "LOST",
  found: "beam back",
  "no track": "no track",
  absent: "not there",
  unmeasured: "not measured",
  tentative: "tentative",
  ended: "ended",
  late: "no plan",
};
