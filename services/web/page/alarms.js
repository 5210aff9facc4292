// What is wrong with a run that is watched live, in a line: a role has no process; it stands still, and why; plans are
// late, and for whom; waveforms are stale; cells are blind, looks are not measured, a certificate is about to end.

import { Latest, ask } from "./api.js";
import * as says from "./says.js";
import { fixed } from "./text.js";

const EVERY_MS = 500;
const ASK_MS = 1500;
const SILENT_MS = 2000; // in real time; or so many dwells without one:
const SILENT_DWELLS = 5;
const LOCKSTEP_MS = 6000; // ... where no rate says when the next one is due
const LATELY = 20; // dwells over which shares are counted
const ROLES_MS = 5000; // between two looks at the processes of a run that seems well
const START_S = 5; // from the start of a process to its first dwell
const SOON_DAYS = 30;
const SLOW = 0.5; // of a dwell, after which a scan leaves too little for the plans
const ALARMING = 0.05; // of plans that are late, of waveforms that are stale, of cells that are blind, of looks that are not measured

export class Alarms {
  constructor(session) {
    Object.assign(this, { session, run: null, news: 0, since: 0, found: null, cause: null, ending: [], askAt: 0 });
    this.latest = new Latest(ASK_MS, () => ask("/processes"), (answer) => {
      Object.assign(this, { found: answer, foundAt: performance.now() });
      this.ending = answer ? endingOf(answer.processes) : this.ending;
    });
    setInterval(() => document.hidden || this.look(), EVERY_MS);
  }

  look() {
    const { session } = this;
    const { player, radar, dwells, row } = session;
    const now = performance.now();
    if (session.run !== this.run || session.news !== this.news || !player.isRunning || document.hidden) {
      Object.assign(this, { run: session.run, news: session.news, since: now });
    }
    if (!row || !player.isRunning || player.mode !== "live") {
      says.notice("alarm", null);
      Object.assign(this, { found: null, cause: null });
      session.silent(false);
      return;
    }
    const [late, ...found] = lately(dwells.before(player.newest, LATELY));
    const silent = now - this.since;
    const isSilent = silent > (radar.rate_hz ? Math.max(SILENT_MS, (1000 * SILENT_DWELLS) / radar.rate_hz) : LOCKSTEP_MS);
    session.silent(isSilent);
    if (late || isSilent || (radar.has_processes && now >= this.askAt)) {
      this.askAt = now + ROLES_MS;
      this.latest.want();
    }
    if (late || isSilent) this.wrong ??= now;
    else this.wrong = null;
    const missing = missingOf(this.found);
    if (late) found.unshift(late + (missing.length ? "" : this.whyLate(radar.rate_hz, now)));
    if (isSilent) {
      this.cause = { until: now, text: "the run stood still" };
      const why = [...fullOf(this.found), ...missing.map((role) => `no ${role}`), ...awayOf(this.found).map((name) => `${name} does not answer`)].join(", ");
      found.unshift(`No new dwell for ${fixed(silent / 1000, 0)} s${why && `: ${why}`}`);
    } else {
      found.unshift(...missing.map((role) => `No ${role}${WITHOUT[role] ?? ""}`));
    }
    found.push(...this.ending);
    says.notice("alarm", found.length ? `${found.join("; ")}.` : null);
  }

  // Why plans are late: a planner is away or was until a moment ago, or the run stood still; else whether the front end
  // takes too much of a dwell, by the longest of its times in 100 dwells.
  whyLate(rate, now) {
    if (!this.found || this.foundAt < this.wrong) return ""; // an answer from before says nothing of it
    const { processes, utc_s: at } = this.found;
    const planners = processes.filter((one) => one.role === "planner");
    const [away] = awayOf({ processes: planners });
    if (away) {
      this.cause = { until: now, text: `${away} did not answer` };
      return `: ${away} does not answer`;
    }
    const age = (one) => Math.max(at - one.began_utc_s, 0);
    const young = planners.find((one) => one.began_utc_s !== null && (one.starting || age(one) < START_S + LATELY / rate));
    if (young) return `: ${young.name} was started ${fixed(age(young), 0)} s ago`;
    if (this.cause && now - this.cause.until < ASK_MS + (1000 * LATELY) / rate) return `: ${this.cause.text} until a moment ago`;
    const frontEnd = processes.find((one) => one.front_end_p99_ms !== null)?.front_end_p99_ms ?? null;
    if (frontEnd === null) return "";
    const dwell = 1000 / rate;
    const took = `the front end takes up to ${fixed(frontEnd, 0)} ms of a dwell of ${fixed(dwell, 0)} ms`;
    return frontEnd > SLOW * dwell ? `, for ${took}` : `: the planners are slow (${took})`;
  }
}

const WITHOUT = { // what comes of it that a role has no process
  planner: ": tracks are not updated",
  allocator: ": waveforms are not updated",
  emulator: ": nothing is transmitted",
  recorder: ": no dwell is recorded",
};
const missingOf = (answer) => answer?.processes.filter((one) => !one.alive && !one.name).map((one) => one.role) ?? [];
const awayOf = (answer) => answer?.processes.filter((one) => one.name && !one.answers).map((one) => one.name) ?? [];
const fullOf = (answer) => answer?.processes.filter((one) => one.full).map((one) => `${one.name} cannot write: its disk is full, or its store is gone or away`) ?? [];

// Whose certificate is about to end; of several only how many, and the first.
function endingOf(processes) {
  const soon = processes.filter((one) => one.certificate_days != null && one.certificate_days < SOON_DAYS);
  const [first, ...others] = soon.sort((one, other) => one.certificate_days - other.certificate_days);
  if (!first) return [];
  const more = others.length ? ` and ${others.length} more` : "";
  const when = first.certificate_days > 0 ? `ends in ${fixed(first.certificate_days, 0)} days` : "has ended";
  return [`The certificate of ${first.name}${more} ${when}`];
}

// What is wrong in these dwells: shares of plans, or nothing, of waveforms, cells and looks.
function lately(dwells) {
  const targets = dwells.flatMap((dwell) => dwell.targets.filter((one) => one.late !== null && !one.is_over));
  const blind = dwells.flatMap((dwell) => dwell.cells?.blind ?? []);
  const looks = dwells.flatMap(({ cells }) => cells ? [...cells.bin.map(() => false), ...(cells.unmeasured ?? []).map(() => true)] : []);
  const share = (all, is) => (all.length ? all.filter(is).length / all.length : 0);
  const [late, old, unseeing, unmeasured] = [share(targets, (one) => one.late), share(dwells, (one) => one.stale), share(blind, (one) => one), share(looks, (one) => one)];
  const found = [late > ALARMING ? `${fixed(100 * late, 0)} % of the plans are late` : ""];
  if (old > ALARMING) found.push(`${fixed(100 * old, 0)} % of the waveforms are stale`);
  if (unseeing > ALARMING) found.push(`${fixed(100 * unseeing, 0)} % of the cells are blind`);
  if (unmeasured > ALARMING) found.push(`${fixed(100 * unmeasured, 0)} % of the looks are not measured`);
  return found;
}
