"""A belief: what is known of one target. `cogradar run paper --set radar.belief.filter=FILE.py:Bootstrap` uses it."""

import numpy as np
from numpy.typing import NDArray

from cogradar.plugins import Observation, RadarConfig

Floats = NDArray[np.float64]
JITTER = 0.1  # of the particles' own standard deviations, after resampling


class Bootstrap:
    """A bootstrap particle filter: a belief is its particles, (n, 4) of [x, vx, y, vy] in km and km/s."""

    def begin(self, radar: RadarConfig, states: Floats, rng: np.random.Generator) -> Floats:
        """The target was just found, and is in one of these equally probable states, (n, 4)."""
        return states

    def predict(self, radar: RadarConfig, belief: Floats, rng: np.random.Generator) -> Floats:
        """A dwell later: nearly constant velocity. Your own motion goes here."""
        dt = radar.motion.dt_s
        w = radar.motion.sigma_s_km_s2 * rng.standard_normal((belief.shape[0], 2))
        moved = belief.copy()
        moved[:, ::2] += dt * belief[:, 1::2] + 0.5 * dt**2 * w
        moved[:, 1::2] += dt * w
        return _in_front(moved)

    def update(
        self, radar: RadarConfig, belief: Floats, seen: Observation, rng: np.random.Generator
    ) -> tuple[Floats, float]:
        """The belief after the looks of the dwell, and how probable they were."""
        weights = seen.likelihood(belief)  # (n,)
        evidence = float(weights.mean())
        if evidence == 0.0:  # no particle explains it
            return belief, 0.0
        n = belief.shape[0]
        steps = (np.arange(n) + rng.random()) * (weights.sum() / n)
        kept = belief[np.minimum(np.searchsorted(np.cumsum(weights), steps), n - 1)]
        return _in_front(kept + JITTER * kept.std(axis=0) * rng.standard_normal(kept.shape)), evidence

    def states(self, radar: RadarConfig, belief: Floats) -> Floats:
        """Equally probable states, (n, 4), by which the planner looks."""
        return belief


def _in_front(states: Floats) -> Floats:
    """No target goes behind the array."""
    states[:, 0] = np.maximum(states[:, 0], 0.0)
    return states
