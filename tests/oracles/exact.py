"""The depth-2 value of every bin by its definition, and beliefs to try it on."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.planning.exact import MOST_U
from cogradar.shared.planning.radar_pomdp import RadarPomdp, problem_of
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import Sensor, log_level_probability, log_miss_probability

THRESHOLD = -2.0 * np.log(1e-4)
N_LEVEL = 42


def moved(particles: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    x, vx, y, vy = particles.T
    return np.column_stack((np.maximum(x + dt * vx, 0.0), vx, y + dt * vy, vy))


def slow_values(problem: RadarPomdp, gamma: float, rcs: str = "known") -> NDArray[np.float64]:
    """Q(a) of every bin of the grid by its definition."""
    first, n = moved(problem.particles, problem.motion.dt), problem.particles.shape[0]
    now, then = (
        angle_bin(spatial_frequency(states), problem.n_bin) for states in (first, moved(first, problem.motion.dt))
    )
    with np.errstate(divide="ignore"):
        u = np.minimum(problem.gain / (first[:, 0] ** 2 + first[:, 2] ** 2), MOST_U)
    if rcs == "unknown":
        u = np.full(u.size, min(problem.gain, MOST_U))
    said = [np.exp(log_miss_probability(THRESHOLD, u, rcs))]
    n_level = {"known": N_LEVEL, "mean": 5 * N_LEVEL, "unknown": 1}[rcs]
    said += [np.exp(log_level_probability(q, THRESHOLD, u, rcs)) for q in range(1, n_level)]
    if rcs == "unknown":
        said.append(1.0 - said[0])
    values = np.zeros(problem.n_bin)
    for a in range(problem.n_bin):
        values[a] = np.mean(now == a)
        for observation, probability in enumerate(said):
            if observation == 0 or a in now:
                chance = np.where(now == a, probability, float(observation == 0))
                values[a] += gamma * np.bincount(then, weights=chance).max() / n
    return values


def belief(seed: int, n_bin: int, range_km: float, spread: float, u: float, rcs: str = "known") -> RadarPomdp:
    """A belief in up to three clusters, and echoes of strength u at its middle."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-1.5, 1.5)
    centre = np.array([range_km * np.cos(angle), 0.0, range_km * np.sin(angle), 0.0])
    clusters = centre + spread * np.array([1.0, 0.2, 1.0, 0.2]) * rng.standard_normal((3, 4))
    particles = clusters[rng.integers(3, size=80)] + 0.3 * spread * rng.standard_normal((80, 4))
    particles[:, 0] = np.maximum(particles[:, 0], 0.0)
    sensor = Sensor(n_bin, 60.0, THRESHOLD, rcs=rcs, echo=(1000.0 / range_km**2) ** 2)
    sigma_hat = 1000.0 / (u * range_km**2) if u > 0.0 else 1e30
    return problem_of(particles, sigma_hat, sensor, Motion(1.0, 0.004))


beliefs = st.builds(
    belief,
    st.integers(0, 2**32),
    st.integers(3, 100),
    st.floats(5.0, 150.0),
    st.floats(0.1, 20.0),
    st.floats(0.0, 70.0),
)
