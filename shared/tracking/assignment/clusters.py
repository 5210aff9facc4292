"""Which tracks compete for detections, and how well each detection fits each track."""

from math import log, pi, sqrt

import numpy as np

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.error_function import erfc
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.angle import apart
from cogradar.shared.signal.scan import Floats
from cogradar.shared.tracking.assignment.echoes import Ints, are_alike, strongest_of_each

CLUTTER_DENSITY = 1e-4  # detections without a track, false or of a new target, per main lobe and range cell
MANEUVER_LOG_ODDS = 1.0  # most log odds of a detection in a track's own looks in which the track was not expected
COMPETES = -2  # in place of the detection of a track with which others compete
NEVER = -1e9
P_D = 0.9  # of a track that exists
_SIGMAS = 4.0  # of where a track is expected
_ROUNDING_KM = 1e-6  # of ranges that are compared
_TINY, _LEAST_SIGMA = 1e-300, 1e-12


@kernel
def separate(tracks: Floats, seen: Floats, order: Ints, lobe: float, cell_km: float) -> tuple[Ints, Ints, Ints]:
    """The clusters of all tracks: label of each track, (M,), and of each detection, (n,), as of `labelled`; and the
    detection of each track with which no other competes, (M,); -1: none, COMPETES: others do.

    tracks  : (M, 7 + L) nu, its sigma, range, its sigma, probability of existence, gate, directions of looks; NaN: none
    seen    : (4, n) of detections the direction of the look, range, measured direction, its sigma
    order   : (n,) the strongest first
    cell_km : width of a range cell
    """
    starts, pairs = _possible(tracks, seen, lobe, cell_km)
    labels, theirs = labelled(starts, pairs, order.size)
    rank, sizes, alone = np.argsort(order), np.bincount(labels, minlength=1), np.full(labels.size, -1)
    for own in range(labels.size):
        if sizes[labels[own]] > 1:
            alone[own] = COMPETES
            continue
        found, best = pairs[starts[own] : starts[own + 1]], 0.0
        fits, turned, _, _ = pairs_of(labels[own : own + 1], found, tracks, seen, lobe, cell_km)
        for j in strongest_of_each(np.argsort(rank[found]), seen[:, found], fits, lobe, cell_km):
            score = max(fits[0, j], turned[0, j])
            if score > best:
                best, alone[own] = score, found[j]
    return labels, theirs, alone


@kernel
def _possible(tracks: Floats, seen: Floats, lobe: float, cell_km: float) -> tuple[Ints, Ints]:
    """Gate the detections (`_may_be`): the index at which the part of each track begins, (M + 1,), in a list of the
    possible detections of all tracks, which ascends for each track.

    Sorted by range, most of the detections need not be looked at: cost O((M + n) log n + pairs), where ranges are
    measured. Arguments as of `separate`.
    """
    columns, by_range = seen.T.copy(), np.argsort(seen[1])
    ranges_km = seen[1][by_range]
    starts, pairs, n_pair = np.zeros(tracks.shape[0] + 1, np.int64), np.empty(by_range.size + 1, np.int64), 0
    n_unmeasured = np.searchsorted(ranges_km, 0.0, side="right")  # a look without ranges is one of any gate
    for i in range(tracks.shape[0]):
        reach_km = _SIGMAS * tracks[i, 3] + cell_km + _ROUNDING_KM
        low_km, high_km = tracks[i, 2] - reach_km, tracks[i, 2] + reach_km
        if tracks[i, 6] == 0.0:  # its looks are of all ranges
            low_km, high_km = -np.inf, np.inf
        first = max(np.searchsorted(ranges_km, min(low_km, tracks[i, 5])), n_unmeasured)
        last = max(np.searchsorted(ranges_km, max(high_km, tracks[i, 6]), side="right"), first)
        for at in range(n_unmeasured + last - first):
            j = by_range[at if at < n_unmeasured else at - n_unmeasured + first]
            if _may_be(tracks[i], columns[j], lobe, cell_km):
                if n_pair == pairs.size:
                    pairs = np.append(pairs, pairs)
                pairs[n_pair], n_pair = j, n_pair + 1
        pairs[starts[i] : n_pair] = np.sort(pairs[starts[i] : n_pair])
        starts[i + 1] = n_pair
    return starts, pairs[:n_pair]


