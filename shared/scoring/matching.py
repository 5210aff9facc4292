"""Which track is of which target: an assignment, made once per run.

States are [x, vx, y, vy] in km and km/s, along the last axis.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from shared.signal.array import spatial_frequency

NU_SIGMA = 0.003  # bearing error of a track at the start, in spatial frequency: uniform over a bin of width 1/99
FAR_KM = 1e9  # beyond it all ranges are one
LOG_RANGE_SIGMA = 1.0  # its range error, in ln(R): about that of the uniform prior over 5 .. 200 km


def associate(estimates: ArrayLike, truths: ArrayLike) -> NDArray[np.int64]:
    """Which target each track is, one to one, at the start of a run.

        minimise over permutations the sum of (nu_i - nu_j)^2 / NU_SIGMA^2 + (ln R_i - ln R_j)^2 / LOG_RANGE_SIGMA^2

    estimates, truths : (M, 4)
    returns           : (M,) index of the truth of each track
    Not by position: a new track knows its bin for sure but hardly its range, and an error in range can move it further
    than the targets are apart. The squares make it the most likely assignment under Gaussian errors; range decides only
    between targets of about one bin. Bins 0 and n_bin - 1 are different cells here, hence no wrapping of nu. Any finite
    states will do, also one at the array itself, where a target may fly.
    """
    estimates, truths = (np.clip(np.asarray(s, dtype=np.float64), -FAR_KM, FAR_KM) for s in (estimates, truths))
    nu = np.subtract.outer(spatial_frequency(estimates), spatial_frequency(truths)) / NU_SIGMA
    log_range = np.subtract.outer(_log_range(estimates), _log_range(truths)) / LOG_RANGE_SIGMA
    _, truth_of_track = linear_sum_assignment(nu**2 + log_range**2)
    return np.asarray(truth_of_track, dtype=np.int64)


def _log_range(states: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.log(np.maximum(np.hypot(states[..., 0], states[..., 2]), 1e-6)))
