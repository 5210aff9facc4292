"""Which bins hold the targets of a known number, from scans in which power goes everywhere.

Symbols: k scan; Lambda statistic, r = sqrt(Lambda / 2); u = |alpha| / sigma_hat of an echo, f(r | u) density of r, by
the law of the echoes; a row reports the largest statistic of its n tests.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from math import hypot, inf, log
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics import elementwise
from cogradar.shared.numerics.elementwise import exp, expm1, interpolated, log_sum_exp, modulus, power, times
from cogradar.shared.numerics.linear import inner, product
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import apart, around
from cogradar.shared.signal.echo_laws import LAWS
from cogradar.shared.signal.looks import NEIGHBOURS, directions_everywhere, range_cells
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.association import echoes
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import Floats

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_RANGES = 32  # nodes over the prior of range, where it is not measured
_LOSSES = np.array([math.pow(10.0, -0.05 * db) for db in (0.0, 1.5, 3.0, 4.5, 6.0, 7.5, 9.0)])  # beside look and cell
_CELLS = 3  # range cells that may report one echo, but for the first and the last one
_HYPOTHESES, _SPREADS = 10.0, 6.0  # as many amplitudes, about, share the prior of one; of r, in standard deviations
_QUANTILES, _NODES = 64, 512  # of the largest noise of a row; of a table over ln u from _LEAST to _MOST
_LEAST, _MOST = -6.0, 14.0
_AWAITED = 4  # scans in which a row that was measured in fewer than half of them is waited for
_TINY = 1e-300
_ENDS, _INWARD = np.array([0, -1]), np.array([1.0, -1.0])  # rows, and the sign of nu away from them


class _RangeCells(NamedTuple):
    """What a row of an acquisition is the largest of: looks of a bin, each in every range cell, if there are any."""

    width_km: float  # infinite: one cell has all ranges
    first: int  # number of the first range cell
    n_range: int
    n_look: int  # of a bin

    @classmethod
    def of(cls, low_km: float, high_km: float, width_km: float, n_bin: int) -> Self:
        """Of a radar, by its prior of range."""
        if not 0.0 < width_km < inf:
            return cls(inf, 0, 1, 1)
        cells = range_cells(low_km, high_km, width_km)
        return cls(width_km, cells[0], len(cells), directions_everywhere(n_bin, width_km).size // n_bin)

    @property
    def n_test(self) -> int:
        """Tests of a row, which reports the largest statistic."""
        return self.n_range * self.n_look

    def is_near(self, ranges_km: Floats, reported_km: Floats) -> Mask:
        """Whether the range that a row reports may be a position's: of its range cell or one beside it, (n,)."""
        return np.asarray(np.abs(ranges_km - reported_km) < NEIGHBOURS * self.width_km)

    def n_near(self, ranges_km: Floats) -> Floats:
        """Tests of a row that are near a position, (n,): fewer at the first and the last range cell."""
        if self.n_range == 1:
            return np.full(ranges_km.size, float(self.n_look))
        cell = np.clip(np.floor(ranges_km / self.width_km) - self.first, 0.0, self.n_range - 1.0)
        beside = np.minimum(cell, 1.0) + np.minimum(self.n_range - 1.0 - cell, 1.0)
        return np.asarray(self.n_look * (1.0 + beside))

    def log_empty(self, n_near: Floats) -> Floats:
        """Log probability that noise is largest in none of the tests near a position, so many."""
        return elementwise.log(np.maximum(1.0 - n_near / self.n_test, _TINY))


class _Seen(NamedTuple):
    """What a scan says of its rows."""

    r: Floats  # (n_row,)
    ranges_km: Floats  # (n_row,)
    sigma_hat: Floats  # (n_row,)
    lost_km: Floats | None  # (v,)


