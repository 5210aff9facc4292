// The dwells of a run that are at hand: as events brought them, or asked for by hundreds. Bounded.

import { ask, runPath } from "./api.js";

const MOST = 60_000; // targets times dwells, about 30 MB,
const MOST_DWELLS = 2000; // ... and so many at most
const AT_ONCE = 100; // dwells in an answer
export const TRAIL = 40; // dwells before one that its picture needs
const LOST_WINDOW = 20; // as the service counts lost tracks

export class Dwells {
  constructor(run, targets) {
    this.run = run;
    this.most = Math.min(MOST_DWELLS, Math.max(2 * AT_ONCE, Math.floor(MOST / Math.max(1, targets))));
    this.kept = new Map();
    this.asked = new Map(); // first dwell of a hundred under way
    this.over = new AbortController();
  }

  close() {
    this.over.abort();
    this.kept.clear();
  }

  put(dwell) {
    this.kept.delete(dwell.t);
    this.kept.set(dwell.t, dwell);
    if (this.kept.size > this.most) this.kept.delete(this.kept.keys().next().value);
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
      let [from, to] = [Math.max(begin, first), Math.min(end, last)];
      while (from <= to && this.kept.has(from)) from += 1;
      if (from > to) continue;
      if (to > t) to = end;
      while (to > from && this.kept.has(to)) to -= 1;
      if (!this.asked.has(begin)) {
        const work = this.fetch(from, to).finally(() => this.asked.delete(begin));
        this.asked.set(begin, work);
        await work;
        came = true;
      }
    }
    return came;
  }

  async fetch(from, to) {
    const answer = await ask(`${runPath(this.run)}/dwells?dwells=${from}:${to}`, this.over.signal);
    for (const dwell of answer.dwells) this.put(dwell);
  }
}

// State of each target after these dwells (the last is shown), by its number.
export function states(dwells) {
  const seen = new Map();
  for (const dwell of dwells.slice(-LOST_WINDOW)) {
    for (const one of dwell.targets) {
      const counts = seen.get(one.target) ?? { hits: 0, n: 0 };
      counts.n += 1;
      counts.hits += isOn(one) ? 1 : 0;
      seen.set(one.target, counts);
    }
  }
  const found = new Map();
  for (const one of dwells.at(-1)?.targets ?? []) {
    const { hits, n } = seen.get(one.target);
    const isLost = n >= LOST_WINDOW / 2 && 2 * hits < Math.min(n, LOST_WINDOW);
    found.set(one.target, stateOf(one, isLost));
  }
  return found;
}

function stateOf(one, isLost) {
  if (one.x_hat === null) return "no track";
  if (isLost) return isOn(one) ? "found" : "lost";
  if (one.true_bin !== null && one.bin !== one.true_bin) return "off";
  return one.detected ? "detected" : "missed";
}

const isOn = (one) => (one.true_bin === null ? one.detected : one.bin === one.true_bin);

export const STATE_TEXT = {
  detected: "detected",
  missed: "not detected",
  off: "beam off",
  lost: "LOST",
  found: "beam back",
  "no track": "no track",
};
