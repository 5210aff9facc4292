// The run that is open: its dwells as they come or are asked for, and which of them is shown.

import { Problem, ask, runPath } from "./api.js";
import { Dwells, TRAIL } from "./dwells.js";
import { Feed } from "./feed.js";
import { Player } from "./player.js";
import { resultOf } from "./runs.js";
import * as says from "./says.js";
import { Timeline } from "./timeline.js";
import { SPEEDS, show, view } from "./view.js";

const capital = (text) => text[0].toUpperCase() + text.slice(1);
const AGAIN_MS = 2000;
const PATIENT_MS = 500; // for a dwell that is asked for
const MANY_TRACKS = 100; // at a time, if their number is unknown
const FILL_MS = 1000; // how often what a live stream leaves out is asked for

export class Session {
  // `turned()` is called when the run, or how it is watched, has changed.
  constructor(radar, turned) {
    Object.assign(this, { told: turned, picture: radar, run: null, row: null, radar: null, dwells: null, feed: null, turn: 0 });
    this.player = new Player((t) => this.moved(t), () => this.turned());
    this.timeline = new Timeline(this.player, {
      chooseSpeed: (speed) => show({ speed }),
      toggle: () => this.toggle(),
      seek: (t) => this.player.seek(t),
      live: () => this.player.live(),
    });
    document.addEventListener("visibilitychange", () => this.seen());
  }

  async open(run) {
    const turn = (this.turn += 1);
    this.close();
    this.run = run;
    let row;
    let radar;
    try {
      [row, radar] = await Promise.all([ask(runPath(run)), ask(`${runPath(run)}/radar`)]);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      if (turn === this.turn) this.missing(error);
      return;
    }
    if (turn !== this.turn) return;
    says.notice("outage", null);
    says.notice("begun", null);
    says.notice("measured", null);
    [this.row, this.radar] = [row, radar];
    this.dwells = new Dwells(run, radar.is_unknown ? MANY_TRACKS : radar.targets);
    says.heading(radar);
    this.picture.open(radar, this.dwells);
    const rate = radar.rate_hz || 1 / radar.dt_s;
    this.player.reset(row.t, rate);
    this.player.isRunning = row.status === "running";
    this.player.speed = view.speed ?? (rate <= 2 ? 10 : 1);
    this.timeline.reset(run, radar.dwells, radar.is_unknown);
    if (!this.player.isRunning) this.over(row.status, row.reason);
    else if (!document.hidden) this.follow();
    if (view.dwell !== null) this.player.seek(view.dwell);
    else this.player.live();
    if (!row.t) says.empty(this.player.isRunning ? (radar.is_unknown ? "Waiting for the first dwell …" : "Searching for the targets …") : `This run has no dwell: ${resultOf(row)}.`);
    this.turned();
  }

  close() {
    this.feed?.close();
    this.dwells?.close();
    clearTimeout(this.timer);
    Object.assign(this, { feed: null, row: null, isUp: undefined, isDown: false, isSilent: false, filled: 0, scans: 0 });
    says.notice("dwell", null);
    this.player.reset(0, 1);
  }

  // Grows with each dwell, and before the first one with each scan of the search.
  get news() {
    return this.player.newest + this.scans;
  }

  // Whether a dwell is overdue of a run that is watched live.
  silent(isSilent) {
    if (isSilent === this.isSilent) return;
    this.isSilent = isSilent;
    this.turned();
  }

  // A hidden page needs no stream: a browser has six connections to a service, for all of its pages.
  async seen() {
    if (document.hidden) {
      this.feed?.close();
      Object.assign(this, { feed: null, isUp: undefined });
      this.turned();
    } else if (this.player.isRunning && !this.feed) {
      const { turn } = this;
      await this.check();
      if (turn === this.turn && this.player.isRunning && !this.feed && !document.hidden) this.follow();
    }
  }

  // The run was there, and is not any more.
  gone() {
    if (this.row) this.missing(new Problem(404, "no such run"));
  }

