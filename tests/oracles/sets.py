"""Distances of two sets: those of the scores, and by their definitions, over every assignment."""

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scoring.sets import SetDistance, assigned, distance_of, squared_distances

CUT_OFF_KM = 5.0


def set_distance(tracks: NDArray[np.float64], truths: NDArray[np.float64]) -> SetDistance:
    """What the scores say of tracks, (n, 4), and targets, (m, 4)."""
    squared = squared_distances(tracks, truths)
    within = [float(squared[i, j]) for i, j in enumerate(assigned(squared)) if j >= 0]
    return distance_of(len(tracks), len(truths), within)


def _squared(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float((a[0] - b[0]) ** 2 + (a[2] - b[2]) ** 2)


def slow_gospa(tracks: NDArray[np.float64], truths: NDArray[np.float64]) -> float:
    """GOSPA, p = 2, alpha = 2: the least over all pairings of some tracks with some truths."""
    best, places = np.inf, [*range(len(truths)), *(-1 for _ in tracks)]
    for targets in set(permutations(places, len(tracks))):
        pairs = [(i, j) for i, j in enumerate(targets) if j >= 0]
        left = len(tracks) + len(truths) - 2 * len(pairs)
        best = min(best, sum(_squared(tracks[i], truths[j]) for i, j in pairs) + 0.5 * CUT_OFF_KM**2 * left)
    return float(np.sqrt(best))


def slow_ospa(tracks: NDArray[np.float64], truths: NDArray[np.float64]) -> float:
    """OSPA, p = 2: the least over all ways to give each of the smaller set one of the larger one."""
    few, many = sorted((tracks, truths), key=len)
    if not len(many):
        return 0.0
    costs = [
        sum(min(_squared(few[i], many[j]), CUT_OFF_KM**2) for i, j in enumerate(chosen))
        for chosen in permutations(range(len(many)), len(few))
    ]
    return float(np.sqrt((min(costs) + CUT_OFF_KM**2 * (len(many) - len(few))) / len(many)))
