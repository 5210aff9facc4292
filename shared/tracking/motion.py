"""Motion of a target: one step of it, for particles and for the search; nearly constant velocity, or a mixture.

Symbols: s = [x, vx, y, vy] state in km and km/s, x >= 0 on boresight; dt dwell in s; w acceleration, sigma_s standard
deviation of its noise per axis in km/s^2.

The mixture has three modes. In each there is the noise. In a turn the velocity is also rotated by an acceleration
across it of up to 3 g. In a hard turn it is up to 9 g, while the target brakes or speeds up with up to 3 g. All of them
are uniform and drawn anew in each dwell. A belief remembers of a manoeuvre how probable the modes are. A Markov chain
takes that from dwell to dwell, and the likelihood of each mode's particles corrects it (generalised pseudo-Bayesian
estimator of first order; Bar-Shalom, Li and Kirubarajan 2001, ch. 11.6). A particle has no mode of its own: the modes
are dealt out over the particles anew in each dwell, as evenly as can be.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import exp
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.numerics.linear import multiply, product
from cogradar.shared.signal.angle import bin_of

State = tuple[float, float, float, float]

MODES = ("straight", "turn", "hard turn")
STRAIGHT, TURN, HARD = 0, 1, 2
CERTAINLY_STRAIGHT, CERTAINLY_HARD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_G = 9.80665e-3  # standard gravity, km/s^2
_ACROSS = np.array([0.0, 3.0, 9.0]) * _G  # most acceleration across the velocity, by mode,
_ALONG = np.array([0.0, 0.0, 3.0]) * _G  # ... and along it
_LASTS_S = np.array([100.0, 6.0, 6.0])  # mean time in a mode
_NEXT = np.array([[0.0, 0.5, 0.5], [0.9, 0.0, 0.1], [0.9, 0.1, 0.0]])  # mode after it, one row each
_SLOWEST = 1e-3  # km/s: keeps an angle finite
# Steps of an additive recurrence that fills the unit square evenly, one from the other independently: 1/p and 1/p^2,
# p^3 = p + 1 (Roberts 2018). Particles beside each other come from one ancestor, and must not share a mode.
_DEAL, _DEAL_SQ = 0.7548776662466927, 0.5698402909980532


class Motion(NamedTuple):
    """Motion model: dwell in s, standard deviation of the acceleration per axis in km/s^2; chances of turns in it."""

    dt: float
    sigma_s: float
    turning: float = 0.0
    hard: float = 0.0


@inlined
def advance(x: float, vx: float, y: float, vy: float, dt: float, w_x: float, w_y: float) -> State:
    """State dt seconds later, under the acceleration (w_x, w_y) in km/s^2.

        s' = A s + G w,  A_b = [[1, dt], [0, 1]] and G_b = [dt^2/2, dt] per axis

    x is clipped at 0: a target does not go behind the array, whatever its velocity says.
    """
    half = 0.5 * dt * dt
    return max(x + dt * vx + half * w_x, 0.0), vx + dt * w_x, y + dt * vy + half * w_y, vy + dt * w_y


@inlined
def mode_quantile(i: int) -> float:
    """What decides on the mode of the next dwell of particle i: evenly in 0 .. 1."""
    return (i * _DEAL) % 1.0


@inlined
def has_turns(motion: Motion) -> bool:
    """Whether any particle turns in the next dwell."""
    return motion.turning + motion.hard > 0.0


@inlined
def mode_of(motion: Motion, dealt: float) -> int:
    """Mode of the next dwell, of whom this number in 0 .. 1 is dealt."""
    if dealt < motion.hard:
        return HARD
    return TURN if dealt < motion.hard + motion.turning else STRAIGHT


@inlined
def turned(vx: float, vy: float, dt: float, across: float, along: float) -> tuple[float, float]:
    """Acceleration (w_x, w_y) that rotates a velocity as one across it does for dt, and makes it faster.

    v' = (1 + a_along dt / |v|) R(a_across dt / |v|) v = v + dt w
    """
    # np.divide: "/" can raise, and a loop that can raise counts references to its arrays, turns or not.
    turn = np.divide(dt, max(np.sqrt(vx * vx + vy * vy), _SLOWEST))
    c, s, faster = np.cos(across * turn), np.sin(across * turn), 1.0 + along * turn
    return np.divide(faster * (c * vx - s * vy) - vx, dt), np.divide(faster * (s * vx + c * vy) - vy, dt)


@kernel
def draw_turn(motion: Motion, vx: float, vy: float, dealt: float, rng: np.random.Generator) -> tuple[float, float]:
    """Acceleration (w_x, w_y) of one dwell's turn, of a target with this velocity; none if it flies straight.

    A kernel of its own, and the callers draw the noise: an inlined function that takes the generator makes the compiler
    count references in its callers' loops, which costs a rollout a third more.
    """
    mode = mode_of(motion, dealt)
    if mode == STRAIGHT:
        return 0.0, 0.0
    across, along = _ACROSS[mode] * (2.0 * rng.random() - 1.0), _ALONG[mode] * (2.0 * rng.random() - 1.0)
    return turned(vx, vy, motion.dt, across, along)


@kernel
def propagate_into(
    states: NDArray[np.float64], motion: Motion, rng: np.random.Generator, out: NDArray[np.float64]
) -> None:
    """States one dwell later, state by state; (n, 4) -> `out` (n, 4), which may be `states` itself.

    Of a mixture the particles are dealt the modes in turn, and draw what acceleration theirs has.

    After k steps without clipping the noise has added k sigma_s^2 dt^2 to the variance of a velocity and
    sigma_s^2 dt^4 sum_{i<k} (i + 1/2)^2 to the variance of a position.
    """
    for i in range(states.shape[0]):
        x, vx, y, vy = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        w_x = motion.sigma_s * rng.standard_normal()
        w_y = motion.sigma_s * rng.standard_normal()
        if has_turns(motion):
            turn_x, turn_y = draw_turn(motion, vx, vy, mode_quantile(i), rng)
            w_x, w_y = w_x + turn_x, w_y + turn_y
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = advance(x, vx, y, vy, motion.dt, w_x, w_y)


def modes_at_first() -> NDArray[np.float64]:
    """Probabilities of the modes of a target of which nothing else is known, (3,): it flies straight, or began to."""
    return modes_after(CERTAINLY_STRAIGHT, 1.0)


def modes_after(modes: NDArray[np.float64], dt: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities of the modes dt seconds later, (3,) -> (3,), or (M, 3) and (M, 1); a mode lasts exponentially."""
    stays = exp(-dt / _LASTS_S)
    return np.asarray(stays * modes + product((1.0 - stays) * modes, _NEXT))