  // A question that is not about this run had no answer: of a run that is over no stream would say so.
  unanswered(problem) {
    if (this.player.isRunning || !this.row || problem.isFinal) return;
    this.isDown = true;
    this.disconnected(problem.message);
  }

  missing(problem) {
    if (problem.isFinal) {
      this.close();
      this.dwells = null;
      this.picture.open(null, null);
      this.timeline.reset(null, 1, false);
      says.noHeading();
      says.notice("outage", null);
      says.badge("gone", problem.status === 404 ? "No such run" : "No run");
      says.empty(problem.status === 404 ? `There is no run ${this.run} here. Choose one under Runs.` : `${problem.message}.`);
      return;
    }
    this.disconnected(problem.message);
    this.timer = setTimeout(() => this.open(this.run), AGAIN_MS);
  }

  disconnected(message) {
    says.badge("down", "Reconnecting");
    says.notice("outage", `${message}. The page goes on by itself once the service is back (cogradar run … --keep, or cogradar service metrics --http).`);
    if (!this.player.t) says.empty("Not connected.");
  }

  follow() {
    const { run } = this;
    this.feed = new Feed(run, {
      dwell: (dwell) => {
        if (dwell.run !== run) return;
        this.began = performance.now();
        this.dwells.put(dwell);
        this.player.setNewest(dwell.t);
        const isBlank = dwell.cells && !dwell.cells.bin.length;
        says.notice("measured", isBlank ? `Nothing is measured${dwell.cells.fault ? `: ${dwell.cells.fault}` : ""}.` : null);
        this.timeline.moved();
        this.timeline.refresh();
      },
      acquisition: (scan) => {
        this.scans = scan.scans;
        const found = scan.tracks.filter((track) => track.status === "tracking").length;
        const nearest = scan.strongest ? `; ${scan.strongest}` : "";
        const isBlank = scan.cells && !scan.cells.bin.length;
        const fault = isBlank ? ` Nothing is measured${scan.cells.fault ? `: ${scan.cells.fault}` : ""}.` : "";
        says.empty(`Searching: ${found} of ${scan.tracks.length} tracks confirmed after ${scan.scans} scans${nearest}.${fault}`);
      },
      end: ({ status, reason, t }) => {
        this.player.setNewest(t);
        if (status === "dropped") this.gone();
        else this.over(status, reason);
      },
      up: (isUp) => {
        if (isUp === this.isUp) return;
        this.isUp = isUp;
        if (isUp) says.notice("outage", null);
        else this.disconnected("The service does not answer");
        this.turned();
      },
      check: () => this.check(),
    });
  }

  // A stream that was refused: the run may be over, or gone.
  async check() {
    const { run, turn } = this;
    try {
      const row = await ask(runPath(run));
      if (turn !== this.turn || row.status === "running") return;
      this.isUp = true;
      says.notice("outage", null);
      this.player.setNewest(row.t);
      this.over(row.status, row.reason);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      if (error.isFinal && turn === this.turn) this.missing(error);
    }
  }

  over(status, reason) {
    this.feed?.close();
    this.feed = null;
    Object.assign(this.row, { status, reason });
    this.player.isRunning = false;
    if (this.player.mode === "live") this.player.mode = "paused";
    this.timeline.refresh();
    this.turned();
  }

  toggle() {
    const { player } = this;
    if (player.mode === "playing" || (player.mode === "live" && player.isRunning)) player.pause();
    else player.play();
  }

