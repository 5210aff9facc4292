"""Whose detection is whose, where tracks are so near to each other that they compete for them.

A scan says where each track was expected, as a Gaussian of direction and range. So every owner of a track finds the
same assignment from the scan alone. A detection belongs to one track, and a track has one detection. A cluster are the
tracks that compete directly or through others. Of all its assignments the most probable one holds (global nearest
neighbour; Blackman and Popoli, "Design and Analysis of Modern Tracking Systems").

Several echoes in one cell add: they are one detection, whose direction is between theirs or beyond. The track that it
is not assigned to is hidden there: that it has none is no miss. The direction is believed less by as much as the other
echo may have drawn it aside.

Symbols: p_ij probability that track i has its echo in the cell of detection j; sigma_nu standard deviation of a
direction.
"""

from math import log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.error_function import erfc
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.angle import apart
from cogradar.shared.signal.array import around
from cogradar.shared.signal.looks import NEIGHBOURS
from cogradar.shared.signal.response import Response
from cogradar.shared.signal.scan import Detections, Floats
from cogradar.shared.tracking.sensor import heard

Ints = NDArray[np.int64]

CLUTTER_DENSITY = 1e-4  # detections without a track, false or of a new target, per main lobe and range cell
MANEUVER_LOG_ODDS = 1.0  # most log odds of a detection in a track's own looks in which the track was not expected
IN_DOUBT = log(10.0)  # log odds: an assignment that is less probable by less might be true as well
UNRESOLVED_ABOVE = 0.1  # probability of being in a cell with another's echo from which on a miss there says nothing
_SIGMAS = 4.0  # of where a track is expected
_ROUNDING_KM = 1e-6  # of ranges that are compared
_SAME_ECHO = 3.0  # standard deviations between two directions of one echo
_TINY, _LEAST_SIGMA = 1e-300, 1e-12
_NEVER = -1e9
_COMPETES = -2  # in place of the detection of a track with which others compete
_LIKELY = 0.5  # probability of existence
_LOUDEST = 1.5  # amplitude of an echo in a look beside, of what its main lobe lets through there
P_D = 0.9  # of a track that exists


class Share(NamedTuple):
    """What a track has of a dwell's detections."""

    row: int  # of the scan, its detection; -1: none
    drawn: float = 0.0  # standard deviation of what other echoes in its cell may add to its direction
    unresolved: float = 0.0  # it has none: probability that its echo is in the cell of another's, 0 if it is small
    in_doubt: bool = False  # hidden, or another assignment is nearly as probable

    @property
    def is_hidden(self) -> bool:
        """It has no detection, which says nothing of where it is: another's may have its echo."""
        return self.unresolved > 0.0


class _Cluster(NamedTuple):
    """m tracks that compete, directly or through others, for n detections, and the most probable assignment."""

    tracks: Ints  # (m,) rows of the roster, ascending
    rows: Ints  # (n,) of the scan, the detections
    fits: Floats  # (m, n) log odds that a detection is of a track that flies as expected, against no track's
    in_cell: Floats  # (m, n) probability that the track is in the detection's range cell
    in_lobe: Floats  # (m, n) ... and in half of its main lobe
    different: Ints  # (d,) which detections are the strongest of an echo
    scores: Floats  # (m, d) log odds of each track and these
    taken: Ints  # (m,) which of these each track has; -1: none
    parts: Ints  # (m,) which tracks hang together through positive scores: the first of them


