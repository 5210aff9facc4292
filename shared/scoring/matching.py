"""Which track is of which target: an assignment with a gate, made once per run.

States are [x, vx, y, vy] in km and km/s, along the last axis.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import hypot, log
from cogradar.shared.signal.array import spatial_frequency

NU_SIGMA = 0.003  # bearing error of a track at the start, in spatial frequency: uniform over a bin of width 1/99
FAR_KM = 1e9  # beyond it all ranges are one
GATE_BINS = (
    1.5  # a new track is in its target's bin, or has just left it; one that is further off in angle is a stranger
)
LOG_RANGE_SIGMA = 1.0  # its range error, in ln(R): about as of the uniform prior over 5 .. 200 km


def associate(estimates: ArrayLike, truths: ArrayLike, n_bin: int) -> NDArray[np.int64]:
    """Which target each track is, at most one to one, at the start of a run; -1 for a false track, which is none's.

        maximise the number of pairs with |nu_i - nu_j| <= GATE_BINS / (n_bin - 1), then
        minimise over them the sum of (nu_i - nu_j)^2 / NU_SIGMA^2 + (ln R_i - ln R_j)^2 / LOG_RANGE_SIGMA^2

    estimates, truths : (M, 4), (N, 4)
    n_bin             : number of angle bins, whose centres are 1 / (n_bin - 1) apart
    returns           : (M,) index of the truth of each track
    Not by position, neither cost nor gate: a new track knows its bin for sure but hardly its range. An error in
    range can move it further than the targets are apart. The squares make it the most likely assignment under Gaussian
    errors; range decides only between targets of about one bin. Bins 0 and n_bin - 1 are different cells here, hence no
    wrapping of nu. Any finite states will do, also one at the array itself, where a target may fly.
    """
    from scipy.optimize import linear_sum_assignment

    estimates, truths = (np.clip(np.asarray(s, dtype=np.float64), -FAR_KM, FAR_KM) for s in (estimates, truths))
    nu = np.subtract.outer(spatial_frequency(estimates), spatial_frequency(truths))
    log_range = np.subtract.outer(_log_range(estimates), _log_range(truths)) / LOG_RANGE_SIGMA
    is_near = np.abs(nu) <= GATE_BINS / (n_bin - 1)
    cost = (nu / NU_SIGMA) ** 2 + log_range**2
    stranger = 1.0 + cost[is_near].sum()  # dearer than any set of near pairs
    tracks, found = linear_sum_assignment(np.where(is_near, cost, stranger))
    truth_of_track = np.full(len(estimates), -1, dtype=np.int64)
    truth_of_track[tracks] = np.where(is_near[tracks, found], found, -1)
    return truth_of_track


def _log_range(states: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(log(np.maximum(hypot(states[..., 0], states[..., 2]), 1e-6)))
