"""Every detection of a run: the tested cells whose statistic is over its limit, in columns of one length."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.messages import ABSENT, Scan, Truth
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.response import strongest_of_each
from cogradar.shared.signal.scan import Detections

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class DetectedCells(NamedTuple):
    """The n detections of a run, (n,) each, in the order of dwell and direction.

    A look that tests several range cells reports those with a target and the loudest other one. So a simulated look
    has no more than one false alarm. A target between two looks, or two range cells, is over the limit in both.
    """

    k: Ints  # dwell, of all
    t: Ints  # dwell, after the acquisition; 0 during it, when targets stand still
    nu: Floats  # direction of the look, 0.5 sin(angle)
    nu_measured: Floats  # direction of the echo, by monopulse; NaN if it was not measured, as the next one
    nu_measured_sigma: Floats  # its standard deviation
    range_km: Floats  # centre of the range cell; NaN without range cells
    statistic: Floats  # Wald-type statistic Lambda
    limit: Floats  # that it is over
    alpha_hat: NDArray[np.complex128]  # estimated echo amplitude
    sigma_hat: Floats  # its estimated standard deviation
    signature_power: Floats  # ||v||^2 of what was radiated in this direction
    strongest: Ints  # 1 of the strongest of the rows that may be one echo, as trackers take it; 0 of the others
    target: Ints  # target in the cell, from 1; 0: none, a false alarm, or without truth

    @classmethod
    def of(cls, scan_rows: ScanRows, scans: Iterable[Scan], truths: Mapping[int, Truth]) -> Self:
        """Of scans; truths: by dwell k, where the truth is known."""
        parts = [_over(scan_rows, scan, truths.get(scan.k)) for scan in scans]
        kinds = (np.int64, np.int64, *(6 * [np.float64]), np.complex128, np.float64, np.float64, np.int64, np.int64)
        columns = zip(*parts, strict=True) if parts else [[] for _ in kinds]
        return cls(*(np.concatenate([[], *column]).astype(kind) for column, kind in zip(columns, kinds, strict=True)))

    @property
    def p_fa(self) -> Floats:
        """Probability that a cell with nothing but disturbance is over this limit: exp(-limit / 2)."""
        return np.asarray(np.exp(-0.5 * self.limit))


def _over(scan_rows: ScanRows, scan: Scan, truth: Truth | None) -> tuple[NDArray[np.generic], ...]:
    """The columns of `DetectedCells` of one scan."""
    seen = scan_rows.read(vars(scan))
    at = np.flatnonzero(seen.is_over())
    strongest = np.zeros(at.size, dtype=np.int64)
    strongest[strongest_of_each(scan_rows.response, seen.statistic[at], seen.nus[at], seen.ranges_km[at])] = 1
    is_measured, has_range = seen.nu_sigmas[at] > 0.0, seen.ranges_km[at] > 0.0
    return (
        np.full(at.size, scan.k),
        np.full(at.size, scan.t),
        seen.nus[at],
        np.where(is_measured, seen.nu_hats[at], np.nan),
        np.where(is_measured, seen.nu_sigmas[at], np.nan),
        np.where(has_range, seen.ranges_km[at], np.nan),
        seen.statistic[at],
        seen.limits[at],
        seen.alpha_hat[at],
        seen.sigma_hat[at],
        seen.signature_power[at],
        strongest,
        np.zeros(at.size) if truth is None else _held(scan_rows, seen, truth)[at],
    )


def _held(scan_rows: ScanRows, seen: Detections, truth: Truth) -> Ints:
    """The target that each row of a scan holds, from 1; 0: none."""
    there = np.flatnonzero(truth.bins != ABSENT)
    found = np.zeros(seen.statistic.size, dtype=np.int64)
    for target, is_held in zip(
        there[::-1].tolist(), scan_rows.holds(seen, truth.measured_states[there[::-1]]), strict=True
    ):
        found[is_held] = target + 1
    return found
