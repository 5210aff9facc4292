"""The most probable assignment of detections to tracks (global nearest neighbour), and how sure it is."""

from math import log

import numpy as np

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.scan import Floats
from cogradar.shared.tracking.assignment.clusters import NEVER, labelled
from cogradar.shared.tracking.assignment.echoes import Ints

IN_DOUBT = log(10.0)  # log odds: an assignment that is less probable by less might be true as well


def assigned(scores: Floats) -> tuple[Ints, Ints]:
    """The detection of each track in the most probable assignment, (m,), -1: none; and which tracks hang together
    through detections that may be of either, (m,): the first of them.

    What does not hang together is assigned apart: a solver's time grows with the third power.

    scores : (m, n) log odds of each pair against neither, of m tracks and n detections
    """
    parts = _parts(scores)
    if not parts.any():
        return _taken(scores), parts
    taken = np.full(parts.size, -1)
    for first in np.unique(parts).tolist():
        part = np.flatnonzero(parts == first)
        theirs = _theirs(scores[part])
        taken[part] = np.append(theirs, -1)[_taken(scores[np.ix_(part, theirs)])]
    return taken, parts


def is_in_doubt(scores: Floats, taken: Ints, parts: Ints, own: int) -> bool:
    """Whether another assignment, in which a track has not what is taken, is nearly as probable (`assigned`)."""
    if parts.any():
        part = np.flatnonzero(parts == parts[own])
        theirs = _theirs(scores[part])
        there = np.where(taken[part] >= 0, np.searchsorted(theirs, taken[part]), -1)
        scores, taken, own = scores[np.ix_(part, theirs)], there, int(np.searchsorted(part, own))
    m, n = scores.shape
    gains = np.zeros((m, n + m))
    gains[:, :n] = scores
    best = sum(scores[i, column] for i, column in enumerate(taken.tolist()) if column >= 0)
    gains[own, taken[own] if taken[own] >= 0 else slice(n, None)] = NEVER
    return bool(best - gains[_best_pairs(gains)].sum() < IN_DOUBT)


def _taken(scores: Floats) -> Ints:
    """The detection of each track, all solved together."""
    m, n = scores.shape
    _, columns = _best_pairs(np.hstack((scores, np.zeros((m, m)))))
    return np.where(columns < n, columns, -1)


def _theirs(scores: Floats) -> Ints:
    """The detections that may be of some of these tracks."""
    return np.flatnonzero((scores > 0.0).any(axis=0))


def _best_pairs(gains: Floats) -> tuple[Ints, Ints]:
    """Rows and columns of the pairs with the largest sum of gains, (m, n) -> (m,) each."""
    from scipy.optimize import linear_sum_assignment  # 0.4 s of import, which `load_solver` may spend in advance

    pairs: tuple[Ints, Ints] = linear_sum_assignment(gains, maximize=True)
    return pairs


def load_solver() -> None:
    """Import what `assigned` solves with, before a dwell waits for it."""
    assigned(np.zeros((2, 2)))


@kernel
def _parts(scores: Floats) -> Ints:
    """Which tracks, (m,), hang together through positive scores, (m, n): the first of them."""
    m, n = scores.shape
    starts, pairs, n_pair = np.zeros(m + 1, np.int64), np.empty(m * n, np.int64), 0
    for i in range(m):
        for j in range(n):
            if scores[i, j] > 0.0:
                pairs[n_pair], n_pair = j, n_pair + 1
        starts[i + 1] = n_pair
    return labelled(starts, pairs[:n_pair], n)[0]
