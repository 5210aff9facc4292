"""Max-min power allocation for equal amplifiers: each transmit antenna has the same power.

Symbols as in `cogradar.shared.power.max_min`; n antennas.

    maximise over R   min_m delta_m a_m^T R a_m^*     subject to  R_ii = P / n for all i,  R >= 0

With the phase reference at the array's centre the mirror image J R^* J of a covariance is as good as R, and so is the
mean of both. In the coordinates of `real_steering_vectors` that is a real matrix X = F F^T, and antennas i and n-1-i
have the squared rows of their two coordinates in common. F has RANK columns: an optimal X has a rank r with
r (r + 1) / 2 at most the number of constraints, n / 2 + M (Pataki 1998).

The Lagrangian with multipliers mu of the tracks and d of the antennas is stationary where D F = S F,
S = sum_m mu_m delta_m b_m b_m^T. Each iteration takes one step of both, and their number is fixed:

    F <- rows of S F, scaled to the power of their antennas
    mu_m <- mu_m (e_min / e_m)^eta,  e_m = delta_m |F^T b_m|^2

The first is the ascent of a convex function and never loses; the second is multiplicative weights (Arora, Hazan and
Kale 2012). Any mu and d > 0 prove a bound on all feasible covariances (weak duality):

    value <= P lambda_max(D^-1/2 S D^-1/2) mean(d)
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import dot, multiply, product, spectral_norm
from cogradar.shared.power.max_min import Allocation, allocate, clipped, dual_bound, real_steering_vectors
from cogradar.shared.signal.waveform import antennas, beam_factor

Floats = NDArray[np.float64]

RANK = 16  # of the covariance: enough for n_tx / 2 + M = 136 constraints
PROVEN_DB = 0.5  # a result counts as optimal if no other one is proven to be able to be better by more
_ITERATIONS = 1000
_ETA, _CONSTANT = 0.3, 300.0  # first exponent of the weights, and iterations after which it has fallen to 0.7 of it
_LEAST_RATIO, _LEAST_MU, _TINY = 1e-3, 1e-30, 1e-300
_BALANCED = 200  # iterations of the powers of conventional beams


def allocate_equal(nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Allocation:
    """Power allocation of one dwell with the power P / n_tx in each antenna; arguments as for `max_min.allocate`.

    returns : Allocation, whose bound is the bound of all covariances with equal antennas; "optimal" if that is within
              PROVEN_DB of the value
    Cost O(M n_tx RANK) per iteration: 10 ms for 12 tracks and 100 antennas.
    """
    delta = clipped(delta)
    weights = delta / delta.min()
    rows = real_steering_vectors(np.asarray(nus, dtype=np.float64), n_tx)
    factor, mu, d = _ascend(rows, weights)
    scale = power * n_tx * float(delta.min())
    value = scale * float(np.min(weights * np.sum(multiply(rows, factor) ** 2, axis=1)))
    scaled = rows * np.sqrt(mu * weights)[:, np.newaxis] / np.sqrt(d)
    proven = scale * spectral_norm(scaled) ** 2 * float(d.mean())
    # Without the limits of antennas the optimum is no lower, so that its bound is one, too.
    bound = max(min(proven, allocate(nus, delta, power, n_tx).bound), value)
    return Allocation(antennas(factor * np.sqrt(power)), power * mu, value, bound, _status(value, bound))


def allocate_conventional(nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Allocation:
    """Power allocation of one dwell by a sum of conventional beams, R = sum_m p_m a_m^* a_m^T / n_tx.

    All antennas have the power P / n_tx, whatever the p_m are. The powers make the tracks' echoes equally strong, each
    with what the others' beams send to it. Arguments and result as for `max_min.allocate`.
    """
    nus, delta = np.asarray(nus, dtype=np.float64), clipped(delta)
    weights = delta / delta.min()
    rows = real_steering_vectors(nus, n_tx)
    gains = multiply(rows, np.ascontiguousarray(rows.T)) ** 2
    shares = 1.0 / weights
    best, best_shares = -1.0, shares
    for _ in range(_BALANCED):
        shares = shares / shares.sum()
        echo = weights * product(gains, shares)
        if echo.min() > best:
            best, best_shares = float(echo.min()), shares
        shares = shares * np.sqrt(np.maximum(echo.min() / echo, _LEAST_RATIO))
    value = power * n_tx * float(delta.min()) * best
    bound = max(dual_bound(best_shares, nus, delta, power, n_tx), value)
    factor = beam_factor(nus, power * best_shares, n_tx)
    return Allocation(factor, power * best_shares, value, bound, _status(value, bound))


def _status(value: float, bound: float) -> Literal["optimal", "inaccurate"]:
    return "optimal" if bound <= 10.0 ** (0.1 * PROVEN_DB) * value else "inaccurate"


@kernel
def _ascend(rows: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Factor of the best X with trace 1, (n, RANK), and multipliers of tracks (M,) and coordinates (n,)."""
    n_track, n = rows.shape
    columns = rows.T.copy()
    factor, mu = np.empty((n, RANK)), np.empty(n_track)
    for i in range(n):
        for j in range(RANK):  # anything of full rank
            factor[i, j] = np.cos((i + 1.0) * (j + 1.0) * (1.0 + np.sqrt(2.0) * (j + 1.0)))
    for m in range(n_track):
        mu[m] = 1.0 / weights[m]
    mu /= mu.sum()
    _scaled(factor)
    mean_mu, best, best_factor = np.zeros(n_track), -1.0, factor.copy()
    for iteration in range(_ITERATIONS):
        fields = multiply(rows, factor)
        echo = np.empty(n_track)
        for m in range(n_track):
            echo[m] = weights[m] * dot(fields[m], fields[m])
        least = max(echo.min(), _TINY)
        if least > best:
            best, best_factor = least, factor.copy()
        eta = _ETA / np.sqrt(1.0 + iteration / _CONSTANT)
        for m in range(n_track):
            mu[m] *= max(least / max(echo[m], _TINY), _LEAST_RATIO) ** eta
        total = mu.sum()
        for m in range(n_track):
            mu[m] = max(mu[m] / total, _LEAST_MU / weights[m])
            fields[m] *= mu[m] * weights[m]
        if 2 * iteration >= _ITERATIONS:
            mean_mu += mu
        factor = multiply(columns, fields)
        _scaled(factor)
    mean_mu /= mean_mu.sum()
    fields = multiply(rows, best_factor)
    for m in range(n_track):
        fields[m] *= mean_mu[m] * weights[m]
    return best_factor, mean_mu, _scaled(multiply(columns, fields))


@kernel
def _scaled(factor: Floats) -> Floats:
    """Give each antenna the power 1/n, in place; what the rows were multiplied by, inverted, (n,)."""
    n = factor.shape[0]
    half, d = n // 2, np.empty(n)
    for i in range(half):
        power = dot(factor[i], factor[i]) + dot(factor[half + i], factor[half + i])
        d[i] = np.sqrt(max(0.5 * n * power, _TINY))
        d[half + i] = d[i]
    if n % 2 == 1:
        d[n - 1] = np.sqrt(max(n * dot(factor[n - 1], factor[n - 1]), _TINY))
    for i in range(n):
        factor[i] /= d[i]
    return d