@kernel
def modes_told(weights: NDArray[np.float64], motion: Motion) -> NDArray[np.float64]:
    """Probabilities of the modes of a dwell after its observation, (3,), from the weights of particles, (n,)."""
    if not has_turns(motion):
        return CERTAINLY_STRAIGHT.copy()
    told = np.zeros(_ACROSS.size)
    for i in range(weights.size):
        told[mode_of(motion, mode_quantile(i))] += weights[i]
    told /= told.sum()
    return told


def mean_state(particles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of a belief, (n, 4) -> (4,); ten times as fast as NumPy's mean over the first axis."""
    return np.asarray(weighted_sum(particles, np.ones(particles.shape[0])) / particles.shape[0])


def covariance_of_state(particles: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance of a belief with this mean, E((s - m)(s - m)^T); (n, 4), (4,) -> (4, 4)."""
    return np.asarray(weighted_squares(particles, np.ones(particles.shape[0]), mean) / particles.shape[0])


@kernel
def weighted_sum(states: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """sum_i w_i s_i; (n, 4), (n,) -> (4,)."""
    x, vx, y, vy = 0.0, 0.0, 0.0, 0.0
    for i in range(weights.size):
        w = weights[i]
        x += w * states[i, 0]
        vx += w * states[i, 1]
        y += w * states[i, 2]
        vy += w * states[i, 3]
    return np.array([x, vx, y, vy])


@kernel
def weighted_squares(
    states: NDArray[np.float64], weights: NDArray[np.float64], mean: NDArray[np.float64]
) -> NDArray[np.float64]:
    """sum_i w_i (s_i - m)(s_i - m)^T; (n, 4), (n,), (4,) -> (4, 4).

    Ten numbers are faster than an array of them, which would be read and written for every state.
    """
    xx, vx, vv, yx, yv, yy, ux, uv, uy, uu = (0.0,) * 10
    m_x, m_v, m_y, m_u = mean
    for i in range(weights.size):
        w = weights[i]
        x, v, y, u = states[i, 0] - m_x, states[i, 1] - m_v, states[i, 2] - m_y, states[i, 3] - m_u
        w_v, w_y, w_u = w * v, w * y, w * u
        xx, vx, vv = xx + w * x * x, vx + w_v * x, vv + w_v * v
        yx, yv, yy = yx + w_y * x, yv + w_y * v, yy + w_y * y
        ux, uv, uy, uu = ux + w_u * x, uv + w_u * v, uy + w_u * y, uu + w_u * u
    return np.array([[xx, vx, yx, ux], [vx, vv, yv, uv], [yx, yv, yy, uy], [ux, uv, uy, uu]])


def predicted_mean(mean: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Expected state dt seconds later, of a belief or an estimate with this mean, (4,) -> (4,).

    E(s_{t+1} | h_t) = A E(s_t | h_t), clipped as every state is: exact but for particles that are clipped.
    """
    x, vx, y, vy = mean.tolist()
    return np.array(advance(x, vx, y, vy, dt, 0.0, 0.0))


@kernel
def predicted_moments(
    means: NDArray[np.float64],
    covariances: NDArray[np.float64],
    modes: NDArray[np.float64],
    dt: NDArray[np.float64],
    sigma_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means, (M, 4), and covariances, (M, 4, 4), of beliefs dt seconds later, (M,); with dt = 0 as they are.

    The covariance is A P A^T + sigma^2 G G^T, sigma^2 with the mean of the turns of that time.

    modes : (M, 3) probabilities of the modes in it
    """
    moved, spread, a, by = np.empty_like(means), np.empty_like(covariances), np.eye(4), np.zeros(2)
    for m in range(dt.size):
        if dt[m] == 0.0:
            moved[m], spread[m] = means[m], covariances[m]
            continue
        moved[m] = np.array(advance(means[m, 0], means[m, 1], means[m, 2], means[m, 3], dt[m], 0.0, 0.0))
        a[0, 1] = a[2, 3] = dt[m]
        spread[m] = multiply(multiply(a, covariances[m]), a.T)
        # A uniform acceleration of at most a along one of two axes, wherever that points: a^2 / 6 of each.
        variance = sigma_s * sigma_s
        for mode in range(1, _ACROSS.size):
            variance += modes[m, mode] * (_ACROSS[mode] ** 2 + _ALONG[mode] ** 2) / 6.0
        by[0], by[1] = 0.5 * dt[m] * dt[m], dt[m]
        for i in range(2):
            for j in range(2):
                spread[m, i, j] += variance * by[i] * by[j]
                spread[m, 2 + i, 2 + j] += variance * by[i] * by[j]
    return moved, spread


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


@kernel
def expected_states(particles: NDArray[np.float64], motion: Motion) -> NDArray[np.float64]:
    """States expected one dwell later: without noise, but in the modes of a mixture; (n, 4) -> (n, 4).

    What a particle of a turn would draw is dealt to it as well, so that equal beliefs expect the same; none brakes.
    """
    out = np.empty_like(particles)
    for i in range(particles.shape[0]):
        s, mode, w_x, w_y = particles[i], mode_of(motion, mode_quantile(i)), 0.0, 0.0
        if mode != STRAIGHT:
            w_x, w_y = turned(s[1], s[3], motion.dt, _ACROSS[mode] * (2.0 * ((i * _DEAL_SQ) % 1.0) - 1.0), 0.0)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = advance(s[0], s[1], s[2], s[3], motion.dt, w_x, w_y)
    return out