class Candidates:
    """How probable a target is in each position, scan by scan: a bin or, with range cells, a bin and a range.

        Lambda_T = sum_h p_h prod_k f(r_k | u_hk) / f(r_k | 0)

    over hypotheses h of the echo's amplitude: one for each range of the prior or, at a measured range, one for each of
    a few straddling losses. Scans below the limit count, too. With range cells a row reports the largest of n tests.
    That is a position's if it is one of m: those in its range cell and the cells beside it. A scan that reports another
    range counts by the probability of that:

        f(r | u) / (m f(r | 0))                there
        (1 - P(u)) / (1 - m / n)               elsewhere,  P(u) probability that the echo exceeds n - 1 tests of noise

    Without a target Lambda_T exceeds 1 / x with probability x, however many scans are made (Ville's inequality). A
    target is confirmed when n_track / n_bin Lambda_T, its odds, exceeds 1 / P_FA. A track is in the bin where its echo
    is strongest; no two are in one bin, or of one echo. Bins at both ends are one direction: the bins beside them tell
    which end it is. If more targets are confirmed than there are, the strongest are kept.
    """

    def __init__(self, model: TrackerModel, scans: Sequence[Detections] = ()) -> None:
        self._model, self._law = model, LAWS[model.sensor.rcs]
        self._cells = _RangeCells.of(*model.acquisition.ranges_km, model.response.range_cell_km, model.sensor.n_bin)
        self._limit = threshold(model.p_fa, self._cells.n_test)
        self._positions = np.zeros((0, 2)), np.zeros(0, dtype=np.int64)  # (n, 2) directions and ranges; (n,) rows
        self._known = set[tuple[int, float]]()  # rows and ranges of the positions
        self._log_ratios = np.zeros((0, self._amplitudes(np.zeros(0)).shape[1]))  # (n, n_hypothesis)
        self._totals = np.zeros(0)  # (n,) sums of the statistics of a position
        self._seen = list[_Seen]()
        self._measured = np.zeros(model.sensor.n_bin, dtype=np.int64)  # scans in which a row was
        # Of both ends: sum over scans of alpha_hat beside the end times the conjugate of that at the end.
        self._beside = np.zeros(2, dtype=np.complex128)
        self._inward = np.zeros(2)  # of both ends: how far from it echoes were measured, over the variance
        for scan in scans:
            self.add(scan)

    def add(self, scan: Detections) -> None:
        """Take the next scan."""
        scale = np.divide(self._limit, scan.limits, out=np.ones(scan.limits.size), where=scan.limits > 0.0)
        self._seen.append(_Seen(np.sqrt(0.5 * scan.statistic * scale), scan.ranges_km, scan.sigma_hat, scan.lost_km))
        where, rows = self._positions
        self._log_ratios += self._ratios(where[:, 1], rows, self._seen[-1])
        self._begin(scan)
        self._measured += np.isfinite(scan.limits)
        where, rows = self._positions
        is_own = self._cells.is_near(where[:, 1], scan.ranges_km[rows])
        self._totals += np.where(is_own, scan.statistic[rows], 0.0)
        self._beside += times(scan.alpha_hat[[1, -2]], scan.alpha_hat[[0, -1]].conj())
        off, sigma = around(scan.nu_hats[_ENDS] - scan.nus[_ENDS]), scan.nu_sigmas[_ENDS]
        self._inward += np.divide(off * _INWARD, sigma**2, out=np.zeros(2), where=sigma > 0.0)

    def found(self) -> list[tuple[int, float]] | None:
        """Bin and range in km of each track, by bin, if every target is confirmed; else None. Range 0: not measured."""
        picked, n_track = self._confirmed(), self._model.n_track
        return sorted(picked[:n_track]) if len(picked) >= n_track else None

    @property
    def n_confirmed(self) -> int:
        """Targets that are confirmed, no more than there are."""
        return min(len(self._confirmed()), self._model.n_track)

    def bins(self) -> Ints | None:
        """Bins of the tracks, ascending, if every target is confirmed; else None."""
        found = self.found()
        return None if found is None else np.array([bin_ for bin_, _ in found])

    @property
    def log_odds(self) -> Floats:
        """Log odds that there is a target in each position, (n,)."""
        n_hypothesis = self._log_ratios.shape[1] * self._cells.n_range
        share = self._model.n_track / self._model.sensor.n_bin / n_hypothesis
        return np.asarray(log_sum_exp(self._log_ratios) + log(share))

    def _begin(self, scan: Detections) -> None:
        """Positions that a scan is the first to report, as far as it speaks for a target there."""
        ranges_km = scan.ranges_km
        ranges = ranges_km.tolist()
        new = np.array([i for i, at in enumerate(ranges) if (i, at) not in self._known], dtype=np.int64)
        if self._cells.n_range > 1:
            new = new[(self._ratios(ranges_km[new], new, self._seen[-1]) > 0.0).any(axis=1)]
        if new.size == 0:
            return
        begun = sum(self._ratios(ranges_km[new], new, seen) for seen in self._seen)
        totals = sum(
            np.where(self._cells.is_near(ranges_km[new], one.ranges_km[new]), 2.0 * one.r[new] ** 2, 0.0)
            for one in self._seen[:-1]
        )
        self._known |= {(i, ranges[i]) for i in new.tolist()}
        where, rows = self._positions
        there = np.stack((scan.nus[new], ranges_km[new]), axis=-1)
        self._positions = np.concatenate((where, there)), np.concatenate((rows, new))
        self._log_ratios = np.concatenate((self._log_ratios, begun))
        self._totals = np.concatenate((self._totals, totals + np.zeros(new.size)))

    def _ratios(self, ranges_km: Floats, rows: Ints, seen: _Seen) -> Floats:
        """Log likelihood ratios of a scan for positions at ranges in rows, (n,) each -> (n, n_hypothesis)."""
        r, reported_km, sigma = (column[rows] for column in seen[:3])
        amplitudes, cells = self._amplitudes(ranges_km), self._cells
        used = sigma[:, np.newaxis] > 0.0  # else nothing is known of the noise
        if seen.lost_km is not None:  # nor of the echo
            used &= ~cells.is_near(ranges_km[:, np.newaxis], seen.lost_km).any(axis=1, keepdims=True)
        u = np.divide(amplitudes, sigma[:, np.newaxis], out=np.zeros(amplitudes.shape), where=used)
        near, r = cells.n_near(ranges_km)[:, np.newaxis], r[:, np.newaxis]
        there = self._law.log_likelihood(r, u) + r**2 - elementwise.log(near)
        if cells.n_range > 1:
            is_own = cells.is_near(ranges_km, reported_km)[:, np.newaxis]
            elsewhere = _log_missed(self._model.sensor.rcs, cells.n_test, u) - cells.log_empty(near)
            there = np.where(is_own, there, elsewhere)
        return np.asarray(np.where(used, there, 0.0))

    def _confirmed(self) -> list[tuple[int, float]]:
        """Rows and ranges of confirmed targets, in which each is strongest; the strongest targets first."""
        model, n_scan = self._model, len(self._seen)
        if n_scan < _AWAITED and (2 * self._measured < n_scan).any():  # there may be the stronger echo of a target
            return []
        sure = np.flatnonzero(self.log_odds >= -log(model.p_fa))
        where, rows = self._positions[0][sure], self._positions[1][sure]
        mates = model.response.is_one_echo(where[:, 0], where[:, 1], (where[:, :1], where[:, 1:]))
        is_other_end = mates & (np.abs(where[:, :1] - where[:, 0]) > 0.5)
        totals = self._totals[sure] * (n_scan / np.maximum(self._measured[rows], 1))  # rows may lack other scans
        strength = totals + product(is_other_end.astype(np.float64), totals)
        which_end = (
            totals  # with range cells: looks beside the bins' centres, which at both ends are not of one direction
        )
        if not model.response.measures_range:
            which_end = np.array([self._at_end(row) for row in rows.tolist()])
        picked = list[int]()
        for i in np.lexsort((rows, -which_end, -strength)).tolist():
            if not mates[i, picked].any() and rows[i] not in rows[picked]:
                picked.append(i)
        return [(int(rows[i]), float(where[i, 1])) for i in picked]

    def _at_end(self, row: int) -> float:
        """How much speaks for the end of an end's bin and not for the other end, 0 of any other bin.

        A target near an end is in the bins at both, and off their direction: measured directions are on its side.
        Where none are, its echo is in the bin beside with the same phase in each scan; disturbance and other targets
        are not.
        """
        last = self._model.sensor.n_bin - 1
        if row not in {0, last}:
            return 0.0
        end = int(row == last)
        return float(self._inward[end]) if self._inward.any() else float(modulus(self._beside[end]))

    def _amplitudes(self, ranges_km: Floats) -> Floats:
        """|alpha| of the hypotheses at measured ranges, (n,) -> (n, n_hypothesis); 0: not measured."""
        at_1_km, prior = amplitude_at_1_km(self._model.sensor.amplitude_db), self._model.acquisition.ranges_km
        if self._model.response.measures_range and self._law.tells_range:
            return np.asarray(amplitude(at_1_km, np.maximum(ranges_km, 1e-3) ** 2)[:, np.newaxis] * _LOSSES)
        nodes = prior[0] + (np.arange(_RANGES) + 0.5) / _RANGES * (prior[1] - prior[0])
        return np.broadcast_to(amplitude(at_1_km, nodes**2), (ranges_km.size, _RANGES))


