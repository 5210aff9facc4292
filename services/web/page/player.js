// Which dwell is shown: the newest, one that was chosen, or one after the other at some speed.

export class Player {
  // `moved(t)` is called with each dwell to be shown; `turned()` when the mode changes.
  constructor(moved, turned) {
    Object.assign(this, { moved, turned, mode: "live", t: 0, oldest: 1, newest: 0, rate: 1, speed: 1, at: 0, frame: 0 });
  }

  // Another run: `rate` is its dwells per second at speed 1.
  reset(newest, rate) {
    Object.assign(this, { newest, rate, t: 0, isRunning: false });
    this.stop("live");
  }

  setNewest(newest) {
    if (newest <= this.newest) return;
    this.newest = newest;
    if (this.mode === "live") this.go(newest);
  }

  live() {
    this.stop(this.isRunning ? "live" : "paused");
    if (this.newest) this.go(this.newest);
  }

  pause() {
    this.stop("paused");
  }

  seek(t) {
    if (this.newest < 1) return;
    if (this.mode === "live") this.stop("paused");
    this.at = Math.min(Math.max(this.oldest, t), this.newest);
    this.go(this.at);
  }

  // From the oldest dwell, if it is at the last.
  play() {
    if (this.newest < 1) return;
    this.stop("playing");
    this.at = this.t >= this.newest ? this.oldest : Math.max(this.oldest, this.t);
    this.go(this.at);
    let before = performance.now();
    const step = (now) => {
      // After a pause of the browser it goes on where it was.
      this.at += (Math.min(now - before, 500) / 1000) * this.rate * this.speed;
      before = now;
      if (this.at >= this.newest) {
        this.go(this.newest);
        this.stop(this.isRunning ? "live" : "paused");
        return;
      }
      this.frame = requestAnimationFrame(step); // first: what is shown may pause it
      if (Math.floor(this.at) !== this.t) this.go(Math.floor(this.at));
    };
    this.frame = requestAnimationFrame(step);
  }

  go(t) {
    this.t = t;
    this.moved(t);
  }

  stop(mode) {
    cancelAnimationFrame(this.frame);
    this.mode = mode;
    this.turned();
  }
}
