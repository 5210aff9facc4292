"""Whose detection is whose, where tracks are so near to each other that they compete for them.

A scan says where each track was expected, as a Gaussian of direction and range. So every owner of a track finds the
same assignment from the scan alone. A detection belongs to one track, and a track has one detection: of all
assignments of a cluster, the tracks that compete directly or through others, the most probable one holds (global
nearest neighbour; Blackman and Popoli, "Design and Analysis of Modern Tracking Systems").

Several echoes in one cell add: they are one detection, whose direction is between theirs or beyond. The track that it
is not assigned to is hidden there: that it has none is no miss. The direction is believed less by as much as the other
echo may have drawn it aside.

Symbols: p_ij probability that track i has its echo in the cell of detection j; sigma_nu that of a direction.
"""

from math import erfc, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.response import NEIGHBOURS, Response
from cogradar.shared.signal.scan import Detections, Floats

Ints = NDArray[np.int64]

CLUTTER_DENSITY = 1e-4  # detections without a track, false or of a new target, per main lobe and range cell
MANEUVER_LOG_ODDS = 1.0  # most log odds of a detection in a track's own looks in which the track was not expected
IN_DOUBT = log(10.0)  # log odds: an assignment that is less probable by less might be true as well
UNRESOLVED_ABOVE = (
    0.1  # probability of being in a cell with the echo of another, from which on a miss there says nothing
)
_SIGMAS = 4.0  # of where a track is expected
_SAME_ECHO = 3.0  # standard deviations between two directions of one echo
_TINY, _LEAST_SIGMA = 1e-300, 1e-12
_NEVER = -1e9
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


class _Pairs(NamedTuple):
    """A cluster: m tracks that compete, directly or through others, and the n detections for which they do."""

    tracks: Ints  # (m,) rows of the roster, ascending
    found: Ints  # (n,) which of the scan's detections, ascending
    fits: Floats  # (m, n) log odds that a detection is of a track that flies as expected, against nobody's
    turned: Floats  # (m, n) ... that has turned
    in_cell: Floats  # (m, n) probability that the track is in the detection's range cell
    in_lobe: Floats  # (m, n) ... and in half of its main lobe


class _Cluster(NamedTuple):
    """Tracks that compete, and the most probable assignment of their detections."""

    pairs: _Pairs
    places: Floats  # (m, 7 + L) of its tracks, as `_competing` has them
    rows: Ints  # (n,) of the scan, its detections
    different: Ints  # (d,) which of them are the strongest of an echo
    taken: Ints  # (m,) which of these each track has; -1: none
    in_doubt: bool  # the detection of the track that was asked for


def share_of(response: Response, scan: Detections, own: int) -> Share:
    """What the track in this row of the roster has of a scan that says where its tracks were expected."""
    cluster = _cluster(response, scan, own)
    if cluster is None:
        return Share(-1)
    pairs, places, rows, different, taken, in_doubt = cluster
    at = int(np.searchsorted(pairs.tracks, own))
    if taken[at] < 0:
        of_others = different[taken[taken >= 0]]
        unresolved = float((pairs.in_cell[at, of_others] * pairs.in_lobe[at, of_others]).max(initial=0.0))
        if unresolved >= UNRESOLVED_ABOVE:
            return Share(-1, 0.0, unresolved, in_doubt=True)
        return Share(-1, in_doubt=in_doubt)
    column = int(different[taken[at]])
    if pairs.fits[at, column] <= 0.0 and _is_unresolved(response, places, at):
        # Two echoes that add are likelier than a turn.
        return Share(-1, 0.0, max(float(pairs.in_cell[at, column]), UNRESOLVED_ABOVE), in_doubt=True)
    # Of a track with a detection it is known in which range cell it is.
    ranges_km = scan.ranges_km[rows]
    is_there = ranges_km[different[taken]] == ranges_km[column]
    chances = np.where(taken >= 0, is_there, pairs.in_cell[:, column])
    drawn = _drawn(response, places[:, 0], at, float(scan.nus[rows[column]]), chances)
    return Share(int(rows[column]), drawn, in_doubt=in_doubt)


def unclaimed(response: Response, scan: Detections) -> Ints:
    """Rows of detections that no track has, the strongest of each echo, the strongest first: targets without a track.

    The tracks have what `share_of` gives to them. Of two echoes in one cell any direction may be measured: where two
    tracks are, none begins.
    """
    claimed, waiting = np.empty(0, np.int64), np.ones(scan.beams.shape[0], np.bool_)
    for own in range(waiting.size):
        cluster = _cluster(response, scan, own) if waiting[own] else None
        if cluster is not None:
            waiting[cluster.pairs.tracks] = False
            claimed = np.append(claimed, cluster.rows[cluster.different[cluster.taken[cluster.taken >= 0]]])
    over = np.setdiff1d(np.flatnonzero(scan.is_over()), claimed)
    found = list[int]()
    for row in over[np.argsort(-scan.statistic[over], kind="stable")].tolist():
        others = np.append(claimed, np.array(found, np.int64))
        if not (_is_between_two(response, scan, row) or _is_heard_beside(response, scan, row, others)):
            found.append(row)
    return np.array(found, np.int64)