def detections_of(
    model: TrackerModel, scans: Sequence[Detections], bin_: int, range_km: float
) -> list[tuple[int, int]]:
    """The detections of the target of this bin's track, (scan, row) in their order; one at least.

    Of a target that was confirmed without one, the scan with the largest statistic of its bin stands for it.

    range_km : where it was confirmed; 0: ranges are not measured
    """
    cells = _RangeCells.of(*model.acquisition.ranges_km, model.response.range_cell_km, model.sensor.n_bin)
    statistic, ranges_km = (np.array([getattr(scan, of)[bin_] for scan in scans]) for of in ("statistic", "ranges_km"))
    is_near = cells.is_near(ranges_km, np.full(ranges_km.size, range_km))
    best = int(np.argmax(np.where(is_near, statistic, -1.0)))
    there = float(scans[best].nus[bin_]), range_km
    places = list[tuple[int, int]]()
    for k, scan in enumerate(scans):
        rows = echoes(model.response, scan, np.flatnonzero(scan.is_over()))
        is_own = model.response.is_one_echo(scan.nus[rows], scan.ranges_km[rows], there)
        is_own &= apart(scan.nus[rows], there[0]) == np.abs(scan.nus[rows] - there[0])  # not at the other end
        places += [(k, row) for row in rows[is_own].tolist()]
    return places or [(best, bin_)]


