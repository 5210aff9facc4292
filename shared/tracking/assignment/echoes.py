"""Which detections are echoes of their own: one echo is met in several looks and range cells."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.angle import apart
from cogradar.shared.signal.looks import NEIGHBOURS
from cogradar.shared.signal.scan import Floats

Ints = NDArray[np.int64]

LIKELY = 0.5  # probability of existence
_SAME_ECHO = 3.0  # standard deviations between two directions of one echo
_LOUDEST = 1.5  # amplitude of an echo in a look beside, of what its main lobe lets through there


@kernel
def strongest_of_each(order: Ints, seen: Floats, fits: Floats, lobe: float, cell_km: float) -> Ints:
    """Of detections, (n,), the strongest of each echo: which, ascending.

    Neighbouring ones are of different echoes if they fit different tracks best, and differ in direction or range. One
    of another range cell that fits a track better than a stronger one is kept beside it.

    order : (n,) the strongest first
    seen  : (4, n) as for `clusters.separate`
    fits  : (m, n) log odds of each track and detection
    """
    is_kept = np.zeros(order.size, np.bool_)
    for i in order:
        best_i = np.argmax(fits[:, i])
        most_i, is_new = fits[best_i, i], True
        for j in np.flatnonzero(is_kept):
            if not _are_near(seen[:, i], seen[:, j], lobe, cell_km):
                continue
            is_same_cell, best_j = seen[1, i] == seen[1, j], np.argmax(fits[:, j])
            is_better = most_i > 0.0 and (fits[best_j, j] <= 0.0 or best_j != best_i)
            is_better |= not is_same_cell and fits[best_j, j] < most_i
            if not is_better or (is_same_cell and are_alike(seen[:, i], seen[:, j], 0.0)):
                is_new = False
                break
        is_kept[i] = is_new
    return np.flatnonzero(is_kept)


@kernel
def unclaimed_echoes(
    order: Ints, seen: Floats, claimed: NDArray[np.bool_], tracks: Floats, widths: tuple[float, float], loss: Floats
) -> Ints:
    """Which detections, (n,), are echoes of their own, that no track has and no stronger one explains.

    order   : (n,) the strongest first
    seen    : (7, n) as for `clusters.separate`; statistic, |alpha_hat|, sigma_hat
    claimed : (n,) by a track
    tracks  : (M, 5 and more) as for `clusters.separate`
    widths  : lobe, range cell
    loss    : D_T D_R at equal steps from the axis to the lobe's edge
    """
    lobe, cell_km = widths
    found, n_found = np.empty(order.size, np.int64), 0
    taken = claimed.copy()
    for i in order:
        if claimed[i]:
            continue
        # It may be the sum of two echoes: two tracks are expected in its cell, or beside.
        n_track = 0
        for t in range(tracks.shape[0]):
            is_near = apart(tracks[t, 0], seen[2, i]) < lobe and abs(tracks[t, 2] - seen[1, i]) < NEIGHBOURS * cell_km
            n_track += is_near and tracks[t, 4] > LIKELY
        is_new = n_track < 2
        for j in range(order.size):
            if not (is_new and taken[j] and _are_near(seen[:, i], seen[:, j], lobe, cell_km)):
                continue
            # A target between two range cells is in both, and another look may have met it in the other one.
            is_apart = (seen[0] == seen[0, i]) & (seen[1] == seen[1, j])
            if seen[1, i] == seen[1, j]:
                is_new = not _is_heard_beside(seen[:, i], seen[:, j], lobe, loss)
            elif not is_apart.any():
                is_new = not are_alike(seen[:, i], seen[:, j], 0.0)
        if is_new:
            taken[i] = True
            found[n_found] = i
            n_found += 1
    return found[:n_found]


@kernel
def _is_heard_beside(one: Floats, other: Floats, lobe: float, loss: Floats) -> bool:
    """Whether a detection, (7,), is another look at the echo of another one: alike, or no stronger than a leak."""
    if are_alike(one, other, 0.5 * lobe) or (one[3] == 0.0 and other[3] == 0.0):
        return True
    position, lost = apart(other[2], one[0]) / lobe * (loss.size - 1), 0.0
    if position < loss.size - 1:
        at = int(position)
        lost = loss[at] + (position - at) * (loss[at + 1] - loss[at])
    is_leak = one[5] <= _LOUDEST * other[5] * lost + _SAME_ECHO * one[6]
    is_leak |= apart(other[0], one[0]) < lobe  # of two echoes that add, any direction may be measured
    return bool(is_leak and other[4] >= one[4])


@inlined
def _are_near(one: Floats, other: Floats, lobe: float, cell_km: float) -> bool:
    """Whether two detections may be of one target (`Response.is_one_echo`)."""
    near = apart(one[0], other[0]) < NEIGHBOURS * lobe and abs(one[1] - other[1]) < NEIGHBOURS * cell_km
    return bool(near)


@inlined
def are_alike(one: Floats, other: Floats, beside: float) -> bool:
    """Whether two measured directions may be of one echo, or lie no further apart than this."""
    return bool(apart(one[2], other[2]) <= _SAME_ECHO * sqrt(one[3] ** 2 + other[3] ** 2) + beside)