def assigned(scores: Floats, own: int) -> tuple[Ints, bool]:
    """The detection of each track in the most probable assignment, (m,), -1: none; and whether the own is in doubt.

    scores : (m, n) log odds of each pair against neither, of m tracks and n detections
    """
    m, n = scores.shape
    if m == 1:
        column = int(scores[0].argmax())
        return np.array([column if scores[0, column] > 0.0 else -1]), False
    gains = np.hstack((scores, np.zeros((m, m))))
    tracks, columns = linear_sum_assignment(gains, maximize=True)
    best, column = gains[tracks, columns].sum(), int(columns[own])
    gains[own, column if column < n else slice(n, None)] = _NEVER
    second = gains[linear_sum_assignment(gains, maximize=True)].sum()
    return np.where(columns < n, columns, -1), bool(best - second < IN_DOUBT)


def _different(response: Response, scan: Detections, rows: Ints, fits: Floats) -> Ints:
    """Of detections, (n,), the strongest of each echo: which, ascending.

    Neighbouring ones are of different echoes if they fit different tracks best, and differ in direction or range. One
    of another range cell that fits a track better than a stronger one is kept beside it.

    fits : (m, n) log odds of each track and detection
    """
    if rows.size == 1:
        return np.zeros(1, np.int64)
    kept = list[int]()
    most = fits.max(axis=0)
    best = np.where(most > 0.0, fits.argmax(axis=0), -1)
    for i in np.argsort(-scan.statistic[rows], kind="stable").tolist():
        row, others = rows[i], rows[kept]
        place = float(scan.nus[row]), float(scan.ranges_km[row])
        near = response.is_one_echo(scan.nus[others], scan.ranges_km[others], place)
        apart = np.abs(scan.nu_hats[others] - scan.nu_hats[row])
        alike = apart <= _SAME_ECHO * np.hypot(scan.nu_sigmas[others], scan.nu_sigmas[row])
        is_same_cell = scan.ranges_km[others] == scan.ranges_km[row]
        is_one = ((best[i] < 0) | (best[kept] == best[i])) & (is_same_cell | (most[kept] >= most[i]))
        if not (near & ((alike & is_same_cell) | is_one)).any():
            kept.append(i)
    return np.sort(np.array(kept, dtype=np.int64))


def _drawn(response: Response, nus: Floats, own: int, nu_c: float, chances: Floats) -> float:
    """How far the echoes of other tracks may draw aside the direction of a detection, for echoes of equal strength.

        sqrt(sum_i p_i (D_T D_R(nu_i - nu_c) (nu_i - nu))^2)

    nus     : (m,) where tracks were expected, nu_i; nu: the own one
    nu_c    : of the look
    chances : (m,) p_i, probability of each to be in the range cell
    """
    if nus.size == 1:
        return 0.0
    return float(np.sqrt(chances @ (response.loss(nus - nu_c) * (nus - nus[own])) ** 2))


def _is_unresolved(response: Response, tracks: Floats, own: int) -> bool:
    """Whether a target is expected so near, of tracks (m, 5 and more), that cells may have the echoes of both."""
    others = np.delete(tracks, own, axis=0)
    off = np.abs(others - tracks[own])
    is_near = (off[:, 0] < response.lobe) & (off[:, 2] < NEIGHBOURS * response.range_cell_km)
    return bool((is_near & (others[:, 4] > _LIKELY)).any())


def _cluster(response: Response, scan: Detections, own: int) -> _Cluster | None:
    """The cluster of the track in this row of the roster; None if there is no detection that may be its own."""
    over = np.flatnonzero(scan.is_over())
    looks = np.where(scan.beams >= 0, scan.beam_nus, np.nan)
    # New arrays: those of a message may be read-only, which to a kernel is another type.
    places = np.hstack((np.asarray(scan.expected), scan.gates, looks))
    seen = np.array((scan.nus, scan.ranges_km, scan.nu_hats, scan.nu_sigmas)).take(over, axis=1)
    pairs = _Pairs(*_competing(own, places, seen, response.lobe, response.range_cell_km))
    if pairs.found.size == 0:
        return None
    rows = over[pairs.found]
    different = _different(response, scan, rows, pairs.fits)
    scores = np.maximum(pairs.fits, pairs.turned)[:, different]
    at = int(np.searchsorted(pairs.tracks, own))
    taken, in_doubt = assigned(np.where(scores > 0.0, scores, _NEVER), at)
    return _Cluster(pairs, places[pairs.tracks], rows, different, taken, in_doubt)


def _is_between_two(response: Response, scan: Detections, row: int) -> bool:
    """Whether a detection may be the sum of two echoes: two tracks are expected in its cell, or beside."""
    expected = np.asarray(scan.expected)
    near = np.abs(expected[:, 0] - scan.nu_hats[row]) < response.lobe
    near &= np.abs(expected[:, 2] - scan.ranges_km[row]) < NEIGHBOURS * response.range_cell_km
    return int((near & (expected[:, 4] > _LIKELY)).sum()) > 1


