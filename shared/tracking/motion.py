"""Nearly constant velocity motion: one step of it, for the truth, for particles and for the search.

Symbols: s = [x, vx, y, vy] state in km and km/s, x >= 0 on boresight; dt dwell in s; w acceleration noise, sigma_s its
standard deviation per axis in km/s^2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import inlined, kernel
from shared.signal.angle import bin_of

State = tuple[float, float, float, float]


class Motion(NamedTuple):
    """Motion model: dwell in s, standard deviation of the acceleration per axis in km/s^2."""

    dt: float
    sigma_s: float


@inlined
def advance(x: float, vx: float, y: float, vy: float, dt: float, w_x: float, w_y: float) -> State:
    """State dt seconds later, under the acceleration (w_x, w_y) in km/s^2.

        s' = A s + G w,  A_b = [[1, dt], [0, 1]] and G_b = [dt^2/2, dt] per axis

    x is clipped at 0: a target does not go behind the array, whatever its velocity says.
    """
    half = 0.5 * dt * dt
    return max(x + dt * vx + half * w_x, 0.0), vx + dt * w_x, y + dt * vy + half * w_y, vy + dt * w_y


@inlined
def draw_acceleration(motion: Motion, rng: np.random.Generator) -> tuple[float, float]:
    """Acceleration noise of one dwell, (w_x, w_y) ~ N(0, sigma_s^2 I_2)."""
    w_x = motion.sigma_s * rng.standard_normal()
    w_y = motion.sigma_s * rng.standard_normal()
    return w_x, w_y


@kernel
def propagate_into(
    states: NDArray[np.float64], motion: Motion, rng: np.random.Generator, out: NDArray[np.float64]
) -> None:
    """States one dwell later, state by state; (n, 4) -> `out` (n, 4), which may be `states` itself.

    After k steps without clipping the noise has added k sigma_s^2 dt^2 to the variance of a velocity and
    sigma_s^2 dt^4 sum_{i<k} (i + 1/2)^2 to that of a position.
    """
    for i in range(states.shape[0]):
        w_x, w_y = draw_acceleration(motion, rng)
        s = states[i]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = advance(s[0], s[1], s[2], s[3], motion.dt, w_x, w_y)


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


@kernel
def covariance_of_state(particles: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance of a belief with this mean, E((s - m)(s - m)^T); (n, 4), (4,) -> (4, 4)."""
    sums = np.zeros((4, 4))
    for i in range(particles.shape[0]):
        for a in range(4):
            for b in range(a + 1):
                sums[a, b] += (particles[i, a] - mean[a]) * (particles[i, b] - mean[b])
    for a in range(4):
        for b in range(a + 1):
            sums[a, b] /= particles.shape[0]
            sums[b, a] = sums[a, b]
    return sums


def predicted_mean(mean: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Expected state dt seconds later, of a belief or an estimate with this mean, (4,) -> (4,).

    E(s_{t+1} | h_t) = A E(s_t | h_t), clipped as every state is: exact but for particles that are clipped.
    """
    x, vx, y, vy = mean.tolist()
    return np.array(advance(x, vx, y, vy, dt, 0.0, 0.0))


@kernel
def predicted_bins(particles: NDArray[np.float64], n_bin: int, dt: float) -> NDArray[np.int64]:
    """Number of particles expected in each angle bin one dwell later, that is of A s; (n, 4) -> (n_bin,)."""
    count = np.zeros(n_bin, dtype=np.int64)
    for i in range(particles.shape[0]):
        s = particles[i]
        x, _vx, y, _vy = advance(s[0], s[1], s[2], s[3], dt, 0.0, 0.0)
        count[bin_of(x, y, n_bin)] += 1
    return count


def predicted_states(particles: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """States expected dt seconds later, A s clipped as every state is; (n, 4) -> (n, 4)."""
    x, vx, y, vy = particles.T
    return np.column_stack((np.maximum(x + dt * vx, 0.0), vx, y + dt * vy, vy))
