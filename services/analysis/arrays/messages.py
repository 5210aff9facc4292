"""Messages and scores of a run as arrays. T dwells, M targets, L bins.

Scans by angle bin, and of each target the row that is about it; waveforms as they were radiated; scores by target, and
of all targets together.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.arrays.tracks import sent_in
from cogradar.shared.protocol.messages import Scan, Truth, Waveform
from cogradar.shared.scoring.scan_rows import ScanRows

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]


class ByBin(NamedTuple):
    """(T, L) each; NaN where a bin was not tested. Steered cells: of several in a bin the largest statistic."""

    statistic: Floats
    sigma_hat: Floats
    alpha_hat: Complexes

    @classmethod
    def of(cls, scans: Iterable[Scan], ks: Sequence[int], n_bin: int) -> Self:
        """Of scans; ks: the dwells of the rows."""
        shape, places = (len(ks), n_bin), {k: i for i, k in enumerate(ks)}
        found = cls(np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, complex(np.nan, np.nan)))
        for scan in scans:
            if (i := places.get(scan.k)) is not None:
                rows = np.argsort(scan.statistic, kind="stable")
                bins = scan.bins[rows]
                found.statistic[i, bins], found.sigma_hat[i, bins] = scan.statistic[rows], scan.sigma_hat[rows]
                found.alpha_hat[i, bins] = scan.alpha_hat[rows]
        return found


class OfTargets(NamedTuple):
    """The row of the largest statistic that holds the target, without truth the one of its track's brightest cell.

    (T, M) each; NaN where no row is about it, or nothing was measured.
    """

    statistic: Floats
    sigma_hat: Floats
    alpha_hat: Complexes
    nu_hat: Floats  # direction, by monopulse
    nu_sigma: Floats  # its standard deviation
    range_km: Floats  # centre of the range cell

    @classmethod
    def of(
        cls, scan_rows: ScanRows, scans: Iterable[Scan], ks: Sequence[int], states: Floats, tracks: Sequence[int | None]
    ) -> Self:
        """Of scans; ks: the dwells of the rows; states: (T, M, 4), NaN where only the `tracks` of targets are known."""
        nothing, places = np.full(states.shape[:2], np.nan), {k: i for i, k in enumerate(ks)}
        found = cls(*(nothing.astype(kind) for kind in (float, float, complex, float, float, float)))
        for scan in scans:
            if (i := places.get(scan.k)) is None or not scan.bins.size:
                continue
            rows = scan_rows.rows_about(vars(scan), states[i], tracks)
            at, is_there = np.maximum(rows, 0), rows >= 0
            found.statistic[i] = np.where(is_there, scan.statistic[at], np.nan)
            found.sigma_hat[i] = np.where(is_there, scan.sigma_hat[at], np.nan)
            found.alpha_hat[i] = np.where(is_there, scan.alpha_hat[at], complex(np.nan, np.nan))
            seen = scan_rows.read(vars(scan))
            is_measured = is_there & (seen.nu_sigmas[at] > 0.0)
            found.nu_hat[i] = np.where(is_measured, seen.nu_hats[at], np.nan)
            found.nu_sigma[i] = np.where(is_measured, seen.nu_sigmas[at], np.nan)
            is_over = is_there & seen.is_over(at) & (seen.ranges_km[at] > 0.0)
            found.range_km[i] = np.where(is_over, seen.ranges_km[at], np.nan)
        return found


def radiated(found: Iterable[Waveform | Truth | Scan], ks: Sequence[int], n_tx: int) -> tuple[Floats, Complexes]:
    """What each dwell k radiated, isotropic power (T,) and factor (T, n_tx, r); NaN where that is not stored."""
    sent = sent_in(found, ks)
    rank = max((waveform.factor.shape[1] for waveform in sent if waveform is not None), default=0)
    factors = np.zeros((len(sent), n_tx, rank), dtype=np.complex128)
    isotropic = np.full(len(sent), np.nan)
    for i, waveform in enumerate(sent):
        if waveform is not None:
            isotropic[i], factors[i, :, : waveform.factor.shape[1]] = waveform.isotropic, waveform.factor
    return isotropic, factors


class Picture(NamedTuple):
    """All tracks and targets together: of each dwell, (T,), and of the run."""

    gospa_km: Floats  # p = 2, alpha = 2, c = 5 km; the squares of the next three add up to its square
    gospa_localisation_km: Floats
    gospa_missed_km: Floats  # of targets without a track
    gospa_false_km: Floats  # of tracks without a target
    ospa_km: Floats  # p = 2, c = 5 km
    # Of the whole run, as `cogradar query picture --json` has them; none before the first dwell.
    figures: dict[str, Any]

    @classmethod
    def of(cls, rows: Sequence[dict[str, Any]], figures: dict[str, Any]) -> Self:
        """Of the rows of the table `picture`."""
        names = ("localisation_km2", "missed_km2", "false_km2", "ospa_km2")
        squares = np.array([[row[name] for row in rows] for name in names], dtype=np.float64)
        localisation, missed, false, ospa = np.sqrt(squares)
        return cls(np.sqrt(squares[:3].sum(axis=0)), localisation, missed, false, ospa, figures)


def by_target(rows: Sequence[dict[str, Any]], n_target: int) -> tuple[Ints, Ints, dict[str, Floats]]:
    """Dwells t and k, (T,), and the columns of `tracks`, (T, M) each; NaN: unknown. No columns without a target."""
    k_of_t = {row["t"]: row["k"] for row in rows}
    places = {t: i for i, t in enumerate(k_of_t)}
    names = [name for name, value in rows[0].items() if not isinstance(value, str | list)] if rows and n_target else []
    columns = {name: np.full((len(places), n_target), np.nan) for name in names}
    for name, column in columns.items():
        for row in rows:
            if row[name] is not None:
                column[places[row["t"]], row["target"] - 1] = row[name]
    return np.array(list(k_of_t), dtype=np.int64), np.array(list(k_of_t.values()), dtype=np.int64), columns
