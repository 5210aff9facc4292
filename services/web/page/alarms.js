// What is wrong with a run that is watched live, in a line: it stands still, and why; plans are late, and whether for
// the front end; cells are blind, looks are not measured, a certificate is about to end.

import { Latest, ask } from "./api.js";
import * as says from "./says.js";
import { fixed } from "./text.js";

const EVERY_MS = 1000;
const ASK_MS = 3000;
const SILENT_MS = 6000; // or so many dwells without one:
const SILENT_DWELLS = 5;
const LATELY = 20; // dwells over which shares are counted
const CERTIFICATES_MS = 600000; // between two looks at certificates
const SOON_DAYS = 30;
const SLOW = 0.5; // of a dwell, after which a scan leaves too little for the plans
const ALARMING = 0.05; // of plans that are late, of cells that are blind, of looks that are not measured

export class Alarms {
  constructor(session) {
    Object.assign(this, { session, run: null, newest: 0, since: 0, reasons: [], ending: [], frontEnd: null, askAt: 0 });
    this.latest = new Latest(ASK_MS, () => ask("/processes"), (answer) => {
      this.reasons = answer ? reasonsOf(answer.processes) : [];
      this.frontEnd = answer?.processes.find((one) => one.front_end_p99_ms != null)?.front_end_p99_ms ?? null;
      this.ending = answer ? endingOf(answer.processes) : this.ending;
    });
    setInterval(() => document.hidden || this.look(), EVERY_MS);
  }

  look() {
    const { session } = this;
    const { player, radar, dwells, row } = session;
    const now = performance.now();
    if (session.run !== this.run || player.newest !== this.newest || !player.isRunning || document.hidden) {
      Object.assign(this, { run: session.run, newest: player.newest, since: now, reasons: [] });
    }
    if (!row || !player.isRunning || player.mode !== "live") {
      says.notice("alarm", null);
      return;
    }
    if (now >= this.askAt) {
      this.askAt = now + CERTIFICATES_MS;
      this.latest.want();
    }
    const [late, ...found] = lately(dwells.before(player.newest, LATELY));
    if (late) {
      this.latest.want();
      found.unshift(late + whyLate(this.frontEnd, 1000 / radar.rate_hz));
    }
    const silent = now - this.since;
    if (silent > Math.max(SILENT_MS, (1000 * SILENT_DWELLS) / (radar.rate_hz || Infinity))) {
      this.latest.want();
      const why = this.reasons.length ? `: ${this.reasons.join(", ")}` : "";
      found.unshift(`No new dwell for ${fixed(silent / 1000, 0)} s${why}`);
    }
    found.push(...this.ending);
    says.notice("alarm", found.length ? `${found.join("; ")}.` : null);
  }
}

// Why nothing comes: roles without a process, and a recorder that cannot write.
function reasonsOf(processes) {
  const missing = processes.filter((one) => !one.alive && !one.name).map((one) => `no ${one.role}`);
  const full = processes.filter((one) => one.full).map((one) => `${one.name} cannot write: its disk is full, or its store is gone or away`);
  return [...full, ...missing];
}

// Whose certificate is about to end; of several only how many, and the first.
function endingOf(processes) {
  const soon = processes.filter((one) => one.certificate_days != null && one.certificate_days < SOON_DAYS);
  const [first, ...others] = soon.sort((one, other) => one.certificate_days - other.certificate_days);
  if (!first) return [];
  const more = others.length ? ` and ${others.length} more` : "";
  const when = first.certificate_days > 0 ? `ends in ${fixed(first.certificate_days, 0)} days` : "has ended";
  return [`The certificate of ${first.name}${more} ${when}`];
}

// Whether late plans are the front end's: the longest of its times in 100 dwells, beside a dwell, both in ms.
function whyLate(frontEnd, dwell) {
  if (frontEnd === null) return "";
  const took = `the front end takes up to ${fixed(frontEnd, 0)} ms of a dwell of ${fixed(dwell, 0)} ms`;
  return frontEnd > SLOW * dwell ? `, for ${took}` : `: the planners are slow (${took})`;
}

// What is wrong in these dwells: shares of plans, or nothing, of cells and of looks.
function lately(dwells) {
  const targets = dwells.flatMap((dwell) => dwell.targets.filter((one) => one.late !== null && !one.is_over));
  const blind = dwells.flatMap((dwell) => dwell.cells?.blind ?? []);
  const looks = dwells.flatMap(({ cells }) => cells ? [...cells.bin.map(() => false), ...(cells.unmeasured ?? []).map(() => true)] : []);
  const share = (all, is) => (all.length ? all.filter(is).length / all.length : 0);
  const [late, unseeing, unmeasured] = [share(targets, (one) => one.late), share(blind, (one) => one), share(looks, (one) => one)];
  const found = [late > ALARMING ? `${fixed(100 * late, 0)} % of the plans are late` : ""];
  if (unseeing > ALARMING) found.push(`${fixed(100 * unseeing, 0)} % of the cells are blind`);
  if (unmeasured > ALARMING) found.push(`${fixed(100 * unmeasured, 0)} % of the looks are not measured`);
  return found;
}
