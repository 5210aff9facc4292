"""A belief of three Gaussians, one for each mode of motion: of steered looks that measure direction and range.

Symbols: m_j, P_j, w_j mean, covariance and weight of mode j, s = [x, vx, y, vy, a] (`turning`); nu direction,
H its gradient, S = H P H^T + sigma_nu^2; R range.

A detection is taken in twice: its measured direction by a Kalman update linearised at m_j, its range cell as a cut of
the Gaussian along the line of sight. A target may stay in one cell for many dwells, so that the errors of a measured
range are no independent noise. Looks without a detection are weighed along the direction, where lobes are narrow, and
leave the Gaussian with the moments that are left of it. Beside all modes there is the small probability that the belief
was wrong altogether and the target, wherever it was, is where the detection is: nothing has to recover it.
"""

import math
from functools import cache, cached_property
from math import exp, pi, sqrt
from typing import NamedTuple, Self

import numpy as np

from cogradar.shared.numerics.elementwise import hypot, ndtri
from cogradar.shared.numerics.error_function import erf, erfc
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import cholesky, dot, product, solve
from cogradar.shared.scenario.limits import MIXTURE_STATES
from cogradar.shared.signal.array import at_own_end
from cogradar.shared.signal.response import FAR_KM
from cogradar.shared.tracking.belief.likelihood import Likelihood, Looks, in_lobes, likelihood_of
from cogradar.shared.tracking.belief.turning import AT_FIRST, DIM, LATERAL, N_MODE, factor, moved_modes
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import Floats

WRONG = 1e-4  # probability, in a dwell, that the belief is wrong altogether
WIDTH = 1 + DIM + DIM * DIM  # numbers of a component
_ACROSS, _REACH = 64, 4.0  # points over the direction that misses are weighed at, and how many sigmas they reach
_LEAST_R = 1e-3  # km
_TINY = 1e-300
_NEGLIGIBLE = 1e-6  # probability that a belief was wrong, below which it is left as it is
_LEAST_IN_CELL = 1e-12  # probability of a range cell below which a difference of two has lost its digits
_STEPS = np.array(
    [1.0 / math.pow(1.1673039782614187, i) for i in range(1, 5)]
)  # of an additive recurrence in four dimensions (Roberts 2018)


@cache
def normal_points(n: int) -> Floats:
    """Points (n, 4) that are spread as N(0, I), with exactly its mean and covariance."""
    points = ndtri((0.5 + np.arange(1, n + 1)[:, np.newaxis] * _STEPS) % 1.0)
    points -= points.mean(axis=0)
    lower = cholesky(product(points.T, points) / n)
    return np.ascontiguousarray(solve(lower, points.T).T)


class _Modes(NamedTuple):
    weights: Floats  # (3,) probabilities of the modes
    means: Floats  # (3, 5)
    covariances: Floats  # (3, 5, 5)


class GaussianMixture(_Modes):
    """A belief of one Gaussian per mode of motion."""

    @classmethod
    def of_rows(cls, rows: Floats) -> Self:
        """What `rows` was made of."""
        return cls(rows[:, 0].copy(), rows[:, 1 : 1 + DIM].copy(), rows[:, 1 + DIM :].reshape(-1, DIM, DIM).copy())

    @classmethod
    def of_moments(cls, mean: Floats, covariance: Floats, has_turns: bool) -> Self:
        """Of a target with this mean, (4,), and covariance, (4, 4), of whose turns nothing is known."""
        return cls(*_of_moments(mean, covariance, has_turns))

    @property
    def rows(self) -> Floats:
        """As numbers, (3, WIDTH)."""
        return np.column_stack((self.weights, self.means, self.covariances.reshape(N_MODE, -1)))

    def sample(self) -> Floats:
        """Equally probable states, the same ones for the same belief, (MIXTURE_STATES, 4); not to be changed."""
        return self._samples

    @cached_property
    def _samples(self) -> Floats:
        return _sample(self.weights, self.means, self.covariances, normal_points(MIXTURE_STATES))

    def moments(self) -> tuple[Floats, Floats]:
        """Mean, (4,), and covariance, (4, 4), of the mixture."""
        mean, covariance = _merged(self.weights, self.means, self.covariances)
        return mean[:4], covariance[:4, :4]

    def ahead(self, model: TrackerModel) -> "GaussianMixture":
        """One dwell later, before its observation."""
        motion = model.motion.dt, model.sigma_straight, model.is_mixture
        if motion not in self._ahead:  # a plan asks for it, and then the scan
            self._ahead[motion] = GaussianMixture(*moved_modes(self.weights, self.means, self.covariances, *motion))
        return self._ahead[motion]

    @cached_property
    def _ahead(self) -> dict[tuple[float, float, bool], "GaussianMixture"]:
        return {}

    def expected(self, model: TrackerModel, _modes: Floats) -> Floats:
        """States expected one dwell later, (MIXTURE_STATES, 4)."""
        return self.ahead(model).sample()


