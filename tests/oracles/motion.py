"""The motion model as it is written, for many states at once."""

import numpy as np
from numpy.typing import NDArray

from shared.tracking.motion import Motion


def propagate(states: NDArray[np.float64], motion: Motion, rng: np.random.Generator) -> NDArray[np.float64]:
    """s' = A s + G w per axis, A = [[1, dt], [0, 1]], G = [dt^2/2, dt], w drawn state by state; x clipped at 0."""
    dt, w = motion.dt, motion.sigma_s * rng.standard_normal((states.shape[0], 2))
    moved = np.empty_like(states)
    moved[:, 0::2] = states[:, 0::2] + dt * states[:, 1::2] + 0.5 * dt * dt * w
    moved[:, 1::2] = states[:, 1::2] + dt * w
    np.maximum(moved[:, 0], 0.0, out=moved[:, 0])
    return moved
