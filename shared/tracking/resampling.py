"""Resampling of weighted particles, and its regularisation against impoverishment.

Symbols: s state [x, vx, y, vy], d = 4; w weights; m, C weighted mean and covariance; h bandwidth of the Gaussian
kernel in units of the belief's own standard deviation; n_eff = (sum w)^2 / sum w^2 effective sample size.
"""

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.signal.angle import bin_of

DIM = 4  # of a state
_JITTERS = 4  # tries to stay in the bin of a detection
_NULL_PIVOT = 1e-12  # relative to the variance


def optimal_bandwidth(n_eff: float) -> float:
    """Best h for a Gaussian density, (4/(d + 2))^(1/(d + 4)) n_eff^(-1/(d + 4)) (Silverman 1986, ch. 4)."""
    return float((4.0 / ((DIM + 2.0) * n_eff)) ** (1.0 / (DIM + 4.0)))


@kernel
def systematic_resample(
    weights: NDArray[np.float64], total: float, offset: float, ancestors: NDArray[np.int64]
) -> None:
    """Ancestors, ascending, with E[copies of i] = n w_i / sum w and never more than one off it; offset in [0, 1)."""
    n, last = ancestors.size, weights.size - 1
    while weights[last] == 0.0 and last > 0:  # rounding at the upper end must not choose an impossible particle
        last -= 1
    j, cumulative = 0, weights[0]
    for i in range(n):
        point = (i + offset) * total / n
        while cumulative <= point and j < last:
            j += 1
            cumulative += weights[j]
        ancestors[i] = j


@kernel
def moments(
    states: NDArray[np.float64], weights: NDArray[np.float64], total: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (4,) and the lower triangular factor L of the covariance, L L^T = C (4, 4).

    Cholesky's algorithm; a pivot that is null but for rounding gives a null column, so that a covariance of any rank
    has a factor (a belief clipped at x = 0, or copies of one particle).
    """
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
    states: NDArray[np.float64],
    weights: NDArray[np.float64],
    total: float,
    ancestors: NDArray[np.int64],
    h: float,
    hit_bin: int,
    looked: NDArray[np.bool_],
    rng: np.random.Generator,
    out: NDArray[np.float64],
) -> None:
    """Resampled particles, each moved by a Gaussian kernel that leaves the belief's mean and covariance as they are.

        s' = m + sqrt(1 - h^2) (s - m) + h L z,  z ~ N(0, I_4)        (Liu & West 2001)

    states, weights : (n, 4), (n,) before resampling, with mean m and covariance L L^T
    ancestors       : (n,) rows of `states`
    hit_bin         : bin of a detection, or -1
    looked          : (n_bin,) cells that were looked at

    Two departures at the edges of the support. A particle must not be moved to where the observation denies it: out
    of the bin of a detection, or from an unseen cell into one that was looked at in vain. (A belief split by a miss
    has a covariance that spans the gap; its kernel would fill it again, dwell after dwell.) Such a particle draws
    again, and stays where its ancestor is after a few failures. x is clipped at 0 and not reflected: the motion
    model clips too, so that the true posterior has an atom at x = 0, and reflection would empty it and push the mean
    outwards twice as far.
    """
    mean, factor = moments(states, weights, total)
    keep, jitter = np.sqrt(1.0 - h * h), h * factor
    z = np.empty(DIM)
    n_bin = looked.size
    for i in range(ancestors.size):
        s = ancestors[i]
        unseen = not looked[bin_of(states[s, 0], states[s, 2], n_bin)]
        for _ in range(_JITTERS):
            for a in range(DIM):
                z[a] = rng.standard_normal()
            for a in range(DIM):
                out[i, a] = mean[a] + keep * (states[s, a] - mean[a])
                for b in range(DIM):
                    out[i, a] += jitter[a, b] * z[b]
            out[i, 0] = max(out[i, 0], 0.0)
            moved_to = bin_of(out[i, 0], out[i, 2], n_bin)
            if moved_to == hit_bin or (hit_bin < 0 and not (unseen and looked[moved_to])):
                break
        else:
            for a in range(DIM):
                out[i, a] = states[s, a]
