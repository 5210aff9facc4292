"""The motion model as it is written, for many states at once."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.tracking.motion import Motion


def propagate(states: NDArray[np.float64], motion: Motion, rng: np.random.Generator) -> NDArray[np.float64]:
    """s' = A s + G w per axis, A = [[1, dt], [0, 1]], G = [dt^2/2, dt], w drawn state by state; x clipped at 0."""
    dt, w = motion.dt, motion.sigma_s * rng.standard_normal((states.shape[0], 2))
    moved = np.empty_like(states)
    moved[:, 0::2] = states[:, 0::2] + dt * states[:, 1::2] + 0.5 * dt * dt * w
    moved[:, 1::2] = states[:, 1::2] + dt * w
    np.maximum(moved[:, 0], 0.0, out=moved[:, 0])
    return moved


def propagate_mixture(states: NDArray[np.float64], motion: Motion, rng: np.random.Generator) -> NDArray[np.float64]:
    """One target after the other, velocities as complex numbers: a turn is a factor, its chord the mean of its ends."""
    moved, most_g = np.empty_like(states), {0: (0.0, 0.0), 1: (3.0, 0.0), 2: (9.0, 3.0)}
    for i, (x, vx, y, vy) in enumerate(states.tolist()):
        w, v = complex(*(motion.sigma_s * rng.standard_normal(2))), complex(vx, vy)
        dealt = i * 0.7548776662466927 % 1.0  # 1/p, p^3 = p + 1
        mode = 2 if dealt < motion.hard else 1 if dealt < motion.hard + motion.turning else 0
        turned = v
        if mode:
            across, along = (2.0 * rng.random(2) - 1.0) * np.array(most_g[mode]) * 9.80665e-3 * motion.dt / abs(v)
            turned = v * (1.0 + along) * np.exp(1j * across)
        place = complex(x, y) + 0.5 * motion.dt * (v + turned) + 0.5 * motion.dt**2 * w
        velocity = turned + motion.dt * w
        moved[i] = max(place.real, 0.0), velocity.real, place.imag, velocity.imag
    return moved
