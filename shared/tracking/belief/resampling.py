"""Weights of particles, their resampling, and its regularisation against impoverishment.

Symbols: s state [x, vx, y, vy], d = 4; w weights; m, C weighted mean and covariance; h bandwidth of the Gaussian
kernel in units of the belief's own standard deviation; n_eff = (sum w)^2 / sum w^2 effective sample size.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import power
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import inner
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.radar_equation import strength
from cogradar.shared.tracking.belief.likelihood import Likelihood, in_lobes
from cogradar.shared.tracking.motion import weighted_squares, weighted_sum
from cogradar.shared.tracking.sensor import interpolate

DIM = 4  # of a state
JITTERS = 4  # tries to stay where the observation allows a particle to be
_NULL_PIVOT = 1e-12  # relative to the variance
_LEAST = 0.5  # of its ancestor's probability: what a particle must keep after a miss of steered looks


class Weighted(NamedTuple):
    """Particles with their likelihoods."""

    states: NDArray[np.float64]  # (n, 4)
    weights: NDArray[np.float64]  # (n,) >= 0
    total: float
    total_sq: float  # sum of the squares
    is_uniform: bool  # all weights are the same: the observation says nothing


def tempered(weighted: Weighted, exponent: float) -> Weighted:
    """The same states with weights to this power in 0 .. 1; what is impossible stays so."""
    weights = np.where(weighted.weights > 0.0, power(weighted.weights, exponent), 0.0)
    total, total_sq = float(weights.sum()), inner(weights, weights)
    return Weighted(weighted.states, weights, total, total_sq, weighted.is_uniform)


@kernel
def weigh(states: NDArray[np.float64], likelihood: Likelihood) -> Weighted:
    """Weight of each state, (n, 4): the likelihood of the looks.

    At x = 0 are those particles that the motion model holds at the edge of the field of view. They explain a detection
    only if they do so better than all others together, else their weight is 0. A bin at end-fire is kilometres wide.
    Without this, every particle that flies outwards ends at the edge and explains all detections in that bin for good.
    Of the particles that fly inwards only the slow ones stay, and the belief's mean goes to the edge whatever the
    target does. A belief that has gone there as a whole knew where its target flies, and targets are held at the edge
    as well.
    """
    hit, gains, is_box, hit_bin, bin_gains, nus, lobe, loss, low_km, high_km, nu_hat, nu_precision = likelihood[:12]
    hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range, foreign, is_in_front = likelihood[12:]
    start, log_p = (hit_start, hit_log_p) if hit >= 0 else (miss_start, miss_log_p)
    weights = np.empty(states.shape[0])
    if is_box:  # two loops: a branch in one of them costs as much as all the rest
        for i in range(states.shape[0]):
            x, y = states[i, 0], states[i, 2]
            b = bin_of(x, y, bin_gains.size)
            if hit >= 0 and b != hit_bin:
                weight = 0.0
            elif bin_gains[b] > 0.0 and log_p.size > 0:
                u = strength(bin_gains[b], x * x + y * y, by_range)
                weight = interpolate(u, start, log_p, is_log)
            else:
                weight = 1.0
            weights[i] = weight + foreign
    else:
        for i in range(states.shape[0]):
            x, y = states[i, 0], states[i, 2]
            weights[i] = in_lobes(
                x, y, hit, gains, nus, lobe, loss, low_km, high_km, nu_hat, nu_precision,
                hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range,
            )  # fmt: skip
    weighted = _weighted(states, weights)
    return _without_edge(weighted) if hit >= 0 and is_in_front else weighted


@kernel
def _weighted(states: NDArray[np.float64], weights: NDArray[np.float64]) -> Weighted:
    """States with these weights, (n,)."""
    total, total_sq, uniform = 0.0, 0.0, True
    for weight in weights:
        total += weight
        total_sq += weight * weight
        uniform = uniform and weight == weights[0]
    return Weighted(states, weights, total, total_sq, uniform)


@kernel
def _without_edge(weighted: Weighted) -> Weighted:
    """Without the particles at x = 0, unless these have more weight than all others together."""
    states, weights = weighted.states, weighted.weights
    at_edge = 0.0
    for i in range(weights.size):
        if states[i, 0] <= 0.0:
            at_edge += weights[i]
    if at_edge == 0.0 or at_edge > weighted.total - at_edge:
        return weighted
    for i in range(weights.size):
        if states[i, 0] <= 0.0:
            weights[i] = 0.0
    return _weighted(states, weights)


def optimal_bandwidth(n_eff: float) -> float:
    """Best h for a Gaussian density, (4/(d + 2))^(1/(d + 4)) n_eff^(-1/(d + 4)) (Silverman 1986, ch. 4)."""
    return float((4.0 / ((DIM + 2.0) * n_eff)) ** (1.0 / (DIM + 4.0)))


@kernel
def resample(weighted: Weighted, offset: float) -> NDArray[np.int64]:
    """Ancestors of as many particles, ascending; systematic resampling, offset in [0, 1). (n,)

    E[copies of i] = n w_i / sum w, and never more than one off it.
    """
    weights, total = weighted.weights, weighted.total
    n, last = weights.size, weights.size - 1
    while weights[last] == 0.0 and last > 0:  # rounding at the upper end must not choose an impossible particle
        last -= 1
    # No branch on weights in the loop: it would be mispredicted for every second particle.
    passed, cumulative = np.zeros(n + 1, dtype=np.int64), 0.0  # particles whose last copy is just before each place
    for j in range(last):
        cumulative += weights[j]
        passed[min(int(np.ceil(cumulative * n / total - offset)), n)] += 1
    return np.cumsum(passed[:n])


@kernel
def moments(weighted: Weighted) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (4,) and the lower triangular factor L of the covariance, L L^T = C (4, 4).

    Cholesky's algorithm. A pivot that is null but for rounding gives a null column, so that a covariance of any rank
    has a factor (a belief clipped at x = 0, or copies of one particle).
    """
    states, weights, total = weighted.states, weighted.weights, weighted.total
    mean = weighted_sum(states, weights) / total
    cov = weighted_squares(states, weights, mean) / total
    factor = np.zeros((DIM, DIM))
    for a in range(DIM):
        pivot = cov[a, a] - np.sum(factor[a, :a] ** 2)
        if pivot > _NULL_PIVOT * cov[a, a]:
            factor[a, a] = np.sqrt(pivot)
            for b in range(a + 1, DIM):
                factor[b, a] = (cov[b, a] - np.sum(factor[b, :a] * factor[a, :a])) / factor[a, a]
    return mean, factor


