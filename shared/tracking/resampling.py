"""Weights of particles, their resampling, and its regularisation against impoverishment.

Symbols: s state [x, vx, y, vy], d = 4; w weights; m, C weighted mean and covariance; h bandwidth of the Gaussian
kernel in units of the belief's own standard deviation; n_eff = (sum w)^2 / sum w^2 effective sample size.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import inlined, kernel
from shared.signal.angle import bin_of
from shared.signal.radar_equation import amplitude
from shared.tracking.sensor import Likelihood, interpolate

DIM = 4  # of a state
JITTERS = 4  # tries to stay where the observation allows a particle to be
_NULL_PIVOT = 1e-12  # relative to the variance


class Weighted(NamedTuple):
    """Particles with their likelihoods."""

    states: NDArray[np.float64]  # (n, 4)
    weights: NDArray[np.float64]  # (n,) >= 0
    total: float
    total_sq: float  # sum of the squares
    is_uniform: bool  # all weights are the same: the observation says nothing


@inlined
def weighted_states(states: NDArray[np.float64], weights: NDArray[np.float64], denied: bool) -> Weighted:
    """States, (n, 4), with these weights, (n,), and their sums; `denied`: those at x = 0 get none."""
    total, total_sq, uniform = 0.0, 0.0, True
    for i in range(states.shape[0]):
        if denied and states[i, 0] <= 0.0:
            weights[i] = 0.0
        weight = weights[i]
        total += weight
        total_sq += weight * weight
        uniform = uniform and weight == weights[0]
    return Weighted(states, weights, total, total_sq, uniform)


def tempered(weighted: Weighted, exponent: float) -> Weighted:
    """The same states with weights to this power in 0 .. 1; what is impossible stays so."""
    weights = np.where(weighted.weights > 0.0, weighted.weights**exponent, 0.0)
    total, total_sq = float(weights.sum()), float(weights @ weights)
    return Weighted(weighted.states, weights, total, total_sq, weighted.is_uniform)


@kernel
def weigh(states: NDArray[np.float64], likelihood: Likelihood) -> Weighted:
    """Weight of each state, (n, 4): the likelihood of the observation.

    hit:  1{bin(s) = hit_bin} P(r | u);  miss: 1 - P_D(u) in a cell looked at, 1 elsewhere

    At x = 0 are those particles that the motion model holds at the edge of the field of view. They explain a detection
    only if they do so better than all others together, else their weight is 0. A bin at end-fire is kilometres wide:
    without this, every particle that flies outwards ends at the edge and explains all detections in that bin for good,
    while of those that fly inwards only the slow ones stay, and the belief's mean goes to the edge whatever the target
    does. A belief that has gone there as a whole knew where its target flies, and targets are held at the edge as well.
    """
    weights = np.empty(states.shape[0])
    hit_bin, gain, start, log_p, is_log, by_range, foreign = likelihood
    told = foreign if hit_bin >= 0 else 0.0
    at_edge, in_front = 0.0, 0.0
    for i in range(states.shape[0]):
        x, y = states[i, 0], states[i, 2]
        b = bin_of(x, y, gain.size)
        if hit_bin >= 0 and b != hit_bin:
            weight = 0.0
        elif gain[b] > 0.0:
            u = amplitude(gain[b], x * x + y * y) if by_range else gain[b]
            weight = interpolate(u, start, log_p, is_log)
        else:
            weight = 1.0
        weight += told
        weights[i] = weight
        if x <= 0.0:
            at_edge += weight
        else:
            in_front += weight
    return weighted_states(states, weights, hit_bin >= 0 and at_edge <= in_front)


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
    ancestors = np.empty(n, dtype=np.int64)
    while weights[last] == 0.0 and last > 0:  # rounding at the upper end must not choose an impossible particle
        last -= 1
    j, cumulative = 0, weights[0]
    for i in range(n):
        point = (i + offset) * total / n
        while cumulative <= point and j < last:
            j += 1
            cumulative += weights[j]
        ancestors[i] = j
    return ancestors


@kernel
def moments(weighted: Weighted) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (4,) and the lower triangular factor L of the covariance, L L^T = C (4, 4).

    Cholesky's algorithm; a pivot that is null but for rounding gives a null column, so that a covariance of any rank
    has a factor (a belief clipped at x = 0, or copies of one particle).
    """
    states, weights, total = weighted.states, weighted.weights, weighted.total
    mean, cov = np.zeros(DIM), np.zeros((DIM, DIM))
    for i in range(states.shape[0]):
        for a in range(DIM):
            mean[a] += weights[i] * states[i, a]
    mean /= total
    for i in range(states.shape[0]):
        for a in range(DIM):
            for b in range(a + 1):
                cov[a, b] += weights[i] * (states[i, a] - mean[a]) * (states[i, b] - mean[b])
    cov /= total
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
    likelihood : of the observation that they were weighted with
    returns    : (n, 4)

    Two departures at the edges of the support. A particle must not be moved to where the observation denies it: out of
    the bin of a detection or to the edge of the field of view, or from an unseen cell into one that was looked at in
    vain. (A belief split by a miss has a covariance that spans the gap; its kernel would fill it again, dwell after
    dwell.) Such a particle draws again, and stays where its ancestor is after a few failures. After a miss x is clipped
    at 0 and not reflected: the motion model clips too, so that the posterior has an atom at x = 0, and reflection would
    empty it and push the mean outwards twice as far.
    """
    mean, factor = moments(weighted)
    keep, jitter = np.sqrt(1.0 - h * h), h * factor
    states, hit_bin, looked = weighted.states, likelihood.hit_bin, likelihood.gain > 0.0
    out, z, n_bin = np.empty((ancestors.size, DIM)), np.empty(DIM), looked.size
    for i in range(ancestors.size):
        s = ancestors[i]
        was_at = bin_of(states[s, 0], states[s, 2], n_bin)
        unseen = not looked[was_at]
        for _ in range(JITTERS):
            for a in range(DIM):
                z[a] = rng.standard_normal()
            for a in range(DIM):
                out[i, a] = mean[a] + keep * (states[s, a] - mean[a])
                for b in range(DIM):
                    out[i, a] += jitter[a, b] * z[b]
            out[i, 0] = max(out[i, 0], 0.0)
            moved_to, inside = bin_of(out[i, 0], out[i, 2], n_bin), out[i, 0] > 0.0 or states[s, 0] <= 0.0
            stays = (moved_to == hit_bin) == (was_at == hit_bin)  # outside are those of whom a detection is not
            if (hit_bin >= 0 and stays and inside) or (hit_bin < 0 and not (unseen and looked[moved_to])):
                break
        else:
            for a in range(DIM):
                out[i, a] = states[s, a]
    return out
