// All tracks and targets together: the distance between both in the dwell that is shown, and what the run came to so far.

import { Latest, ask, runPath } from "./api.js";
import { byId, fixed, percent, put, short } from "./text.js";

const EVERY_MS = 5000;

export class AirPicture {
  constructor() {
    this.node = byId("picture");
    this.beliefs = byId("beliefs");
    const all = (run) => Promise.all(["picture", "consistency", "confirmation"].map((name) => ask(`${runPath(run)}/${name}`)));
    this.latest = new Latest(EVERY_MS, all, (answers) => {
      if (answers) [[this.figures], this.flights, [this.found]] = answers.map((answer) => answer.rows);
      this.draw();
    });
  }

  clear() {
    this.latest.forget();
    this.figures = this.found = this.shown = null;
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

  // From visible to confirmed, where the number of targets is unknown.
  waits() {
    const { found } = this;
    if (!found) return "";
    const times = `${short(found.confirmation_median_s)} s of radar time, 95 % ${short(found.confirmation_95_s)} s`;
    return ` · confirmed after ${times}, ${found.never_found} of ${found.long_visible} never found`;
  }

  draw() {
    const { node, beliefs, shown, figures } = this;
    node.hidden = !shown || shown.gospa_km === null;
    const flown = node.hidden ? [] : this.flights.filter((row) => row.n > 0);
    beliefs.hidden = !flown.length;
    if (flown.length) {
      const means = flown.map((row) => `${row.flight} ${fixed(row.nees)}`).join(", ");
      put(beliefs, `NEES ${means} · ${percent(flown[0].beyond_99)} % beyond 99 %${this.waits()}`);
    }
    if (node.hidden) return;
    const part = (name) => short(shown[`gospa_${name}km`]);
    const soFar = figures ? ` · ${figures.swaps} swaps, ${short(figures.false_tracks_per_hour)} false/h` : "";
    put(node, `GOSPA ${part("")} km (off ${part("localisation_")}, missed ${part("missed_")}, false ${part("false_")})${soFar}`);
  }
}
