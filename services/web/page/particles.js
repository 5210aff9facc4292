// The particle cloud of the chosen target, when it is asked for.

import { Latest, ask, runPath } from "./api.js";
import { byId, put } from "./text.js";
import { view } from "./view.js";

const EVERY_MS = 700;
const FAR = 12; // dwells between cloud and picture beyond which it would mislead

export class Particles {
  constructor(came) {
    this.cloud = null;
    this.latest = new Latest(
      EVERY_MS,
      (run, kind, number, t) => ask(`${runPath(run)}/particles?${kind}=${number}&dwell=${t}`),
      (cloud, problem) => {
        this.cloud = cloud && { ...cloud, target: cloud.target ?? cloud.track };
        if (problem && !problem.isFinal) this.key = null;
        byId("particles").title = problem ? problem.message : "Particle cloud of the chosen target (p)";
        byId("particles").dataset.problem = problem ? "1" : "";
        put(byId("particles"), problem ? "Particles: none" : "Particles");
        came();
      },
    );
  }

  clear() {
    this.cloud = this.key = null;
    this.latest.forget();
  }

  // The cloud for this picture, or one of a moment ago.
  of(run, dwell) {
    byId("particles").setAttribute("aria-pressed", String(view.particles));
    byId("particles").disabled = view.target === null;
    if (!view.particles || !dwell || view.target === null) return null;
    const key = `${run} ${view.target} ${dwell.t}`;
    if (key !== this.key) {
      this.key = key;
      this.latest.want(run, dwell.tracks ? "track" : "target", view.target, dwell.t);
    }
    const { cloud } = this;
    return cloud && cloud.target === view.target && Math.abs(cloud.t - dwell.t) <= FAR ? cloud : null;
  }
}