class Assignment:
    """Whose the detections of a scan are.

    Most tracks compete with no other: theirs are worked out at once. A cluster of several is worked out when one of its
    tracks is first asked for.
    """

    def __init__(self, scan: Detections, response: Response) -> None:
        self._scan, self._response = scan, response
        self._over = np.flatnonzero(scan.is_over())
        looks = np.where(scan.beams >= 0, scan.beam_nus, np.nan)
        # New arrays: a message's may be read-only, which to a kernel is another type.
        self._places = np.hstack((np.asarray(scan.expected), scan.gates, looks))
        self._seen = np.array((scan.nus, scan.ranges_km, scan.nu_hats, scan.nu_sigmas)).take(self._over, axis=1)
        self._order = np.argsort(-scan.statistic[self._over], kind="stable")  # the strongest first
        self._labels, self._theirs, self._alone = _separate(
            self._places, self._seen, self._order, response.lobe, response.range_cell_km
        )
        self._clusters: dict[int, _Cluster] = {}

    def share(self, own: int) -> Share:
        """What the track in this row of the roster has."""
        if (alone := self._alone[own]) != _COMPETES:
            return Share(int(self._over[alone]) if alone >= 0 else -1)
        tracks, rows, fits, in_cell, in_lobe, different, scores, taken, parts = self._cluster(int(self._labels[own]))
        at, places = int(np.searchsorted(tracks, own)), self._places[tracks]
        in_doubt = is_in_doubt(scores, taken, parts, at)
        if taken[at] < 0:
            of_others = different[taken[taken >= 0]]
            unresolved = float((in_cell[at, of_others] * in_lobe[at, of_others]).max(initial=0.0))
            if unresolved >= UNRESOLVED_ABOVE:
                return Share(-1, 0.0, unresolved, in_doubt=True)
            return Share(-1, in_doubt=in_doubt)
        column = int(different[taken[at]])
        if fits[at, column] <= 0.0 and _is_unresolved(self._response, places, at):
            # Two echoes that add are likelier than a turn.
            return Share(-1, 0.0, max(float(in_cell[at, column]), UNRESOLVED_ABOVE), in_doubt=True)
        # Of a track with a detection it is known in which range cell it is.
        ranges_km = self._scan.ranges_km[rows]
        is_there = ranges_km[different[taken]] == ranges_km[column]
        chances = np.where(taken >= 0, is_there, in_cell[:, column])
        drawn = _drawn(self._response, places[:, 0], at, float(self._scan.nus[rows[column]]), chances)
        return Share(int(rows[column]), drawn, in_doubt=in_doubt)

    def unclaimed(self) -> Ints:
        """Rows of detections that no track has, the strongest of each echo, the strongest first."""
        over, scan, claimed = self._over, self._scan, np.zeros(self._scan.nus.size, np.bool_)
        claimed[over[self._alone[self._alone >= 0]]] = True
        competing = self._labels[self._alone == _COMPETES]
        for label in np.unique(competing).tolist() if competing.size else ():
            cluster = self._cluster(label)
            claimed[cluster.rows[cluster.different[cluster.taken[cluster.taken >= 0]]]] = True
        columns = (scan.statistic, heard(scan.alpha_hat), scan.sigma_hat)
        seen = np.vstack((self._seen, np.array(columns)[:, over]))
        widths, loss = (self._response.lobe, self._response.range_cell_km), self._response.loss_table()
        return np.asarray(over[_new_echoes(self._order, seen, claimed[over], self._places, widths, loss)])

    def _cluster(self, label: int) -> _Cluster:
        """A cluster of several tracks."""
        if label in self._clusters:
            return self._clusters[label]
        lobe, cell_km = self._response.lobe, self._response.range_cell_km
        tracks, found = np.flatnonzero(self._labels == label), np.flatnonzero(self._theirs == label)
        fits, turned, in_cell, in_lobe = _pairs_of(tracks, found, self._places, self._seen, lobe, cell_km)
        rows = self._over[found]
        order = np.argsort(-self._scan.statistic[rows], kind="stable")
        different = _different(order, self._seen[:, found], fits, lobe, cell_km)
        scores = np.maximum(fits, turned)[:, different]
        scores = np.where(scores > 0.0, scores, _NEVER)
        made = _Cluster(tracks, rows, fits, in_cell, in_lobe, different, scores, *assigned(scores))
        self._clusters[label] = made
        return made


def share_of(response: Response, scan: Detections, own: int) -> Share:
    """What the track in this row of the roster has of a scan that says where its tracks were expected."""
    return scan.once(Assignment, response).share(own)


def unclaimed(response: Response, scan: Detections) -> Ints:
    """Rows of detections that no track has, the strongest of each echo, the strongest first: targets without a track.

    The tracks have what `share_of` gives to them. Of two echoes in one cell any direction may be measured: where two
    tracks are, none begins.
    """
    return scan.once(Assignment, response).unclaimed()


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
    gains[own, taken[own] if taken[own] >= 0 else slice(n, None)] = _NEVER
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


def _drawn(response: Response, nus: Floats, own: int, nu_c: float, chances: Floats) -> float:
    """How far the echoes of other tracks may draw aside the direction of a detection, for echoes of equal strength.

        sqrt(sum_i p_i (D_T D_R(nu_i - nu_c) (nu_i - nu))^2)

    nus     : (m,) where tracks were expected, nu_i; nu: the own one
    nu_c    : of the look
    chances : (m,) p_i, probability of each to be in the range cell
    """
    return float(np.sqrt(np.sum(chances * (response.loss(nus - nu_c) * around(nus - nus[own])) ** 2)))


def _is_unresolved(response: Response, tracks: Floats, own: int) -> bool:
    """Whether a target is expected so near, of tracks (m, 5 and more), that cells may have the echoes of both."""
    others = np.delete(tracks, own, axis=0)
    off_nu, off_km = np.abs(around(others[:, 0] - tracks[own, 0])), np.abs(others[:, 2] - tracks[own, 2])
    is_near = (off_nu < response.lobe) & (off_km < NEIGHBOURS * response.range_cell_km)
    return bool((is_near & (others[:, 4] > _LIKELY)).any())


