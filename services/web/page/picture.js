// All tracks and targets together: the distance between both in the dwell that is shown, and what the run came to so far.

import { Latest, ask, runPath } from "./api.js";
import { byId, fixed, percent, put, short } from "./text.js";

const EVERY_MS = 5000;

export class AirPicture {
  constructor() {
    this.node = byId("picture");
    this.beliefs = byId("beliefs");
    const both = (run) => Promise.all([ask(`${runPath(run)}/picture`), ask(`${runPath(run)}/consistency`)]);
    this.latest = new Latest(EVERY_MS, both, (answers) => {
      if (answers) [this.figures, this.flights] = [answers[0].rows[0] ?? null, answers[1].rows];
      this.draw();
    });
  }

  clear() {
    this.latest.forget();
    this.figures = this.shown = null;
    this.flights = [];
    this.t = 0; // the newest dwell that was shown
    this.draw();
  }

  // Without truth there is nothing to say.
  show({ radar, dwell }) {
    this.shown = dwell.picture;
    if (radar.has_truth && dwell.t > this.t) this.latest.want(radar.run);
    this.t = Math.max(this.t, dwell.t);
    this.draw();
  }

  draw() {
    const { node, beliefs, shown, figures } = this;
    node.hidden = !shown || shown.gospa_km === null;
    const flown = node.hidden ? [] : this.flights.filter((row) => row.n > 0);
    beliefs.hidden = !flown.length;
    if (flown.length) {
      const means = flown.map((row) => `${row.flight} ${fixed(row.nees)}`).join(", ");
      put(beliefs, `NEES ${means} · ${percent(flown[0].beyond_99)} % beyond 99 %`);
    }
    if (node.hidden) return;
    const part = (name) => short(shown[`gospa_${name}km`]);
    const soFar = figures ? ` · ${figures.swaps} swaps, ${short(figures.false_tracks_per_hour)} false/h` : "";
    put(node, `GOSPA ${part("")} km (off ${part("localisation_")}, missed ${part("missed_")}, false ${part("false_")})${soFar}`);
  }
}