def begin_at_detection(model: TrackerModel, hit: Looks) -> GaussianMixture:
    """Belief of a target after its first detection: of its velocity nothing is known."""
    measured = np.array([*_measured(hit), hit.range_km, model.response.range_cell_km])
    return GaussianMixture(*_begun(measured, model.acquisition.v_max_km_s, model.is_mixture))


def condition(model: TrackerModel, predicted: GaussianMixture, looks: Looks) -> tuple[GaussianMixture, float]:
    """The belief that looks leave of one predicted for their dwell, and how probable these were."""
    if not looks.is_hit:
        *left, evidence = _missed(*predicted, likelihood_of(model.sensor, looks))
        return GaussianMixture(*left), evidence
    cell_km = model.response.range_cell_km
    # If the belief was wrong, the target may be anywhere in the look and its gate.
    low_km, high_km = model.acquisition.ranges_km if looks.high_km >= FAR_KM else (looks.low_km, looks.high_km)
    wrong = WRONG * cell_km / (high_km - low_km) / (2.0 * model.response.lobe)
    nu, nu_sigma = _measured(looks)
    if abs(nu) > 0.5 - model.response.lobe:
        nu = at_own_end(nu, nu_sigma, _direction(_merged(*predicted)[0])[0])
    measured = np.array([nu, nu_sigma, looks.range_km, cell_km])
    *left, evidence = _detected(*predicted, measured, wrong, model.acquisition.v_max_km_s, model.is_mixture)
    return GaussianMixture(*left), evidence


def found_as_expected(model: TrackerModel, belief: GaussianMixture, place: Floats, nu_sigma: float) -> GaussianMixture:
    """The belief a dwell later if its target was detected right where it was expected, moved to `place`, (2,) km."""
    cell_km, ahead = model.response.range_cell_km, belief.ahead(model)
    nu, range_km, _ = _direction(_merged(*ahead)[0])
    measured = np.array([nu, nu_sigma, range_km, cell_km])
    weights, means, covariances, _ = _detected(*ahead, measured, 0.0, model.acquisition.v_max_km_s, model.is_mixture)
    means[:, :4:2] += place - _merged(weights, means, covariances)[0][:4:2]
    return GaussianMixture(weights, means, covariances)


def _measured(hit: Looks) -> tuple[float, float]:
    """Direction of a detection and its standard deviation; the direction of the look if none was measured."""
    if hit.nu_sigma > 0.0:
        return hit.nu_hat, hit.nu_sigma
    return hit.hit_nu, hit.response.lobe / sqrt(12.0)


@kernel
def _begun(measured: Floats, v_max: float, has_turns: bool) -> tuple[Floats, Floats, Floats]:
    """A mixture of a target in a range cell and a direction, of whose velocity and turns nothing is known.

    measured : (4,) direction, its standard deviation, centre of the range cell, width of the cell, km
    """
    nu, nu_sigma, range_km, cell_km = measured
    # At end-fire itself no direction, measured later, would move the mean.
    nu = _in_front(min(max(nu, -0.5), 0.5), nu_sigma)
    cos, sin = sqrt(max(1.0 - 4.0 * nu * nu, 0.0)), 2.0 * nu
    # Across the line of sight: d nu = 0.5 cos(theta) d theta; next to end-fire not wider than the direction can say.
    across = 2.0 * range_km * nu_sigma / max(cos, sqrt(2.0 * nu_sigma), 1e-3)
    along = cell_km / sqrt(12.0)
    mean, covariance = np.zeros(4), np.diag(np.full(4, v_max**2 / 3.0))
    mean[0], mean[2] = range_km * cos, range_km * sin
    covariance[0, 0] = (cos * along) ** 2 + (sin * across) ** 2
    covariance[2, 2] = (sin * along) ** 2 + (cos * across) ** 2
    covariance[0, 2] = covariance[2, 0] = cos * along * (sin * along) - sin * across * (cos * across)
    return _of_moments(mean, covariance, has_turns)


