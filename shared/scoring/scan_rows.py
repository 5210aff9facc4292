"""Which rows of a scan are about a target: the rows of looks that hear it.

Symbols: n rows of the scan, M targets. States of targets are where the array measures them (`array.in_plane`). A scan
is given as the fields of its message, and read as `Detections`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import apart, near_pairs, spatial_frequency
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.response import Response, response_of
from cogradar.shared.signal.scan import Detections

MessageFields = Mapping[str, Any]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


class ScanRows(NamedTuple):
    """How the scans of a radar are read."""

    response: Response
    threshold: float  # of one cell

    @classmethod
    def of(cls, radar: RadarConfig) -> Self:
        """Of a radar."""
        array, receiver = radar.array, radar.receiver
        response = response_of(receiver.cells, array.n_bin, array.n_tx, array.n_rx, receiver.range_cell_km)
        return cls(response, threshold(radar.detector.p_fa))

    def read(self, scan: MessageFields) -> Detections:
        """The rows of a scan."""
        return Detections.of(scan, self.response.n_bin, self.threshold)

    def holds(self, scan: Detections, states: Floats) -> Bools:
        """Whether targets, (M, 4), are heard by the look and in the range cell of each row, (M, n)."""
        return self._holds(scan, states, self._heard(scan, self._echoes_from(states)))

    def best_rows(self, scan: Detections, states: Floats) -> NDArray[np.int64]:
        """The row of the largest statistic that holds each target, (M, 4) -> (M,); -1: none is reported."""
        if scan.nus.size == 0:
            return np.full(len(states), -1)
        found = np.where(self.holds(scan, states), scan.statistic, -1.0)
        rows = found.argmax(axis=1)
        return np.where(found[np.arange(rows.size), rows] < 0.0, -1, rows)

    def rows_about(self, scan: MessageFields, states: Floats, tracks: Sequence[int | None]) -> NDArray[np.int64]:
        """The row that is about each target: of those that hold it, or of its track's brightest look; -1: none.

        states : (M, 4) of the targets, NaN: state unknown, and the track (from 0) is used instead
        """
        found = np.full(len(states), -1, dtype=np.int64)
        is_known = ~np.isnan(states[:, 0])
        found[is_known] = self.best_rows(self.read(scan), states[is_known])
        for m in np.flatnonzero(~is_known).tolist():
            found[m] = -1 if (track := tracks[m]) is None else self.row_of_beam(scan, track)
        return found

    def seen(self, scan: Detections, states: Floats, beams: Sequence[int]) -> tuple[Bools, Floats, Bools]:
        """What a scan says of targets, (M, 4).

        beams    : (M,) row of the beams of each target's track; -1: it has none
        detected : (M,) a row that holds the target is over its limit
        power    : (M,) the largest ||v||^2 that an echo from there met; 0: none
        lit      : (M,) a direction within half a bin of it was lit for its track
        """
        nus, rows = self._echoes_from(states)[:, 0], np.asarray(beams, dtype=np.int64)
        detected, power = np.zeros(nus.size, dtype=np.bool_), np.zeros(nus.size)
        i, j = near_pairs(nus, scan.nus, self.response.lobe)
        heard = self.response.loss(scan.nus[j] - nus[i]) ** 2
        detected[i[self._is_there(scan.ranges_km[j], states[i], heard) & scan.is_over()[j]]] = True
        np.maximum.at(power, i, heard * scan.signature_power[j])
        has_track, lit = rows >= 0, np.zeros(nus.size, dtype=np.bool_)
        own = rows[has_track]
        near = apart(scan.beam_nus[own], nus[has_track, np.newaxis]) <= 0.5 / (self.response.n_bin - 1)
        lit[has_track] = (near & (scan.beams[own] >= 0)).any(axis=-1)
        return detected, power, lit

    def misses_looks(self, scan: Detections, states: Floats) -> Bools:
        """Whether a look that hears a target, (M, 4), was asked for and not measured, at its range at least, (M,)."""
        is_lost = scan.is_lost(np.hypot(states[:, 0], states[:, 2]), self.response.range_cell_km)
        if scan.unmeasured is None:
            return is_lost
        return is_lost | (self.response.loss(scan.unmeasured - self._echoes_from(states)) > 0.0).any(axis=1)

    def row_of_beam(self, scan: MessageFields, track: int) -> int:
        """The row of the largest statistic in the brightest look of a track, counted from 0; -1: none was lit."""
        m, seen = row_of_track(scan, track), self.read(scan)
        if m < 0 or seen.beams[m, 0] < 0:
            return -1
        rows = np.flatnonzero(seen.nus == seen.beam_nus[m, 0])
        return int(rows[seen.statistic[rows].argmax()]) if rows.size else -1

    def _echoes_from(self, states: Floats) -> Floats:
        """Directions that echoes of targets come from, (M, 1)."""
        return self.response.echo_from(spatial_frequency(states))[:, np.newaxis]

    def _heard(self, scan: Detections, nus: Floats) -> Floats:
        """Share of the power of echoes from nus, (M, 1), that each row's look gets in all its ranges: (M, n)."""
        return self.response.loss(scan.nus - nus) ** 2

    def _holds(self, scan: Detections, states: Floats, heard: Floats) -> Bools:
        return self._is_there(scan.ranges_km, states[:, np.newaxis], heard)

    def _is_there(self, ranges_km: Floats, states: Floats, heard: Floats) -> Bools:
        """Whether looks that get this share of an echo's power have the range cell of its target, too; (..., 4)."""
        off = np.abs(ranges_km - np.hypot(states[..., 0], states[..., 2]))
        return np.asarray((heard > 0.0) & (off <= 0.5 * self.response.range_cell_km))

    def beam_is_over(self, scan: MessageFields, track: int) -> bool | None:
        """Whether the brightest look of a track, counted from 0, was over its limit; None: it was not measured."""
        row, seen, m = self.row_of_beam(scan, track), self.read(scan), row_of_track(scan, track)
        if row < 0 <= m and seen.is_unmeasured(m):
            return None
        return row >= 0 and bool(seen.is_over()[row])


def is_blind(scan: MessageFields) -> Bools:
    """Whether each tested cell, (n,), has no estimate of its noise (B <= 0): it detects nothing, whatever is there."""
    return np.asarray(is_tested(scan) & (scan["sigma_hat"] <= 0.0))


def is_tested(scan: MessageFields) -> Bools:
    """Whether something was sent towards each cell, (n,)."""
    return np.asarray(scan["signature_power"] > 0.0)


def radiated_k(k: int, scan: MessageFields, truth: MessageFields | None) -> int:
    """Dwell whose waveform was radiated in dwell k, as its truth or else its scan says: k - 1, or less if it is stale.

    -1 : there was none yet
    """
    said = scan.get("waveform_k") if truth is None else truth["waveform_k"]
    return k - 1 if said is None else int(said)


def tracks_in(fields: MessageFields) -> NDArray[np.integer[Any]]:
    """The tracks of a scan or a waveform, counted from 0, in the order of their rows of beams, gates and shares."""
    roster = fields.get("roster")
    if roster is None:  # announced tracks, which are not sent
        return np.arange(len(fields["beams"]))
    return np.asarray(roster["ids"] if isinstance(roster, Mapping) else roster.ids)


def row_of_track(fields: MessageFields, track: int) -> int:
    """Row of a track, counted from 0, in a scan or a waveform; -1: it was not there."""
    ids = tracks_in(fields)
    row = int(np.searchsorted(ids, track))
    return row if row < ids.size and ids[row] == track else -1
