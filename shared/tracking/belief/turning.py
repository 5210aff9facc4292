"""Motion of a Gaussian mixture's components: straight flight, coordinated turns, hard turns; they last.

Symbols: s = [x, vx, y, vy, a], km and km/s, and a the acceleration across the velocity, to its left, in km/s^2;
omega = a / |v| turn rate; rho = exp(-dt / tau) what is left of an acceleration after a dwell.

A component is one mode of an interacting multiple model (Blom and Bar-Shalom 1988). Flying straight, a = 0. In a turn
the velocity is rotated with the turn rate, and a is a first-order Markov process (Singer 1970), so that a turn that
lasts is followed by its rate. Each mode is predicted by an unscented transform; before, the modes are mixed by how
probable it is that the target came from each.
"""

import numpy as np

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.tracking.motion import MODES, STRAIGHT, TURN
from cogradar.shared.tracking.sensor import Floats

DIM, N_MODE = 5, len(MODES)
_G = 9.80665e-3  # standard gravity, km/s^2
LATERAL = np.array([0.0, 3.0, 8.0]) * _G  # standard deviation of a, by mode
_LASTS_S = np.array([1.0, 12.0, 6.0])  # tau of a, by mode
# Accelerations beside it, km/s^2 over one second, by mode: in any direction, and along the velocity. The noise of
# straight flight is `TrackerModel.sigma_straight`.
_ANY, _ALONG = np.array([0.0, 0.003, 0.01]), np.array([0.0, 0.005, 0.02])
_STAYS_S = np.array([15.0, 7.0, 5.0])  # mean time in a mode
_NEXT = np.array([[0.0, 0.6, 0.4], [0.85, 0.0, 0.15], [0.8, 0.2, 0.0]])  # mode after it, one row each
AT_FIRST = np.array([0.9, 0.07, 0.03])  # prior of the modes
_SLOWEST = 0.03  # km/s: keeps a turn rate finite
_NULL_PIVOT = 1e-18


@kernel
def factor(covariance: Floats) -> Floats:
    """Lower Cholesky factor, (n, n) -> (n, n), of a covariance that may be singular."""
    n = covariance.shape[0]
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = np.sqrt(rest) if rest > _NULL_PIVOT else 0.0
            elif lower[j, j] > 0.0:
                lower[i, j] = rest / lower[j, j]
    return lower


@kernel
def turned_state(state: Floats, dt: float) -> Floats:
    """State dt seconds later in a coordinated turn at its acceleration a, (5,) -> (5,)."""
    x, vx, y, vy, across = state
    angle = across / max(hypot(vx, vy), _SLOWEST) * dt
    if abs(angle) < 1e-4:
        ahead, aside = 1.0 - angle * angle / 6.0, 0.5 * angle
    else:
        ahead, aside = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle
    c, s = np.cos(angle), np.sin(angle)
    moved_x, moved_y = x + dt * (ahead * vx - aside * vy), y + dt * (aside * vx + ahead * vy)
    return np.array([moved_x, c * vx - s * vy, moved_y, s * vx + c * vy, across])


@kernel
def _moved(mean: Floats, covariance: Floats, dt: float, mode: int, sigma_s: float) -> tuple[Floats, Floats]:
    """A component one dwell later, by an unscented transform of third order; (5,), (5, 5)."""
    lower, scale = factor(covariance), np.sqrt(3.0)
    points = np.empty((2 * DIM + 1, DIM))
    points[0] = turned_state(mean, dt)
    for i in range(DIM):
        points[1 + i] = turned_state(mean + scale * lower[:, i], dt)
        points[1 + DIM + i] = turned_state(mean - scale * lower[:, i], dt)
    # The weight of the middle, (3 - n) / 3, is negative: it counts for the mean, and is left out of the covariance.
    moved = (3.0 - DIM) / 3.0 * points[0]
    for i in range(1, 2 * DIM + 1):
        moved += points[i] / 6.0
    spread = np.zeros((DIM, DIM))
    for i in range(1, 2 * DIM + 1):
        off = points[i] - moved
        for a in range(DIM):
            for b in range(DIM):
                spread[a, b] += off[a] * off[b] / 6.0
    speed = max(hypot(moved[1], moved[3]), 1e-3)
    along = np.array([moved[1], moved[3]]) / speed
    # Over a dwell, the effect on the velocity of what is independent from second to second grows with sqrt(dt).
    any_sq = sigma_s * sigma_s if mode == STRAIGHT else _ANY[mode] ** 2 / dt
    along_sq = _ALONG[mode] ** 2 / dt
    by = np.array([0.5 * dt * dt, dt])
    for a in range(2):
        for b in range(2):
            for p in range(2):
                for q in range(2):
                    noise = along_sq * (along[p] * along[q]) + (any_sq if p == q else 0.0)
                    spread[2 * p + a, 2 * q + b] += by[a] * by[b] * noise
    rho = np.exp(-dt / _LASTS_S[mode]) if mode != STRAIGHT else 0.0
    moved[4] *= rho
    spread[4, :] *= rho
    spread[:, 4] *= rho
    spread[4, 4] += LATERAL[mode] ** 2 * (1.0 - rho * rho)
    return moved, spread


@kernel
def _mixed(shares: Floats, means: Floats, covariances: Floats, mode: int) -> tuple[Floats, Floats]:
    """What comes into a mode from each, with these shares, (3,): mean, (5,), and covariance, (5, 5).

    A target that begins to turn draws an acceleration anew; one that flies straight has none.
    """
    mixed, around = np.zeros(DIM), np.zeros((DIM, DIM))
    for i in range(N_MODE):
        n = DIM if i == mode and mode >= TURN else DIM - 1
        for a in range(n):
            mixed[a] += shares[i] * means[i, a]
    for i in range(N_MODE):
        off, is_same = means[i] - mixed, i == mode and mode >= TURN
        if not is_same:
            off[4] = -mixed[4]
            around[4, 4] += shares[i] * LATERAL[mode] ** 2
        n = DIM if is_same else DIM - 1
        for a in range(DIM):
            for b in range(DIM):
                own = covariances[i, a, b] if a < n and b < n else 0.0
                around[a, b] += shares[i] * (own + off[a] * off[b])
    return mixed, around


@kernel
def moved_modes(
    weights: Floats, means: Floats, covariances: Floats, dt: float, sigma_s: float, has_turns: bool
) -> tuple[Floats, Floats, Floats]:
    """The modes of a target one dwell later, mixed and predicted; (3,), (3, 5), (3, 5, 5).

    has_turns : else the target flies straight whatever it did before
    """
    n = N_MODE
    chances = np.zeros((n, n))
    for i in range(n):
        stays = np.exp(-dt / _STAYS_S[i]) if has_turns else 1.0
        for j in range(n):
            chances[i, j] = weights[i] * (stays if i == j else (1.0 - stays) * _NEXT[i, j])
    after, moved, spread = np.zeros(n), means.copy(), covariances.copy()
    for j in range(n):
        after[j] = chances[:, j].sum()
        if after[j] == 0.0:
            continue
        mixed, around = _mixed(chances[:, j] / after[j], means, covariances, j)
        moved[j], spread[j] = _moved(mixed, around, dt, j, sigma_s)
    return after, moved, spread