@kernel
def labelled(starts: Ints, pairs: Ints, n: int) -> tuple[Ints, Ints]:
    """Which tracks and detections, (n,), of the pairs of `_possible` hang together: the label of each is the first
    track; -1: none.
    """
    # While it goes on, of each a track that it hangs together with.
    labels, theirs = np.arange(starts.size - 1), np.full(n, -1)
    for i in range(labels.size):
        for j in pairs[starts[i] : starts[i + 1]]:
            if theirs[j] < 0:
                theirs[j] = i
                continue
            one, other = i, theirs[j]
            while labels[one] != one:
                one = labels[one]
            while labels[other] != other:
                other = labels[other]
            labels[max(one, other)] = min(one, other)
    for i in range(labels.size):  # those before it have their own by now
        labels[i] = labels[labels[i]]
    for j in range(n):
        if theirs[j] >= 0:
            theirs[j] = labels[theirs[j]]
    return labels, theirs


@kernel
def pairs_of(
    rivals: Ints, theirs: Ints, tracks: Floats, seen: Floats, lobe: float, cell_km: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Of tracks, (m,), and detections, (n,), of all that `separate` describes: `fits`, log odds of a track that has
    turned, `in_cell` and `in_lobe` of a `_Cluster`; (m, n) each.
    """
    fits, turned = np.empty((rivals.size, theirs.size)), np.empty((rivals.size, theirs.size))
    in_cell, in_lobe = np.empty(fits.shape), np.empty(fits.shape)
    for a in range(rivals.size):
        track = tracks[rivals[a]]
        nu, nu_sigma, range_km, range_sigma, existence = track[:5]
        found = existence * P_D
        met = theirs[np.array([_is_own(track, seen[:, j]) for j in theirs], np.bool_)]
        for b in range(theirs.size):
            detection = seen[:, theirs[b]]
            nu_c, cell, nu_hat, measured = detection
            sigma = hypot(nu_sigma, measured if measured > 0.0 else lobe / sqrt(12.0))
            distance_sq = (apart(nu_hat, nu) / sigma) ** 2
            fits[a, b] = log(2.0 * lobe / (sqrt(2.0 * pi) * sigma * CLUTTER_DENSITY)) - 0.5 * distance_sq
            odds = log(max(found, _TINY) / (1.0 - found))
            fits[a, b] += odds
            in_cell[a, b] = _between(cell - range_km, 0.5 * cell_km, range_sigma)
            fits[a, b] += log(max(in_cell[a, b], _TINY))
            distance_sq += (cell - range_km) ** 2 / (range_sigma**2 + cell_km**2)
            in_lobe[a, b] = _between(apart(nu_c, nu), 0.5 * lobe, nu_sigma)
            # The more the nearer: of detections that are all unexpected the nearest.
            turned[a, b] = MANEUVER_LOG_ODDS * (0.5 + 0.5 / (1.0 + sqrt(distance_sq))) + min(odds, 0.0)
            if not _is_met(seen, met, theirs[b], lobe):
                turned[a, b] = NEVER
    return fits, turned, in_cell, in_lobe


@kernel
def _may_be(track: Floats, detection: Floats, lobe: float, cell_km: float) -> bool:
    """Whether a detection may be of a track at all: about where it was expected, or in a look of its own."""
    in_range = abs(detection[1] - track[2]) < _SIGMAS * track[3] + cell_km
    in_direction = apart(detection[0], track[0]) < _SIGMAS * track[1] + lobe
    return (in_range and in_direction) or _is_own(track, detection)


@kernel
def _is_met(seen: Floats, met: Ints, one: int, lobe: float) -> bool:
    """Whether a look that was made for a track met the echo of a detection, which a look beside may have had more of.

    Where the echo was only heard beside the look's axis, it is another target's.

    met : the detections in looks that were made for the track
    """
    detection = seen[:, one]
    for j in met:
        other = seen[:, j]
        is_same = (
            other[1] == detection[1] and are_alike(other, detection, 0.0) and apart(other[0], other[2]) < 0.5 * lobe
        )
        if is_same or j == one:
            return True
    return False


@kernel
def _is_own(track: Floats, detection: Floats) -> bool:
    """Whether a detection is of a look that was made for a track, in its gate."""
    for nu in track[7:]:
        if nu == detection[0]:
            return bool(track[6] == 0.0 or detection[1] == 0.0 or track[5] < detection[1] < track[6])
    return False


@inlined
def _between(off: float, half: float, sigma: float) -> float:
    """Probability that N(off, sigma^2) is in -half .. half."""
    scale = sqrt(2.0) * max(sigma, _LEAST_SIGMA)
    return 0.5 * (erfc((abs(off) - half) / scale) - erfc((abs(off) + half) / scale))
