"""The radar's decision as a POMDP, one per target: in which angle bin will it be next?

Symbols: s state [x, vx, y, vy]; a action, an angle bin; alpha echo amplitude, sigma_hat standard deviation of its
estimate; lambda threshold; beta = sqrt(3) sigma_hat step of the discretised observation. (Bouhou et al. 2025, Alg. 1)
"""

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.planning.pomcp import SearchResult, SearchSettings, implement, search, search_while
from shared.scenario.radar_config import RadarConfig
from shared.signal.angle import bin_of
from shared.signal.receiver import threshold
from shared.tracking.sensor import STEP

NOTHING = 0  # the empty observation; level q of a detection is observation 1 + q
MAX_LEVEL = 2.0**30  # keeps observations within the search's range

State = tuple[float, float, float, float]


class RadarPomdp(NamedTuple):
    """One target's problem: its belief, the motion, and what the receiver will make of its echo."""

    particles: NDArray[np.float64]  # (n, 4)
    n_bin: int
    amplitude: float  # |alpha| at 1 km
    sigma_hat: float  # expected of the next dwell
    level_min: float  # |alpha_hat| / sigma_hat at the threshold, sqrt(lambda / 2)
    dt: float
    sigma_s: float


def sample_state(problem: RadarPomdp, rng: np.random.Generator) -> State:
    """One particle of the belief."""
    s = problem.particles[int(rng.random() * problem.particles.shape[0])]
    return s[0], s[1], s[2], s[3]


def step(problem: RadarPomdp, state: State, action: int, rng: np.random.Generator) -> tuple[State, int, float, bool]:
    """Generator G(s, a): move, look into bin a, be rewarded if the target is there.

    The echo's phase is irrelevant to |alpha_hat| and taken as 0; nothing is drawn for a cell without the target.
    """
    x, vx, y, vy = state
    w_x = problem.sigma_s * rng.standard_normal()
    w_y = problem.sigma_s * rng.standard_normal()
    dt = problem.dt
    x = max(x + dt * vx + 0.5 * dt * dt * w_x, 0.0)
    y = y + dt * vy + 0.5 * dt * dt * w_y
    following = (x, vx + dt * w_x, y, vy + dt * w_y)
    if bin_of(x, y, problem.n_bin) != action:
        return following, NOTHING, 0.0, False
    scale = problem.sigma_hat * (x * x + y * y)
    u = problem.amplitude / scale if scale != 0.0 else np.inf  # the check also keeps the division from raising
    real = u + sqrt(0.5) * rng.standard_normal()
    imag = sqrt(0.5) * rng.standard_normal()
    magnitude = sqrt(real * real + imag * imag)
    if magnitude < problem.level_min:
        return following, NOTHING, 1.0, False
    return following, 1 + int(min(magnitude / STEP, MAX_LEVEL)), 1.0, False


def random_action(problem: RadarPomdp, rng: np.random.Generator) -> int:
    """Any bin of the grid, all alike."""
    return int(rng.random() * problem.n_bin)


def mean_rollout(problem: RadarPomdp, n_level: int, gamma: float) -> float:
    """Expected return of uniformly random bins: (1/n_bin) sum_{d < n_level} gamma^d.

    The target is in exactly one bin at each level, whatever its state, and the random bin is that one with probability
    1/n_bin: the rollout's mean is known, and using it instead of a rollout is unbiased and has no variance.
    """
    return (1.0 - gamma**n_level) / ((1.0 - gamma) * problem.n_bin)


implement(RadarPomdp, sample_state, step, random_action, mean_rollout)


def legal_actions(particles: NDArray[np.float64], n_bin: int, dt: float, widen: int) -> NDArray[np.int64]:
    """Bins worth asking for: those where a particle is expected at the next dwell, and `widen` on either side.

    particles : (n, 4), returns (n_action,) ascending. Every other bin has reward 0 and an empty observation for all
    particles: all of them are one action, and never better than these. One stray particle counts as any other: it
    costs at most 2 widen + 1 actions.
    """
    legal = np.zeros(n_bin, dtype=np.bool_)
    for b in np.flatnonzero(_expected_bins(particles, n_bin, dt)):
        legal[max(b - widen, 0) : b + widen + 1] = True
    return np.flatnonzero(legal)


@kernel
def _expected_bins(particles: NDArray[np.float64], n_bin: int, dt: float) -> NDArray[np.bool_]:
    """Whether a particle is expected in each bin at the next dwell; (n_bin,)."""
    expected = np.zeros(n_bin, dtype=np.bool_)
    for i in range(particles.shape[0]):
        x = max(particles[i, 0] + dt * particles[i, 1], 0.0)
        expected[bin_of(x, particles[i, 2] + dt * particles[i, 3], n_bin)] = True
    return expected


def plan(
    particles: NDArray[np.float64],
    sigma_hat: float,
    radar: RadarConfig,
    rng: np.random.Generator,
    has_time: Callable[[], bool] | None = None,
) -> SearchResult:
    """Search for the bin in which a target will be, from its belief.

    particles : (n, 4); sigma_hat : standard deviation of alpha_hat expected in the next dwell
    has_time  : false as soon as the search must end; without it, it makes all of the scenario's simulations
    """
    array, motion, planner = radar.array, radar.motion, radar.planner
    problem = RadarPomdp(
        np.ascontiguousarray(particles),
        array.n_bin,
        10.0 ** (radar.echo.amplitude_db / 20.0),
        sigma_hat,
        sqrt(threshold(radar.detector.p_fa) / 2.0),
        motion.dt_s,
        motion.sigma_s_km_s2,
    )
    settings = SearchSettings(
        planner.n_sim,
        planner.depth,
        planner.rollout_depth,
        planner.rollout == "mean",
        planner.gamma,
        planner.ucb_c,
    )
    if planner.actions == "belief":
        actions = legal_actions(problem.particles, array.n_bin, motion.dt_s, planner.widen_bins)
    else:
        actions = np.arange(array.n_bin)
    if has_time is not None:
        return search_while(problem, actions, settings, rng, has_time)
    return search(problem, actions, settings, rng)
