"""Weights of particles after steered looks, and the kernel after their resampling: as with bins, without borders."""

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.tracking.resampling import DIM, JITTERS, Weighted, moments, weighted_states
from shared.tracking.steered.looks import SteeredLikelihood, probability

_LEAST = 0.5  # of its ancestor's probability: what a particle must keep after a miss


@kernel
def weigh_looks(states: NDArray[np.float64], likelihood: SteeredLikelihood) -> Weighted:
    """Weight of each state, (n, 4): the likelihood of the looks; those at x = 0 as in `resampling.weigh`."""
    weights = np.empty(states.shape[0])
    at_edge, in_front = 0.0, 0.0
    for i in range(states.shape[0]):
        weights[i] = probability(states[i, 0], states[i, 2], likelihood)
        if states[i, 0] <= 0.0:
            at_edge += weights[i]
        else:
            in_front += weights[i]
    return weighted_states(states, weights, likelihood.hit >= 0 and at_edge <= in_front)


@kernel
def regularise_looks(
    weighted: Weighted, ancestors: NDArray[np.int64], h: float, likelihood: SteeredLikelihood, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Resampled particles, each moved by a Gaussian kernel that leaves the belief's mean and covariance as they are.

        s' = m + sqrt(1 - h^2) (s - m) + h L z,  z ~ N(0, I_4)        (Liu & West 2001)

    The arguments are those of `shared.tracking.resampling.regularise`. After a detection a particle must not be moved
    out of its range cell, nor over the edge of the field of view; it has no other borders. After a miss it must not be
    moved to where that is much less probable: a belief split by it would fill the gap again. x is clipped at 0.
    """
    mean, factor = moments(weighted)
    keep, jitter = np.sqrt(1.0 - h * h), h * factor
    states, is_hit, low_km, high_km = weighted.states, likelihood.hit >= 0, likelihood.low_km, likelihood.high_km
    out, z = np.empty((ancestors.size, DIM)), np.empty(DIM)
    for i in range(ancestors.size):
        s = ancestors[i]
        for _ in range(JITTERS):
            for a in range(DIM):
                z[a] = rng.standard_normal()
            for a in range(DIM):
                out[i, a] = mean[a] + keep * (states[s, a] - mean[a])
                for b in range(DIM):
                    out[i, a] += jitter[a, b] * z[b]
            out[i, 0] = max(out[i, 0], 0.0)
            range_km = np.sqrt(out[i, 0] * out[i, 0] + out[i, 2] * out[i, 2])
            is_in_cell = low_km <= range_km < high_km
            if is_hit and is_in_cell and (out[i, 0] > 0.0 or states[s, 0] <= 0.0):
                break
            if not is_hit and probability(out[i, 0], out[i, 2], likelihood) >= _LEAST * weighted.weights[s]:
                break
        else:
            for a in range(DIM):
                out[i, a] = states[s, a]
    return out
