"""How far a set of tracks is from a set of targets in one dwell: an assignment with a gate, GOSPA and OSPA.

States are [x, vx, y, vy] in km and km/s, along the last axis; only positions count. Symbols: n tracks, m targets,
d distance of a pair, c cut-off, gamma the pairs closer than c. The order is p = 2 throughout, and alpha = 2.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cogradar.shared.scoring.figures import CUT_OFF_KM

Floats = NDArray[np.float64]


class SetDistance(NamedTuple):
    """GOSPA with its parts, and OSPA; squares, in km^2, which add up over dwells."""

    localisation: float  # of the pairs, sum of d^2
    missed: float  # c^2 / 2 for each target without a track
    false: float  # c^2 / 2 for each track without a target
    ospa: float


def squared_distances(tracks: Floats, truths: Floats) -> Floats:
    """d^2 of each track and each target, km^2; (n, 4), (m, 4) -> (n, m)."""
    x, y = np.subtract.outer(tracks[:, 0], truths[:, 0]), np.subtract.outer(tracks[:, 2], truths[:, 2])
    return np.asarray(x * x + y * y)


def assigned(squared: Floats, worth: Floats | None = None) -> list[int]:
    """Which target each track is assigned to, at most one to one; -1: to none within the gate.

        minimise  sum over gamma of (d^2 - worth) + c^2 / 2 (n + m - 2 |gamma|)

    squared : (n, m) of `squared_distances`
    worth   : (n, m) what a pair is worth beyond its distance, km^2, 0 where d >= c; without it the optimum is GOSPA's
    returns : (n,)
    """
    cost = np.minimum(squared, CUT_OFF_KM**2)
    rows, columns = linear_sum_assignment(cost if worth is None else cost - worth)
    found = [-1] * len(squared)
    for i, j, d in zip(rows.tolist(), columns.tolist(), squared[rows, columns].tolist(), strict=True):
        found[i] = j if d < CUT_OFF_KM**2 else -1
    return found


def distance_of(n_track: int, n_target: int, within: Sequence[float]) -> SetDistance:
    """Distance of two sets from their optimal assignment.

        GOSPA^2 = sum over gamma of d^2 + c^2 / 2 (m - |gamma|) + c^2 / 2 (n - |gamma|)   (Rahmathullah et al. 2017)
        OSPA^2  = (sum over gamma of d^2 + c^2 (max(n, m) - |gamma|)) / max(n, m)          (Schuhmacher et al. 2008)

    Both minimise the same sum at p = 2, so one assignment serves both. Two empty sets are 0 apart.

    within : d^2 of the pairs, km^2
    """
    localisation, each, n = sum(within), 0.5 * CUT_OFF_KM**2, len(within)
    largest = max(n_track, n_target)
    apart = localisation + 2.0 * each * (largest - n)
    return SetDistance(localisation, each * (n_target - n), each * (n_track - n), apart / largest if largest else 0.0)
