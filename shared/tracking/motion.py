"""Nearly constant velocity motion, for the truth and for particles.

Symbols: s = [x, vx, y, vy] state in km and km/s, x >= 0 on boresight; dt dwell in s; w acceleration noise, sigma_s its
standard deviation per axis in km/s^2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.signal.angle import bin_of


class Motion(NamedTuple):
    """Motion model: dwell in s, standard deviation of the acceleration per axis in km/s^2."""

    dt: float
    sigma_s: float


def propagate(states: NDArray[np.float64], dt: float, sigma_s: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """States one dwell later.

        s' = A s + G w,  A_b = [[1, dt], [0, 1]] and G_b = [dt^2/2, dt] per axis,  w ~ N(0, sigma_s^2 I_2)

    states  : (n, 4) km, km/s
    returns : (n, 4), x clipped at 0: a target does not go behind the array, whatever its velocity says

    After k steps without clipping the noise has added k sigma_s^2 dt^2 to the variance of a velocity and
    sigma_s^2 dt^4 sum_{i<k} (i + 1/2)^2 to that of a position. Draws (w_x, w_y) state by state.
    """
    w = sigma_s * rng.standard_normal((states.shape[0], 2))
    moved = np.empty_like(states)
    moved[:, 0::2] = states[:, 0::2] + dt * states[:, 1::2] + 0.5 * dt * dt * w
    moved[:, 1::2] = states[:, 1::2] + dt * w
    np.maximum(moved[:, 0], 0.0, out=moved[:, 0])
    return moved


@kernel
def propagate_into(
    states: NDArray[np.float64], dt: float, sigma_s: float, rng: np.random.Generator, out: NDArray[np.float64]
) -> None:
    """`propagate` of many particles into `out`, which may be `states` itself; same draws, same result."""
    half = 0.5 * dt * dt
    for i in range(states.shape[0]):
        w_x = sigma_s * rng.standard_normal()
        w_y = sigma_s * rng.standard_normal()
        out[i, 0] = max(states[i, 0] + dt * states[i, 1] + half * w_x, 0.0)
        out[i, 1] = states[i, 1] + dt * w_x
        out[i, 2] = states[i, 2] + dt * states[i, 3] + half * w_y
        out[i, 3] = states[i, 3] + dt * w_y


@kernel
def mean_state(particles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of a belief, (n, 4) -> (4,); ten times as fast as NumPy's mean over the first axis."""
    x, vx, y, vy = 0.0, 0.0, 0.0, 0.0
    for i in range(particles.shape[0]):
        x += particles[i, 0]
        vx += particles[i, 1]
        y += particles[i, 2]
        vy += particles[i, 3]
    n = particles.shape[0]
    return np.array([x / n, vx / n, y / n, vy / n])


def predict_mean(particles: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Expected state one dwell later, E(s_{t+1} | h_t) = mean over the belief of A s; (n, 4) -> (4,)."""
    x, vx, y, vy = mean_state(particles)
    return np.array([x + dt * vx, vx, y + dt * vy, vy])


@kernel
def predicted_bins(particles: NDArray[np.float64], n_bin: int, dt: float) -> NDArray[np.int64]:
    """Number of particles expected in each angle bin one dwell later, that is of A s; (n, 4) -> (n_bin,)."""
    count = np.zeros(n_bin, dtype=np.int64)
    for i in range(particles.shape[0]):
        x = max(particles[i, 0] + dt * particles[i, 1], 0.0)
        count[bin_of(x, particles[i, 2] + dt * particles[i, 3], n_bin)] += 1
    return count
