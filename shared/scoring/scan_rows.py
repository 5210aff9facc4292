"""Which rows of a scan are about a target: the cell of its bin, or steered cells that can hear it.

Symbols: n rows of the scan, M targets. A scan is given as the fields of its message.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import angle_bin

MessageFields = Mapping[str, Any]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


class ScanRows(NamedTuple):
    """How the scans of a radar are read."""

    n_bin: int
    n_tx: int
    n_rx: int
    range_cell_km: float  # 0: none
    threshold: float  # of one cell

    @classmethod
    def of(cls, radar: RadarConfig) -> Self:
        """Of a radar."""
        array = radar.array
        from cogradar.shared.signal.receiver import threshold

        return cls(array.n_bin, array.n_tx, array.n_rx, radar.receiver.range_cell_km, threshold(radar.detector.p_fa))

    def limits(self, scan: MessageFields) -> Floats:
        """What each statistic is compared with, (n,)."""
        limits = scan.get("limits")
        return np.full(scan["bins"].size, self.threshold) if limits is None else np.asarray(limits)

    def is_over(self, scan: MessageFields) -> Bools:
        """Whether a row is a detection, (n,)."""
        return np.asarray(scan["statistic"] >= self.limits(scan))

    def heard(self, scan: MessageFields, nus: Floats) -> Floats:
        """Share of the power of echoes from nus, (M,), that each row's cell gets: (M, n).

        Bins: 1 of those in the bin. Steered cells: (D_T D_R)^2 of those in the main lobe, |nu - nu_c| < 1/n_rx.
        """
        if scan.get("nus") is None:
            return np.asarray(angle_bin(nus, self.n_bin)[:, np.newaxis] == scan["bins"], dtype=np.float64)
        d = scan["nus"] - np.asarray(nus)[:, np.newaxis]
        from cogradar.shared.signal.monopulse import off_axis_loss

        loss = off_axis_loss(d, self.n_tx) * off_axis_loss(d, self.n_rx)
        return np.asarray(np.where(np.abs(d) < 1.0 / self.n_rx, loss**2, 0.0))

    def is_in_cell(self, scan: MessageFields, ranges_km: Floats) -> Bools:
        """Whether targets at these ranges, (M,), are in the range cell of each row, (M, n); without any (1, 1)."""
        if not self.range_cell_km:
            return np.ones((1, 1), dtype=np.bool_)
        off = np.abs(scan["ranges_km"] - np.asarray(ranges_km)[:, np.newaxis])
        return np.asarray(off <= 0.5 * self.range_cell_km)

    def holds(self, scan: MessageFields, nus: Floats, ranges_km: Floats) -> Bools:
        """Whether the targets at nus and ranges, (M,) each, are in the main lobe and range cell of each row, (M, n)."""
        return np.asarray((self.heard(scan, nus) > 0.0) & self.is_in_cell(scan, ranges_km))

    def best_rows(self, scan: MessageFields, nus: Floats, ranges_km: Floats) -> NDArray[np.int64]:
        """The row of the largest statistic that holds each target, (M,); -1: none is reported."""
        found = np.where(self.holds(scan, nus, ranges_km), scan["statistic"], -1.0)
        rows = found.argmax(axis=1)
        return np.where(found[np.arange(rows.size), rows] < 0.0, -1, rows)


def beams_on(scan: MessageFields, nus: Floats, n_bin: int) -> Bools:
    """Steered cells: whether a direction within half a bin of each target was lit for each track, (M, tracks)."""
    near = np.abs(scan["beam_nus"] - np.asarray(nus)[:, np.newaxis, np.newaxis]) <= 0.5 / (n_bin - 1)
    return np.asarray((near & (scan["beams"] >= 0)).any(axis=-1))


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


def row_of_beam(scan: MessageFields, track: int) -> int:
    """The row of the largest statistic in the brightest cell lit for a track, counted from 0; -1: none was lit."""
    m = row_of_track(scan, track)
    if m < 0 or scan["beams"][m, 0] < 0:
        return -1
    column, place = ("bins", "beams") if scan.get("nus") is None else ("nus", "beam_nus")
    rows = np.flatnonzero(scan[column] == scan[place][m, 0])
    return int(rows[scan["statistic"][rows].argmax()]) if rows.size else -1