@kernel
def _of_moments(mean: Floats, covariance: Floats, has_turns: bool) -> tuple[Floats, Floats, Floats]:
    """A mixture of a target with this mean, (4,), and covariance, (4, 4), of whose turns nothing is known."""
    weights, means, covariances = np.zeros(N_MODE), np.zeros((N_MODE, DIM)), np.zeros((N_MODE, DIM, DIM))
    weights[0] = 1.0
    for j in range(N_MODE):
        if has_turns:
            weights[j] = AT_FIRST[j]
        means[j, :4], covariances[j, :4, :4] = mean, covariance
        covariances[j, 4, 4] = LATERAL[j] ** 2
    return weights, means, covariances


@kernel
def _in_front(nu: float, sigma: float) -> float:
    """Mean of N(nu, sigma^2) cut to the directions that there are, -0.5 .. 0.5."""
    low, high = (-0.5 - nu) / sigma, (0.5 - nu) / sigma
    density = exp(-0.5 * low * low) - exp(-0.5 * high * high)
    inside = 0.5 * (erf(high / sqrt(2.0)) - erf(low / sqrt(2.0)))
    return nu + sigma * density / (sqrt(2.0 * pi) * inside)


@kernel
def _direction(mean: Floats) -> tuple[float, float, Floats]:
    """Direction nu of a mean, (5,), its range, and the gradient H of nu, (5,)."""
    x, y = mean[0], mean[2]
    range_km = max(hypot(x, y), _LEAST_R)
    by = np.zeros(DIM)
    by[0], by[2] = -0.5 * x * y / range_km**3, 0.5 * x * x / range_km**3
    return 0.5 * y / range_km, range_km, by


@kernel
def _times(matrix: Floats, vector: Floats) -> Floats:
    """Product of a matrix and a vector, (n, n) and (n,)."""
    found = np.empty_like(vector)
    for i in range(vector.size):
        found[i] = dot(matrix[i], vector)
    return found


