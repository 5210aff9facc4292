"""What each track has of a dwell's detections, and what no track has."""

from typing import NamedTuple

import numpy as np

from cogradar.shared.signal.array import around
from cogradar.shared.signal.looks import NEIGHBOURS
from cogradar.shared.signal.response import Response
from cogradar.shared.signal.scan import Detections, Floats
from cogradar.shared.tracking.assignment.clusters import COMPETES, NEVER, pairs_of, separate
from cogradar.shared.tracking.assignment.echoes import LIKELY, Ints, strongest_of_each, unclaimed_echoes
from cogradar.shared.tracking.assignment.solver import assigned, is_in_doubt
from cogradar.shared.tracking.sensor import heard

UNRESOLVED_ABOVE = 0.1  # probability of being in a cell with another's echo from which on a miss there says nothing


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
        self._labels, self._theirs, self._alone = separate(
            self._places, self._seen, self._order, response.lobe, response.range_cell_km
        )
        self._clusters: dict[int, _Cluster] = {}

    def share(self, own: int) -> Share:
        """What the track in this row of the roster has."""
        if (alone := self._alone[own]) != COMPETES:
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
        competing = self._labels[self._alone == COMPETES]
        for label in np.unique(competing).tolist() if competing.size else ():
            cluster = self._cluster(label)
            claimed[cluster.rows[cluster.different[cluster.taken[cluster.taken >= 0]]]] = True
        columns = (scan.statistic, heard(scan.alpha_hat), scan.sigma_hat)
        seen = np.vstack((self._seen, np.array(columns)[:, over]))
        widths, loss = (self._response.lobe, self._response.range_cell_km), self._response.loss_table()
        return np.asarray(over[unclaimed_echoes(self._order, seen, claimed[over], self._places, widths, loss)])

    def _cluster(self, label: int) -> _Cluster:
        """A cluster of several tracks."""
        if label in self._clusters:
            return self._clusters[label]
        lobe, cell_km = self._response.lobe, self._response.range_cell_km
        tracks, found = np.flatnonzero(self._labels == label), np.flatnonzero(self._theirs == label)
        fits, turned, in_cell, in_lobe = pairs_of(tracks, found, self._places, self._seen, lobe, cell_km)
        rows = self._over[found]
        order = np.argsort(-self._scan.statistic[rows], kind="stable")
        # `take`: columns chosen by an index alone are in Fortran's order, for which a kernel is compiled again.
        different = strongest_of_each(order, np.take(self._seen, found, axis=1), fits, lobe, cell_km)
        scores = np.take(np.maximum(fits, turned), different, axis=1)
        scores = np.where(scores > 0.0, scores, NEVER)
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
    return bool((is_near & (others[:, 4] > LIKELY)).any())
