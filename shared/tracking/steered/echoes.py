"""What a scan of steered cells says: its columns, the detections of different echoes, the look that one is.

A target between two cells is over the limit in both: of detections that may be one echo the strongest counts.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from shared.tracking.association import amplitude_of
from shared.tracking.sensor import Detections, Floats
from shared.tracking.steered.looks import Aperture, Looks

Ints = NDArray[np.int64]

NEIGHBOURS = 1.5  # lobes, or range cells, between two cells that may both have the echo of one target


class Columns(NamedTuple):
    """What a scan of steered cells has beside that of bins; shapes and units as there."""

    nus: Floats
    limits: Floats
    ranges_km: Floats
    nu_hats: Floats
    nu_sigmas: Floats
    beam_nus: Floats
    gates: Floats

    @classmethod
    def of(cls, scan: Detections) -> Self:
        """Those of a scan that has them, as every scan of a radar with steered cells."""
        return cls(*(getattr(scan, name) for name in cls._fields))


def is_over(scan: Detections, rows: Ints) -> NDArray[np.bool_]:
    """Whether rows are detections, (n,) -> (n,)."""
    return np.asarray(scan.statistic[rows] >= Columns.of(scan).limits[rows])


def detected_look(aperture: Aperture, scan: Detections, row: int, gate: tuple[float, float]) -> Looks:
    """The look of a detection in a row of the scan."""
    columns = Columns.of(scan)
    nu_hat, nu_sigma, range_km, limit = (
        float(column[row]) for column in (columns.nu_hats, columns.nu_sigmas, columns.ranges_km, columns.limits)
    )
    own = slice(row, row + 1)
    amplitude, sigma = amplitude_of(scan, row), scan.sigma_hat[own].astype(np.float64)
    return Looks(aperture, 0, amplitude, nu_hat, nu_sigma, range_km, columns.nus[own], sigma, limit, *gate)


def echoes(aperture: Aperture, scan: Detections, rows: Ints) -> Ints:
    """Of the rows of detections, (n,), the strongest of each echo, in the order of the scan."""
    columns, found = Columns.of(scan), list[int]()
    if rows.size < 2:
        return rows
    for row in rows[np.argsort(-scan.statistic[rows], kind="stable")].tolist():
        own = float(columns.nus[row]), float(columns.ranges_km[row])
        if not is_one_echo(aperture, columns.nus[found], columns.ranges_km[found], own).any():
            found.append(row)
    return np.sort(np.array(found, dtype=np.int64))


def is_one_echo(
    aperture: Aperture, nus: Floats, ranges_km: Floats, other: tuple[float | Floats, float | Floats]
) -> NDArray[np.bool_]:
    """Whether detections in these directions and range cells, (n,), may be of the target of others, (nu, R)."""
    near = np.abs(nus - other[0]) < NEIGHBOURS * aperture.lobe
    if aperture.range_cell_km > 0.0:
        near &= np.abs(ranges_km - other[1]) < NEIGHBOURS * aperture.range_cell_km
    return np.asarray(near)