  faster(steps) {
    const at = SPEEDS.indexOf(this.player.speed) + steps;
    show({ speed: SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)] });
  }

  setSpeed(speed) {
    this.player.speed = speed;
    this.timeline.turned();
  }

  // Dwell t is to be shown; what is not at hand is asked for.
  async moved(t) {
    const began = this.began ?? performance.now();
    this.began = null;
    const { dwells, player, turn } = this;
    dwells.at = t;
    this.timeline.moved();
    const isFollowing = player.mode === "live" && player.isRunning;
    // The last dwell of a run that is over is where a page stands that waits for the next run.
    const isAtEnd = view.follows && !player.isRunning && player.mode === "paused" && t === player.newest;
    show({ dwell: isFollowing || isAtEnd ? null : t });
    const isCalm = player.mode === "paused";
    const here = dwells.get(t);
    if (here) this.picture.show(here, began, isCalm);
    if (here) says.notice("dwell", null);
    if (isFollowing && here && !this.isToFill(t)) {
      this.answered();
      return;
    }
    try {
      if (!here && player.mode !== "playing") {
        const meanwhile = setTimeout(() => this.meanwhile(t, turn), PATIENT_MS);
        const came = await dwells.one(t).finally(() => clearTimeout(meanwhile));
        if (turn !== this.turn || player.t !== t) return;
        if (came) this.picture.show(came, began, isCalm);
        says.notice("dwell", came ? null : `Dwell ${t} is not stored.`);
      }
      const came = await dwells.around(t, player.newest, player.mode === "playing" ? 30 * Math.max(1, player.speed / 5) : 0);
      if (turn !== this.turn) return;
      this.answered();
      const now = came ? dwells.get(player.t) : null;
      if (now) this.picture.show(now, null, player.mode === "paused");
    } catch (error) {
      if (error.name === "AbortError") return;
      if (!(error instanceof Problem)) throw error;
      this.isDown = true;
      this.disconnected(error.message);
      clearTimeout(this.timer);
      this.timer = setTimeout(() => turn === this.turn && this.moved(this.player.t), AGAIN_MS);
    }
  }

  // Dwell t takes long: the scores of a long run are worked out when somebody looks at it first. The oldest dwell is
  // there sooner.
  async meanwhile(t, turn) {
    const { dwells, player } = this;
    const isAwaited = () => turn === this.turn && player.t === t && !dwells.get(t);
    const what = `Dwell ${t} is on its way: the scores of the run up to there are worked out first`;
    if (!isAwaited()) return;
    says.empty(this.picture.dwell ? null : `${what} …`);
    if (this.picture.dwell) says.notice("dwell", `${what}.`);
    if (this.picture.dwell || this.row.oldest_t >= t) return;
    try {
      const first = await dwells.one(this.row.oldest_t);
      if (!first || !isAwaited()) return;
      this.picture.show(first, null, true);
      says.notice("dwell", `${what}. Meanwhile this is dwell ${first.t}.`);
    } catch (error) {
      if (error.name !== "AbortError" && !(error instanceof Problem)) throw error;
    }
  }

  // Whether dwells before this one, of a live run, are to be asked for: a page that was just opened has none, and a
  // stream leaves some out of a run that is faster.
  isToFill(t) {
    const now = performance.now();
    if (now - this.filled < FILL_MS || this.dwells.before(t, TRAIL / 2).length >= Math.min(t, TRAIL / 2)) return false;
    this.filled = now;
    return true;
  }

  // The service answers again.
  answered() {
    if (!this.isDown) return;
    this.isDown = false;
    if (this.isUp !== false) says.notice("outage", null);
    this.turned();
  }

  turned() {
    this.timeline.turned();
    if (this.row) this.told();
    if (!this.row || this.isUp === false || this.isDown) return;
    const { player } = this;
    const { status } = this.row;
    // A dwell that was asked for shows nothing of the stream: it is live once the stream has opened.
    if (status === "running" && !this.isUp) says.badge("waiting", "Connecting");
    else if (status === "running" && player.mode !== "live") says.badge("behind", "Live, looking back");
    else if (status === "running") says.badge(this.isSilent ? "overdue" : "live", this.isSilent ? "Live, no new dwell" : "Live");
    else says.badge(status, capital(resultOf(this.row)));
    if (player.mode === "paused" && this.picture.dwell) this.picture.show(this.picture.dwell, null, true);
  }
}