@kernel
def _different(order: Ints, seen: Floats, fits: Floats, lobe: float, cell_km: float) -> Ints:
    """Of detections, (n,), the strongest of each echo: which, ascending.

    Neighbouring ones are of different echoes if they fit different tracks best, and differ in direction or range. One
    of another range cell that fits a track better than a stronger one is kept beside it.

    order : (n,) the strongest first
    seen  : (4, n) as for `_separate`
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
            if not is_better or (is_same_cell and _are_alike(seen[:, i], seen[:, j], 0.0)):
                is_new = False
                break
        is_kept[i] = is_new
    return np.flatnonzero(is_kept)


@kernel
def _new_echoes(
    order: Ints, seen: Floats, claimed: NDArray[np.bool_], tracks: Floats, widths: tuple[float, float], loss: Floats
) -> Ints:
    """Which detections, (n,), are echoes of their own, that no track has and no stronger one explains.

    order   : (n,) the strongest first
    seen    : (7, n) as for `_separate`; statistic, |alpha_hat|, sigma_hat
    claimed : (n,) by a track
    tracks  : (M, 5 and more) as for `_separate`
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
            n_track += is_near and tracks[t, 4] > _LIKELY
        is_new = n_track < 2
        for j in range(order.size):
            if not (is_new and taken[j] and _are_near(seen[:, i], seen[:, j], lobe, cell_km)):
                continue
            # A target between two range cells is in both, and another look may have met it in the other one.
            is_apart = (seen[0] == seen[0, i]) & (seen[1] == seen[1, j])
            if seen[1, i] == seen[1, j]:
                is_new = not _is_heard_beside(seen[:, i], seen[:, j], lobe, loss)
            elif not is_apart.any():
                is_new = not _are_alike(seen[:, i], seen[:, j], 0.0)
        if is_new:
            taken[i] = True
            found[n_found] = i
            n_found += 1
    return found[:n_found]


@kernel
def _is_heard_beside(one: Floats, other: Floats, lobe: float, loss: Floats) -> bool:
    """Whether a detection, (7,), is another look at the echo of another one: alike, or no stronger than a leak."""
    if _are_alike(one, other, 0.5 * lobe) or (one[3] == 0.0 and other[3] == 0.0):
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
def _are_alike(one: Floats, other: Floats, beside: float) -> bool:
    """Whether two measured directions may be of one echo, or lie no further apart than this."""
    return bool(apart(one[2], other[2]) <= _SAME_ECHO * sqrt(one[3] ** 2 + other[3] ** 2) + beside)


@kernel
def _separate(tracks: Floats, seen: Floats, order: Ints, lobe: float, cell_km: float) -> tuple[Ints, Ints, Ints]:
    """The clusters of all tracks: label of each track, (M,), and of each detection, (n,), as of `_labelled`; and the
    detection of each track with which no other competes, (M,); -1: none, _COMPETES: others do.

    tracks  : (M, 7 + L) nu, its sigma, range, its sigma, probability of existence, gate, directions of looks; NaN: none
    seen    : (4, n) of detections the direction of the look, range, measured direction, its sigma
    order   : (n,) the strongest first
    cell_km : width of a range cell
    """
    starts, pairs = _possible(tracks, seen, lobe, cell_km)
    labels, theirs = _labelled(starts, pairs, order.size)
    rank, sizes, alone = np.argsort(order), np.bincount(labels, minlength=1), np.full(labels.size, -1)
    for own in range(labels.size):
        if sizes[labels[own]] > 1:
            alone[own] = _COMPETES
            continue
        found, best = pairs[starts[own] : starts[own + 1]], 0.0
        fits, turned, _, _ = _pairs_of(labels[own : own + 1], found, tracks, seen, lobe, cell_km)
        for j in _different(np.argsort(rank[found]), seen[:, found], fits, lobe, cell_km):
            score = max(fits[0, j], turned[0, j])
            if score > best:
                best, alone[own] = score, found[j]
    return labels, theirs, alone


@kernel
def _possible(tracks: Floats, seen: Floats, lobe: float, cell_km: float) -> tuple[Ints, Ints]:
    """Which detections may be of which track (`_may_be`): where each track's begin, (M + 1,), in a list of all,
    ascending for each track.

    Sorted by range, most of the detections need not be looked at: cost O((M + n) log n + pairs), where ranges are
    measured. Arguments as of `_separate`.
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
def _labelled(starts: Ints, pairs: Ints, n: int) -> tuple[Ints, Ints]:
    """Which tracks and detections, (n,), of the pairs of `_possible` hang together: the label of each is the first
    track; -1: none.
    """
    labels, theirs = (
        np.arange(starts.size - 1),
        np.full(n, -1),
    )  # while it goes on, a track that each hangs together with
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
def _parts(scores: Floats) -> Ints:
    """Which tracks, (m,), hang together through positive scores, (m, n): the first of them."""
    m, n = scores.shape
    starts, pairs, n_pair = np.zeros(m + 1, np.int64), np.empty(m * n, np.int64), 0
    for i in range(m):
        for j in range(n):
            if scores[i, j] > 0.0:
                pairs[n_pair], n_pair = j, n_pair + 1
        starts[i + 1] = n_pair
    return _labelled(starts, pairs[:n_pair], n)[0]


@kernel
def _pairs_of(
    rivals: Ints, theirs: Ints, tracks: Floats, seen: Floats, lobe: float, cell_km: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Of tracks, (m,), and detections, (n,), of all that `_separate` describes: `fits`, log odds of a track that has
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
                turned[a, b] = _NEVER
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
            other[1] == detection[1] and _are_alike(other, detection, 0.0) and apart(other[0], other[2]) < 0.5 * lobe
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
