"""One run as one table: scores by dwell and target or track, or what Python's tables have, row by row.

States are called as everywhere: x, vx, y, vy in km and km/s, x_hat and so on; other columns have their units in their
names.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.arrays.dwell_range import ALL, Dwells, check, is_among
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.arrays.tracks import Tracks
from cogradar.services.analysis.export.meanings import meaning_of
from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.shared.scenario.scenario import SiteSection
from cogradar.shared.scoring.columns import SHOWN
from cogradar.shared.signal.array import spatial_frequency

OF_RUN = ("run", "scenario", "strategy", "seed")  # the first columns, the same in each row
OF_ALL = ("gospa_km", "gospa_localisation_km", "gospa_missed_km", "gospa_false_km", "ospa_km")  # fields of `Picture`
# Columns of the scores that the table has in its own order; further ones come last.
_PLACED = {
    *("run", "k", "t", "target", "track", "true_bin", "bin", "detected", "snr_db", "x", "vx", "y", "vy", "x_hat"),
    *("vx_hat", "y_hat", "vy_hat", "share", "late", "stale", "hit", "best_bin", "outage", "nees", "cells"),
    *("nees_position", "nees_velocity", "acceleration_g", "visible"),
}
FURTHER = tuple(column.name for column in SHOWN if column.name not in _PLACED)
# What a run with announced tracks adds to the rows of its targets.
NO_TRACKS = Tracks.of((), (), (), np.empty((0, 0)))
UNITS = (("_km_s", "km/s"), ("_km2", "km2"), ("_km", "km"), ("_deg", "degree"), ("_db", "dB"), ("_s", "s"))  # by suffix
# By name; in UDUNITS, g would be the gram.
NAMED = {"utc_s": "seconds since 1970-01-01", "acceleration_g": "standard_free_fall"}
STATES = {"x": "km", "y": "km", "z": "km", "vx": "km/s", "vy": "km/s"}
Table = dict[str, NDArray[Any]]  # (n, ...) each: numbers, with NaN for what is unknown, or texts


def unit_of(column: str) -> str | None:
    """Unit of a column, as its name says it; None: it has none, or it is not a physical quantity."""
    if column in NAMED:
        return NAMED[column]
    by_suffix = (unit for suffix, unit in UNITS if column.endswith(suffix))
    return STATES.get(column.removesuffix("_hat")) or next(by_suffix, None)


def attributes_of(column: str) -> dict[str, str]:
    """What a reader of a column is told: what it means, and its unit if it has one."""
    told = {"long_name": meaning_of(column), "units": unit_of(column)}
    return {name: text for name, text in told.items() if text is not None}


class _Rows:
    """Of which dwell, target and track each row is.

    Tracks of an unknown number have a row in each dwell, in the order of their numbers, the targets that they follow
    beside them; then come the targets without a track. Of announced tracks there is a row for each target.
    """

    def __init__(self, result: Result, followed: Tracks) -> None:
        present = result.present | (not result.scenario.radar.is_unknown)
        i, n = np.nonzero(followed.alive)
        m = followed.targets[i, n] - 1
        present[i[m >= 0], m[m >= 0]] = False
        alone, targets = np.nonzero(present)
        dwells, tracks = np.concatenate((i, alone)), np.concatenate((n, np.full_like(alone, -1)))
        order = np.lexsort((np.concatenate((m, targets)), tracks, tracks < 0, dwells))
        self.dwells, self.tracks, self.targets = dwells[order], tracks[order], np.concatenate((m, targets))[order]

    def of(self, of_targets: NDArray[Any], missing: float, of_tracks: NDArray[Any] | None = None) -> NDArray[Any]:
        """What a row says: of (T, M, ...) and (T, N, ...), of its track if it has one and of its target if not."""
        kind = np.int64 if of_targets.dtype == np.bool_ else of_targets.dtype
        found = np.full((self.dwells.size, *of_targets.shape[2:]), missing, dtype=kind)
        for columns, values in ((self.targets, of_targets), (self.tracks, of_tracks)):
            if values is not None:
                found[columns >= 0] = values[self.dwells[columns >= 0], columns[columns >= 0]]
        return found


def scores(result: Result) -> Table:
    """The columns of a run, rows in the order of dwell and target; with an unknown number as of `_Rows`.

    `track` is 0 without a track, `target` 0 of a track of none. Angles are from boresight, nu = 0.5 sin(angle); without
    _hat they are the target's. `statistic`, `alpha_hat`, `sigma_hat` and other measurements are from a cell that holds
    the target, without truth from the track's brightest beam; NaN if none was reported. `detected` is of that cell, or
    of the one that a track of an unknown number asked for. `hit`: the true bin, or within half a bin of it, was lit for
    the track. `in_bin`: it was the belief's most probable one. `outage`: dwells in a row that the track has been out of
    it. Of a target that is not there, or of no target, bins are -1, and states NaN; flags of no target are -1.
    `gospa_km`, its parts and `ospa_km` are of all targets together. With a `[site]` there are latitudes and longitudes;
    there is `utc_s` if it says when the run begins, or the front end says the time. Without truth, or scans in the
    store, what needs them is left out. Raises BadInput if there is no dwell yet.
    """
    if not result.t.size:
        raise BadInput(f"{result.run}: has no dwell to write yet")
    is_unknown, nan = result.scenario.radar.is_unknown, float("nan")
    tracks = result.by_track if is_unknown else NO_TRACKS
    rows = _Rows(result, tracks)
    columns = _of_run(result, rows.dwells.size)
    columns |= {"t": result.t[rows.dwells], "t_s": result.times_s[rows.dwells]}
    if not np.isnan(result.utc_s).all():
        columns |= {"utc_s": result.utc_s[rows.dwells]}
    numbers = np.broadcast_to(tracks.numbers, tracks.alive.shape)
    columns |= {"track": rows.of(result.column("track"), 0, numbers), "target": rows.targets + 1}
    if is_unknown:
        nothing = np.zeros(result.present.shape)
        columns |= {"confirmed": rows.of(nothing, 0, tracks.confirmed).astype(np.int64)}
        columns |= {"existence": rows.of(nothing * nan, nan, tracks.existence)}
    if result.has_truth:
        columns |= _place(rows.of(result.true_states, nan), "", result.scenario.site)
        columns |= {"true_bin": rows.of(result.true_bins, -1), "snr_db": rows.of(result.snr_db, nan)}
    columns |= _place(rows.of(result.estimates, nan, tracks.estimates), "_hat", result.scenario.site)
    columns |= {"bin": rows.of(result.bins, -1), "best_bin": rows.of(result.best_bins, -1)}
    columns |= {"detected": rows.of(result.detected, 0, tracks.detections)}
    if result.has_scans:
        measured = result.measured
        found = {"statistic": measured.statistic, "sigma_hat": measured.sigma_hat}
        found |= {"alpha_hat_real": measured.alpha_hat.real, "alpha_hat_imag": measured.alpha_hat.imag}
        if result.scenario.radar.receiver.monopulse:
            found |= {"nu_measured": measured.nu_hat, "nu_measured_sigma": measured.nu_sigma}
        if result.scenario.radar.receiver.range_cell_km:
            found |= {"range_measured_km": measured.range_km}
        columns |= {name: rows.of(values, nan) for name, values in found.items()}
    columns |= {"share": rows.of(result.shares, 0.0, tracks.shares)}
    columns |= {"late": rows.of(result.late, -1), "stale": rows.of(result.stale, -1)}
    if result.has_truth:
        in_bin = result.present & (result.best_bins == result.true_bins)
        flags = {"hit": result.hits, "in_bin": in_bin, "visible": result.column("visible")}
        columns |= {name: rows.of(values, -1) for name, values in flags.items()}
        columns |= {"outage": rows.of(result.outages, 0)}
        of_belief = ("nees", "nees_position", "nees_velocity")
        columns |= {name: rows.of(result.column(name), nan) for name in (*of_belief, "acceleration_g")}
        columns |= {name: getattr(result.picture, name)[rows.dwells] for name in OF_ALL}
    further = {column.name: column.kind.missing for column in SHOWN if column.name in FURTHER}
    return columns | {name: rows.of(result.column(name), missing) for name, missing in further.items()}


def _table_of(rows: Callable[[Result], Records]) -> Callable[[Result], Table]:
    """A row per row of a table of `Result`, what the run is before them."""

    def found(result: Result) -> Table:
        of_rows = rows(result)
        return _of_run(result, of_rows.size) | {name: np.asarray(of_rows[name]) for name in of_rows.dtype.names or ()}

    return found


def _of_run(result: Result, n_row: int) -> Table:
    names = (result.run, result.scenario.name, result.strategy.value)
    columns = dict(zip(OF_RUN, [*map(np.array, names), np.array(result.seed, dtype=np.int64)], strict=True))
    return {name: np.repeat(value, n_row) for name, value in columns.items()}


TABLES: dict[str, Callable[[Result], Table]] = {
    "scores": scores,
    "tracks": _table_of(Result.tracks),
    "detections": _table_of(Result.detections),
    "looks": _table_of(lambda result: result.detections(all_looks=True)),
    "requests": _table_of(Result.requests),
    "truth": _table_of(Result.truth),
    "waveforms": _table_of(Result.waveforms),
}


def rows_of(result: Result, what: str, dwells: Dwells = ALL) -> Table:
    """A table of TABLES, of dwells t, first and last; None: of the run. Raises BadInput if there is no such dwell."""
    check(result, dwells)
    columns = TABLES[what](result)
    chosen = is_among(columns["t"], dwells)
    return columns if dwells == ALL else {name: values[chosen] for name, values in columns.items()}


def _place(states: NDArray[np.float64], suffix: str, site: SiteSection | None) -> dict[str, Any]:
    """Columns of states [x, vx, y, vy], (n, 4); where that is on the earth, if it is known where the radar is."""
    nu = spatial_frequency(states)
    columns = {
        f"range{suffix}_km": np.hypot(states[..., 0], states[..., 2]),
        f"angle{suffix}_deg": np.degrees(np.arcsin(np.clip(2.0 * nu, -1.0, 1.0))),
        f"nu{suffix}": nu,
        f"x{suffix}": states[..., 0],
        f"vx{suffix}": states[..., 1],
        f"y{suffix}": states[..., 2],
        f"vy{suffix}": states[..., 3],
    }
    if site is None:
        return columns
    found = Place.of(site).positions(states[..., 0], states[..., 2])
    return columns | {f"latitude{suffix}_deg": found.latitudes, f"longitude{suffix}_deg": found.longitudes}