@kernel
def regularise(
    weighted: Weighted, ancestors: NDArray[np.int64], h: float, likelihood: Likelihood, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Resampled particles, each moved by a Gaussian kernel that leaves the belief's mean and covariance as they are.

        s' = m + sqrt(1 - h^2) (s - m) + h L z,  z ~ N(0, I_4)        (Liu & West 2001)

    weighted   : (n, 4) states before resampling, with mean m and covariance L L^T
    ancestors  : (n,) rows of `weighted.states`
    likelihood : of the looks that they were weighted with
    returns    : (n, 4)

    Two departures at the edges of the support. A particle must not be moved to where the looks deny it. After a
    detection that is out of its bin or range cell, or to the edge of the field of view. After a miss it is from an
    unseen bin into one that was looked at in vain; in steered looks, which have no border, to where the miss is much
    less probable. Such a particle draws again, and stays where its ancestor is after a few failures. (A belief split by
    a miss has a covariance that spans the gap; its kernel would fill it again, dwell after dwell.) After a miss x is
    clipped at 0 and not reflected. The motion model clips too, so that the posterior has an atom at x = 0, and
    reflection would empty it and push the mean outwards twice as far.
    """
    mean, factor = moments(weighted)
    keep, jitter = np.sqrt(1.0 - h * h), h * factor
    states, weights = weighted.states, weighted.weights
    hit, gains, is_box, hit_bin, bin_gains, nus, lobe, loss, low_km, high_km, nu_hat, nu_precision = likelihood[:12]
    hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range = likelihood[12:18]
    is_hit, n_bin = hit >= 0, bin_gains.size
    out, z = np.empty((ancestors.size, DIM)), np.empty(DIM)
    for i in range(ancestors.size):
        s = ancestors[i]
        was_at = bin_of(states[s, 0], states[s, 2], n_bin) if is_box else 0
        for _ in range(JITTERS):
            for a in range(DIM):
                z[a] = rng.standard_normal()
            for a in range(DIM):
                moved = mean[a] + keep * (states[s, a] - mean[a])
                for b in range(a + 1):
                    moved += jitter[a, b] * z[b]
                out[i, a] = moved
            out[i, 0] = max(out[i, 0], 0.0)
            x, y = out[i, 0], out[i, 2]
            if is_box:
                moved_to = bin_of(x, y, n_bin)
                # Outside of its bin are the particles that the detection is not of.
                stays = (moved_to == hit_bin) == (was_at == hit_bin)
                is_allowed = stays if is_hit else bin_gains[was_at] > 0.0 or bin_gains[moved_to] == 0.0
            elif is_hit:
                is_allowed = low_km <= np.sqrt(x * x + y * y) < high_km
            else:
                p = in_lobes(
                    x, y, hit, gains, nus, lobe, loss, low_km, high_km, nu_hat, nu_precision,
                    hit_start, hit_log_p, miss_start, miss_log_p, is_log, by_range,
                )  # fmt: skip
                is_allowed = p >= _LEAST * weights[s]
            if is_allowed and (not is_hit or x > 0.0 or states[s, 0] <= 0.0):
                break
        else:
            for a in range(DIM):
                out[i, a] = states[s, a]
    return out
