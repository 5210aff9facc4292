"""Detections as a tracker gets them: the columns of `cogradar export --what detections`, dwell by dwell."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cogradar

Floats = NDArray[np.float64]


class Scan(NamedTuple):
    """The n detections of a dwell, (n,) each."""

    t: int
    nus: Floats  # direction, 0.5 sin(angle)
    nu_sigmas: Floats
    ranges_km: Floats
    range_sigma_km: float  # standard deviation of a place in a range cell


class Followed(NamedTuple):
    """The confirmed tracks of a dwell."""

    ids: list[int]
    states: Floats  # (n, 4) [x, vx, y, vy], km and km/s
    covariances: Floats  # (n, 4, 4)


def scans(columns: Mapping[str, NDArray[Any]], ts: Iterable[int], lobe: float) -> Iterator[Scan]:
    """The detections of each dwell t. Looks that overlap report one echo twice: the strongest of a lobe is kept.

    columns : of the table
    lobe    : width of the main lobe in nu
    """
    nus, ranges = columns["nu_measured"], columns["range_km"]
    if np.isnan(nus).any() or np.isnan(ranges).any():
        raise cogradar.BadInput("a detection has no measured direction, or no range: use fidelity best-range")
    for t in ts:
        at, kept = np.flatnonzero(columns["t"] == t), list[int]()
        for i in at[np.argsort(-columns["statistic"][at], kind="stable")].tolist():
            if not ((np.abs(nus[kept] - nus[i]) < lobe) & (ranges[kept] == ranges[i])).any():
                kept.append(i)
        width = float(columns["range_cell_km"][kept[0]]) if kept else 0.0
        yield Scan(t, nus[kept], columns["nu_measured_sigma"][kept], ranges[kept], width / 12.0**0.5)
