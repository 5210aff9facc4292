"""From the data of an array to what a scan reports: all looks of a dwell, range cell by range cell."""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.detector.data_set import DataSet
from cogradar.shared.signal.detector.levels import Levels, range_levels
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured, range_cell_centre, reported

Empty = Callable[[Look, Sequence[int]], Measured]


class LookTable(NamedTuple):
    """The n looks of a dwell as columns, (n,) each."""

    nus: NDArray[np.float64]
    limits: NDArray[np.float64]  # of a detection that is reported beside larger ones
    first: NDArray[np.int64]  # range cells of the gate; NO_RANGE where there are none
    last: NDArray[np.int64]

    @classmethod
    def of(cls, looks: Sequence[Look]) -> Self:
        """Columns of looks. Of looks that are merged only the largest statistic is reported."""
        gates = [(look.cells[0], look.cells[-1]) if look.cells else (NO_RANGE, NO_RANGE) for look in looks]
        first, last = np.array(gates, dtype=np.int64).reshape(-1, 2).T
        limits = np.array([np.inf if look.is_merged else look.limit for look in looks])
        return cls(np.array([look.nu for look in looks]), limits, first, last)

    def of_range_cell(self, range_cell: int) -> NDArray[np.int64]:
        """Which looks test a range cell."""
        return np.flatnonzero((self.first <= range_cell) & (range_cell <= self.last))

    def range_cells(self) -> list[int]:
        """Range cells that some look tests, ascending; NO_RANGE of looks without any."""
        gates = set(zip(self.first.tolist(), self.last.tolist(), strict=True))
        return sorted({cell for first, last in gates for cell in range(first, last + 1)})


def receive(
    looks: Sequence[Look],
    data: Callable[[int], DataSet],
    range_cells: Collection[int],
    width_km: float,
    empty: Empty | None = None,
    others: Sequence[int] = (),
) -> list[Measured]:
    """What is reported of the looks of a dwell, by direction.

    data        : what was received of a range cell; asked for to test, and for directions of detections once more
    range_cells : numbers of those that there are data of; NO_RANGE for looks without range cells
    width_km    : of a range cell; 0: there are none
    empty       : the cell with the largest statistic of a look among those without data, whose others are these; None:
                  nothing is reported of them
    others      : numbers of range cells with data, from which the noise is estimated (`levels`); none: from each
                  data set itself
    """
    table, by_range = LookTable.of(looks), {_centre(cell, width_km): cell for cell in range_cells}
    measured: list[list[Measured]] = [[] for _ in looks]
    loudest, own_limits = np.full(len(looks), -1.0), np.array([look.limit for look in looks])
    noise = _noise(table.nus, data, others)
    for range_km, cell in by_range.items():
        at = table.of_range_cell(cell)
        nus, received = table.nus[at], data(cell)
        cells = received.tests(nus, own_limits[at]) if noise is None else received.tests_beside(nus, noise.of(at))
        # What is neither detected nor the largest of its look so far cannot be reported.
        candidates = (cells.statistic >= table.limits[at]) | (cells.statistic > loudest[at])
        loudest[at] = np.maximum(loudest[at], cells.statistic)
        for j in np.flatnonzero(candidates).tolist():
            look = looks[at[j]]
            measured[at[j]].append(Measured(look, cells.cell(j), range_km, look.nu, 0.0))
    if empty is not None:
        for look, found in zip(looks, measured, strict=True):
            known = [cell for cell in range_cells if cell in look.cells]
            if len(look.cells) > len(known):
                found.append(empty(look, known))
    rows = reported([one for found in measured for one in found], width_km)
    is_located = [one.cell.statistic >= one.look.limit and one.range_km in by_range for one in rows]
    return [
        data(by_range[one.range_km]).located(one) if is_one else one
        for one, is_one in zip(rows, is_located, strict=True)
    ]


def _noise(nus: NDArray[np.float64], data: Callable[[int], DataSet], others: Sequence[int]) -> Levels | None:
    """Levels of looks from the data of other range cells; None: there are none."""
    if not others:
        return None
    found = [data(cell) for cell in others]
    powers, levels = np.array([one.powers(nus) for one in found]), np.array([one.level for one in found])
    return range_levels(powers, levels, found[0].data.size)


def _centre(range_cell: int, width_km: float) -> float:
    """Centre of a range cell; 0: there are none."""
    return 0.0 if range_cell == NO_RANGE else range_cell_centre(range_cell, width_km)
