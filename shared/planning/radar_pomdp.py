"""The radar's decision as a POMDP, one per target: in which angle bin will it be next?

Symbols: s state [x, vx, y, vy]; a action, an angle bin; alpha echo amplitude, sigma_hat standard deviation of its
estimate; lambda threshold; beta = sqrt(3) sigma_hat step of the discretised observation. (Bouhou et al. 2025, Alg. 1)
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.planning.problem import implement
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.echo_laws import LAWS
from cogradar.shared.signal.radar_equation import amplitude
from cogradar.shared.tracking.motion import Motion, State, advance, draw_turn, has_turns, predicted_bins
from cogradar.shared.tracking.sensor import MAX_LEVEL, STEP, Sensor

NOTHING = 0  # the empty observation; level q of a detection is observation 1 + q


class RadarPomdp(NamedTuple):
    """One target's problem: its belief, the motion, and what the receiver will make of its echo."""

    particles: NDArray[np.float64]  # (n, 4)
    n_bin: int
    gain: float  # |alpha| / sigma_hat, with the sigma_hat expected of the next dwell; at 1 km if levels tell the range
    least: float  # |alpha_hat| / sigma_hat at the threshold, sqrt(lambda / 2)
    motion: Motion
    law: int  # number of the law of the echoes in `LAWS`, and what a search asks of it:
    fluctuates: bool
    tells_range: bool
    level: float  # width of a level of |alpha_hat| / sigma_hat; infinite where levels tell nothing: all are level 0


def problem_of(particles: NDArray[np.float64], sigma_hat: float, sensor: Sensor, motion: Motion) -> RadarPomdp:
    """The problem of a target with this belief, (n, 4), and this sigma_hat expected of the next dwell."""
    gain = sensor.amplitude / sigma_hat if sigma_hat > 0.0 else np.inf
    least, number, law = sqrt(0.5 * sensor.threshold), list(LAWS).index(sensor.rcs), sensor.law
    states, level = np.ascontiguousarray(particles), STEP if law.tells_range else np.inf
    return RadarPomdp(states, sensor.n_bin, gain, least, motion, number, law.fluctuates, law.tells_range, level)


def sample_state(problem: RadarPomdp, rng: np.random.Generator) -> State:
    """One particle of the belief."""
    s = problem.particles[int(rng.random() * problem.particles.shape[0])]
    return s[0], s[1], s[2], s[3]


def step(problem: RadarPomdp, state: State, action: int, rng: np.random.Generator) -> tuple[State, int, float, bool]:
    """Generator G(s, a): move, look into bin a, be rewarded if the target is there.

    The echo's phase is irrelevant to |alpha_hat| and taken as 0; nothing is drawn for a cell without the target.
    """
    x, vx, y, vy = state
    dealt = rng.random() if has_turns(problem.motion) else 0.0
    w_x = problem.motion.sigma_s * rng.standard_normal()
    w_y = problem.motion.sigma_s * rng.standard_normal()
    if has_turns(problem.motion):
        turn_x, turn_y = draw_turn(problem.motion, vx, vy, dealt, rng)
        w_x, w_y = w_x + turn_x, w_y + turn_y
    following = advance(x, vx, y, vy, problem.motion.dt, w_x, w_y)
    x, y = following[0], following[2]
    if bin_of(x, y, problem.n_bin) != action:
        return following, NOTHING, 0.0, False
    # Not `strength`: a call costs a rollout two fifths more.
    u = amplitude(problem.gain, x * x + y * y) if problem.tells_range else problem.gain
    if problem.fluctuates:
        r = sqrt((1.0 + u * u) * rng.standard_exponential())
    else:
        real = u + sqrt(0.5) * rng.standard_normal()
        imag = sqrt(0.5) * rng.standard_normal()
        r = sqrt(real * real + imag * imag)
    if r < problem.least:
        return following, NOTHING, 1.0, False
    return following, 1 + int(min(np.divide(r, problem.level), MAX_LEVEL)), 1.0, False


def random_action(problem: RadarPomdp, rng: np.random.Generator) -> int:
    """Any bin of the grid, all alike."""
    return int(rng.random() * problem.n_bin)


def mean_rollout(problem: RadarPomdp, n_level: int, gamma: float) -> float:
    """Expected return of uniformly random bins: (1/n_bin) sum_{d < n_level} gamma^d.

    The target is in exactly one bin at each level, whatever its state, and the random bin is that one with probability
    1/n_bin. The rollout's mean is known, and using it instead of a rollout is unbiased and has no variance.
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
    for b in np.flatnonzero(predicted_bins(particles, n_bin, dt)):
        legal[max(b - widen, 0) : b + widen + 1] = True
    return np.flatnonzero(legal)
