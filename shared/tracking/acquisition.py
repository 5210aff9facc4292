"""Which bins hold the targets: where they were detected while power went everywhere."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.association import echoes
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import Floats

Ints = NDArray[np.int64]


@dataclass
class _Cell:
    """Detections in one direction and range, the strongest of each echo of each scan."""

    row: int  # which is its bin
    places: list[tuple[int, int]] = field(default_factory=list)  # (scan, row)
    total: float = 0.0  # sum of the statistics,
    most: float = 0.0  # ... and the largest of them


class Candidates:
    """Where targets were detected in an acquisition, scan by scan, each of every cell.

    A target is confirmed by `confirmations` detections over all scans, as long as the statistics of all scans of its
    bin are a detection in sum, too. One between two steered looks echoes in either or both, so that detections in
    neighbouring looks confirm each other. With range cells they must agree in range as well, as false alarms hardly
    ever do; of the largest statistic of many the sum over scans proves nothing. A track is in the bin where its echo is
    strongest, and no two are in one bin. If more targets are confirmed than there are, the strongest are kept: a
    target's statistic is large in each scan, a false alarm's barely above the threshold and small in all other scans.
    """

    def __init__(self, model: TrackerModel, scans: Sequence[Detections] = ()) -> None:
        self._model = model
        self._cells: dict[tuple[float, float], _Cell] = {}  # by direction and range
        self._n_scan, self._sums = 0, np.zeros(model.sensor.n_bin)
        for scan in scans:
            self.add(scan)

    def add(self, scan: Detections) -> None:
        """Take the next scan."""
        for row in echoes(self._model.response, scan, np.flatnonzero(scan.statistic >= scan.limits)).tolist():
            where = float(scan.nus[row]), float(scan.ranges_km[row])
            cell, statistic = self._cells.setdefault(where, _Cell(row)), float(scan.statistic[row])
            cell.places.append((self._n_scan, row))
            cell.total, cell.most = cell.total + statistic, max(cell.most, statistic)
        self._n_scan, self._sums = self._n_scan + 1, self._sums + scan.statistic

    def bins(self) -> Ints | None:
        """Bins of the tracks, ascending, if every target is confirmed; else None."""
        if len(self._cells) < self._model.n_track:
            return None
        picked, n_track = self._confirmed(), self._model.n_track
        return np.sort([cell.row for cell in picked[:n_track]]) if len(picked) >= n_track else None

    def detections_of(self, bin_: int) -> list[tuple[int, int]]:
        """The detections, (scan, row) in their order, of the target of this bin's track."""
        cells = list(self._cells.values())
        own = next(cell for cell in [*self._confirmed(), *cells] if cell.row == bin_)
        mates = self._mates()[cells.index(own)]
        return sorted(place for i in np.flatnonzero(mates) for place in cells[i].places)

    def _confirmed(self) -> list[_Cell]:
        """The cells of confirmed targets, in which each is strongest; the strongest targets first."""
        cells, mates, least = list(self._cells.values()), self._mates(), self._model.acquisition.confirmations
        in_sum = is_detected_in_sum(self._model, self._sums, self._n_scan)
        # A bin is one row of every scan; of steered looks only the detections are surely of one target.
        totals = [self._sums[cell.row] if self._model.response.is_box else cell.total for cell in cells]
        strength = mates @ np.array(totals)
        picked = list[int]()
        order = np.lexsort(
            np.array([[cell.row, -cell.most, -total] for cell, total in zip(cells, strength, strict=True)])
            .reshape(-1, 3)
            .T
        )
        for i in order.tolist():
            own = [cells[j].places for j in np.flatnonzero(mates[i])]
            is_often = max(map(len, own)) >= least or len({k for places in own for k, _ in places}) >= least
            is_new = not mates[i, picked].any() and cells[i].row not in {cells[j].row for j in picked}
            if is_often and in_sum[cells[i].row] and is_new:
                picked.append(i)
        return [cells[i] for i in picked]

    def _mates(self) -> NDArray[np.bool_]:
        """Whether detections in two cells may be of one target, (n, n)."""
        where = np.array(list(self._cells)).reshape(-1, 2)
        return self._model.response.is_one_echo(where[:, 0], where[:, 1], (where[:, :1], where[:, 1:]))


def is_detected_in_sum(model: TrackerModel, sums: Floats, n_scan: NDArray[np.int64] | int) -> NDArray[np.bool_]:
    """Whether a cell's statistics, summed over n_scan scans, are a detection too.

        sum_k Lambda_k ~ chi-square with 2 n_scan degrees of freedom under H0           (non-coherent integration)

    A weak target may take hundreds of scans until it has been detected twice, and in a hundred scans one cell in 20 000
    has two false alarms. The scans in which nothing was detected know the difference: of a target that is detected in
    one scan of fifty the mean statistic is 6, of disturbance 2. (In arrays of few channels it is up to a fifth more, so
    that sums over long acquisitions prove less there.) The first detections of a strong target always suffice.
    """
    return np.asarray(sums >= chdtri(2 * n_scan, model.p_fa))