@kernel
def _merged(weights: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of a mixture, (n, d), (n, d, d) -> (d,), (d, d)."""
    n, d = means.shape
    mean, covariance = np.zeros(d), np.zeros((d, d))
    for j in range(n):
        for a in range(d):
            mean[a] += weights[j] * means[j, a]
    for j in range(n):
        for a in range(d):
            for b in range(d):
                off = (means[j, a] - mean[a]) * (means[j, b] - mean[b])
                covariance[a, b] += weights[j] * (covariances[j, a, b] + off)
    return mean, covariance


@kernel
def _sample(weights: Floats, means: Floats, covariances: Floats, points: Floats) -> Floats:
    """As many states as points, (n, 4), each mode's share of them."""
    n, states, first, upto = points.shape[0], np.empty_like(points), 0, 0.0
    for j in range(weights.size):
        upto += weights[j]
        last = n if j == weights.size - 1 else min(max(round(n * upto), first), n)
        lower = factor(covariances[j, :4, :4].copy())
        for i in range(first, last):
            for a in range(4):
                state = means[j, a]
                for b in range(a + 1):
                    state += lower[a, b] * points[i, b]
                states[i, a] = state
            states[i, 0] = max(states[i, 0], 0.0)
        first = max(first, last)
    return states


@kernel
def _missed(
    weights: Floats, means: Floats, covariances: Floats, likelihood: Likelihood
) -> tuple[Floats, Floats, Floats, float]:
    """A mixture after looks without a detection, and their probability."""
    hit, gains, _box, _bin, _gains, nus, lobe, loss, low_km, high_km, nu_hat, precision = likelihood[:12]
    hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range, _foreign, _front = likelihood[12:]
    left, moved, spread = weights.copy(), means.copy(), covariances.copy()
    for j in range(weights.size):
        if weights[j] == 0.0:
            continue
        _, _, by = _direction(means[j])
        by_p = _times(spread[j], by)
        variance = dot(by, by_p)
        if variance <= 0.0:
            continue
        sigma = np.sqrt(variance)
        total, first, second, all_of_it, before = 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(_ACROSS):
            z = _REACH * (2.0 * (q + 0.5) / _ACROSS - 1.0)
            x = means[j, 0] + by_p[0] / sigma * z
            y = means[j, 2] + by_p[2] / sigma * z
            p = np.exp(-0.5 * z * z)
            all_of_it += p
            before += p * z * z
            p *= in_lobes(
                x, y, hit, gains, nus, lobe, loss, low_km, high_km, nu_hat, precision,
                hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range,
            )  # fmt: skip
            total += p
            first += p * z
            second += p * z * z
        if total <= _TINY:
            left[j] = 0.0
            continue
        first, second = first / total, second / total
        left[j] *= total / all_of_it
        # In units of sigma the Gaussian had mean 0 and, at these points, nearly variance 1.
        moved[j] += by_p / sigma * first
        change = (second - first * first - before / all_of_it) / variance
        for a in range(DIM):
            for b in range(DIM):
                spread[j, a, b] += by_p[a] * by_p[b] * change
    evidence = left.sum()
    if evidence <= _TINY:
        return weights, means, covariances, 0.0
    return left / evidence, moved, spread, evidence


@kernel
def _cut_to_cell(mean: Floats, covariance: Floats, cell: Floats) -> float:
    """Cut a Gaussian to a range cell, (2,) km, along its line of sight, in place; how much of it was there.

    Loops and no expressions of arrays, which take the compiler ten times as long.
    """
    range_km = max(hypot(mean[0], mean[2]), _LEAST_R)
    by = np.zeros(DIM)
    by[0], by[2] = mean[0] / range_km, mean[2] / range_km
    by_p = _times(covariance, by)
    sigma = sqrt(max(dot(by, by_p), 1e-12))
    low, high = (cell[0] - range_km) / sigma, (cell[1] - range_km) / sigma
    near, far = (low, high) if low + high > 0.0 else (-high, -low)  # mirrored, so that no digits are lost
    inside = 0.5 * (erfc(near / sqrt(2.0)) - erfc(far / sqrt(2.0)))
    if inside < _LEAST_IN_CELL:  # the tail: almost all that is in the cell is at its near edge (Mills' ratio)
        inside = exp(-0.5 * near * near) / (sqrt(2.0 * pi) * near)
        shift = near + 1.0 / near if low + high > 0.0 else -near - 1.0 / near
        narrower = 1.0 - 1.0 / (near * near)
    else:
        at_low, at_high = exp(-0.5 * low * low) / sqrt(2.0 * pi), exp(-0.5 * high * high) / sqrt(2.0 * pi)
        shift = (at_low - at_high) / inside
        left = 1.0 + (low * at_low - high * at_high) / inside - shift * shift
        narrower = 1.0 - min(max(left, 1e-6), 1.0)
    for a in range(DIM):
        mean[a] += by_p[a] / sigma * shift
        for b in range(DIM):
            covariance[a, b] -= by_p[a] * by_p[b] / (sigma * sigma) * narrower
    return inside


@kernel
def _detected(
    weights: Floats, means: Floats, covariances: Floats, measured: Floats, wrong: float, v_max: float, has_turns: bool
) -> tuple[Floats, Floats, Floats, float]:
    """A mixture after a detection, and its density in nu times the probability of its range cell.

    measured : as for `_begun`
    wrong    : the same of a target about which the belief was wrong, times the probability that it was
    """
    joint, moved, spread = _found(weights, means, covariances, measured)
    evidence = joint.sum()
    share = wrong / (evidence + wrong)
    if share <= _NEGLIGIBLE:
        return joint / evidence, moved, spread, evidence
    own, begun = joint / (evidence + wrong), _begun(measured, v_max, has_turns)
    for j in range(own.size):
        anew = share * begun[0][j]
        joint[j] = own[j] + anew
        if joint[j] > 0.0:
            shares = np.array([own[j], anew]) / joint[j]
            both = np.stack((moved[j], begun[1][j])), np.stack((spread[j], begun[2][j]))
            moved[j], spread[j] = _merged(shares, both[0], both[1])
    return joint / joint.sum(), moved, spread, evidence


@kernel
def _found(weights: Floats, means: Floats, covariances: Floats, measured: Floats) -> tuple[Floats, Floats, Floats]:
    """A mixture after a detection; its weights, (3,), times the density in nu and the probability of the range cell.

    measured : as for `_begun`
    """
    joint, moved, spread = weights.copy(), means.copy(), covariances.copy()
    nu_hat, nu_sigma, range_km, cell_km = measured
    cell = np.array([range_km - 0.5 * cell_km, range_km + 0.5 * cell_km])
    for j in range(weights.size):
        if weights[j] == 0.0:
            continue
        nu, _, by = _direction(means[j])
        by_p = _times(covariances[j], by)
        variance = dot(by, by_p) + nu_sigma * nu_sigma
        off = nu_hat - nu
        off -= round(off)  # -0.5 and 0.5 are one direction
        density = exp(-0.5 * off * off / variance) / sqrt(2.0 * pi * variance)
        for a in range(DIM):
            moved[j, a] += by_p[a] / variance * off
            for b in range(DIM):
                spread[j, a, b] -= by_p[a] * by_p[b] / variance
        joint[j] *= density * _cut_to_cell(moved[j], spread[j], cell)
    return joint, moved, spread