def expected_scans(radar: RadarConfig, u: float) -> float:
    """Scans until a target is confirmed, about: what its odds take, over what a scan adds to their logarithm.

    u : |alpha| / sigma_hat of its echo in its bin
    """
    law, width_km = LAWS[radar.assumes.rcs], radar.receiver.range_cell_km
    cells = _RangeCells.of(*radar.acquisition.ranges_km, width_km, radar.array.n_bin)
    near = min(_CELLS, cells.n_range) * cells.n_look
    low, high = (0.0, _SPREADS * hypot(1.0, u)) if law.fluctuates else (max(u - _SPREADS, 0.0), u + _SPREADS)
    r, step = np.linspace(low, high, _NODES, retstep=True)
    r = r + 0.5 * step
    ratio = law.log_likelihood(r, np.array(u)) + r**2
    found = 2.0 * r * exp(ratio - r**2) * power(-expm1(-(r**2)), cells.n_test - 1.0) * step
    adds = inner(found, ratio - log(near))
    if cells.n_range > 1:
        elsewhere = _log_missed(radar.assumes.rcs, cells.n_test, np.array(u)) - cells.log_empty(np.array(near))
        adds += max(1.0 - float(found.sum()), 0.0) * float(elsewhere)
    odds = radar.array.n_bin * cells.n_range / max(radar.announced, 1) / radar.detector.p_fa * _HYPOTHESES
    return max(log(odds) / adds, 1.0) if adds > 0.0 else inf


def _log_missed(rcs: str, n_test: int, u: Floats) -> Floats:
    """log(1 - P(u)), P(u) probability that an echo exceeds the largest of n_test - 1 tests of noise; (...) -> (...)."""
    table = _missed_table(rcs, n_test)
    return np.asarray(interpolated(elementwise.log(np.maximum(u, _TINY)), np.linspace(_LEAST, _MOST, _NODES), table))


@lru_cache(maxsize=8)
def _missed_table(rcs: str, n_test: int) -> Floats:
    """log(1 - P(u)) at equal steps of ln u, the mean over quantiles of the largest noise; (_NODES,)."""
    u, law = exp(np.linspace(_LEAST, _MOST, _NODES)), LAWS[rcs]
    shares = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    largest = np.sqrt(-elementwise.log(-expm1(elementwise.log(shares) / (n_test - 1))))
    missed = np.mean([exp(law.log_band(0.0, float(r), u)) for r in largest], axis=0)
    return np.asarray(elementwise.log(np.maximum(missed, _TINY)))