def _is_heard_beside(response: Response, scan: Detections, row: int, others: Ints) -> bool:
    """Whether a detection is another look at the echo of one of these, (n,) rows: alike, or no stronger than a leak."""
    nu, range_km = float(scan.nus[row]), float(scan.ranges_km[row])
    near = response.is_one_echo(scan.nus[others], scan.ranges_km[others], (nu, range_km))
    others = others[near & (scan.ranges_km[others] == range_km)]
    sigmas = np.hypot(scan.nu_sigmas[others], scan.nu_sigmas[row])
    is_alike = np.abs(scan.nu_hats[others] - scan.nu_hats[row]) <= _SAME_ECHO * sigmas + 0.5 * response.lobe
    heard = np.abs(scan.alpha_hat[others]) * response.loss(scan.nu_hats[others] - nu)
    is_leak = np.abs(scan.alpha_hat[row]) <= _LOUDEST * heard + _SAME_ECHO * scan.sigma_hat[row]
    is_leak |= np.abs(scan.nus[others] - nu) < response.lobe  # of two echoes that add, any direction may be measured
    is_leak &= scan.statistic[others] >= scan.statistic[row]
    return bool((is_alike | is_leak | (sigmas == 0.0)).any())


@kernel
def _competing(
    own: int, tracks: Floats, seen: Floats, lobe: float, cell_km: float
) -> tuple[Ints, Ints, Floats, Floats, Floats, Floats]:
    """The cluster of a track: the fields of `_Pairs`.

    tracks  : (M, 7 + L) nu, its sigma, range, its sigma, probability of existence, gate, directions of looks; NaN: none
    seen    : (4, n) of detections the direction of the look, range, measured direction, its sigma
    cell_km : width of a range cell
    """
    is_rival, is_theirs = np.zeros(tracks.shape[0], np.bool_), np.zeros(seen.shape[1], np.bool_)
    waiting, n_waiting = np.empty(tracks.shape[0], np.int64), 1
    waiting[0], is_rival[own] = own, True
    while n_waiting > 0:
        n_waiting -= 1
        track = tracks[waiting[n_waiting]]
        for j in range(seen.shape[1]):
            if is_theirs[j] or not _may_be(track, seen[:, j], lobe, cell_km):
                continue
            is_theirs[j] = True
            for i in range(tracks.shape[0]):
                if not is_rival[i] and _may_be(tracks[i], seen[:, j], lobe, cell_km):
                    is_rival[i] = True
                    waiting[n_waiting] = i
                    n_waiting += 1
    rivals, theirs = np.flatnonzero(is_rival), np.flatnonzero(is_theirs)
    fits, turned = np.empty((rivals.size, theirs.size)), np.empty((rivals.size, theirs.size))
    in_cell, in_lobe = np.empty(fits.shape), np.empty(fits.shape)
    for a in range(rivals.size):
        track = tracks[rivals[a]]
        nu, nu_sigma, range_km, range_sigma, existence = track[:5]
        found = existence * P_D
        for b in range(theirs.size):
            detection = seen[:, theirs[b]]
            nu_c, cell, nu_hat, measured = detection
            sigma = np.hypot(nu_sigma, measured if measured > 0.0 else lobe / sqrt(12.0))
            distance_sq = ((nu_hat - nu) / sigma) ** 2
            fits[a, b] = log(2.0 * lobe / (sqrt(2.0 * pi) * sigma * CLUTTER_DENSITY)) - 0.5 * distance_sq
            odds = log(max(found, _TINY) / (1.0 - found))
            fits[a, b] += odds
            in_cell[a, b] = _between(cell - range_km, 0.5 * cell_km, range_sigma)
            fits[a, b] += log(max(in_cell[a, b], _TINY))
            distance_sq += (cell - range_km) ** 2 / (range_sigma**2 + cell_km**2)
            in_lobe[a, b] = _between(nu_c - nu, 0.5 * lobe, nu_sigma)
            # The more the nearer: of detections that are all unexpected the nearest.
            turned[a, b] = (
                MANEUVER_LOG_ODDS * (0.5 + 0.5 / (1.0 + sqrt(distance_sq))) + min(odds, 0.0)
                if _is_own(track, detection)
                else _NEVER
            )
    return rivals, theirs, fits, turned, in_cell, in_lobe


@kernel
def _may_be(track: Floats, detection: Floats, lobe: float, cell_km: float) -> bool:
    """Whether a detection may be of a track at all: about where it was expected, or in a look of its own."""
    in_range = abs(detection[1] - track[2]) < _SIGMAS * track[3] + cell_km
    in_direction = abs(detection[0] - track[0]) < _SIGMAS * track[1] + lobe
    return (in_range and in_direction) or _is_own(track, detection)


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
