// All tracks and targets together: the distance between both in the dwell that is shown, and what the run came to so far.

import { Latest, ask, runPath } from "./api.js";
import { byId, put, short } from "./text.js";

const EVERY_MS = 5000;

export class AirPicture {
  constructor() {
    this.node = byId("picture");
    this.latest = new Latest(EVERY_MS, (run) => ask(`${runPath(run)}/picture`), (answer) => {
      if (answer) this.figures = answer.rows[0] ?? null;
      this.draw();
    });
  }

  clear() {
    this.latest.forget();
    this.figures = this.shown = null;
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
    const { node, shown, figures } = this;
    node.hidden = !shown || shown.gospa_km === null;
    if (node.hidden) return;
    const part = (name) => short(shown[`gospa_${name}km`]);
    const soFar = figures ? ` · ${figures.swaps} swaps, ${short(figures.false_tracks_per_hour)} false/h` : "";
    put(node, `GOSPA ${part("")} km (off ${part("localisation_")}, missed ${part("missed_")}, false ${part("false_")})${soFar}`);
  }
}
