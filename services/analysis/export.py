"""One run as one table in one file: a row per dwell and target. States are called as everywhere: x, vx, y, vy in km and
km/s, x_hat and so on; other columns have their units in their names.
"""

import csv
import json
import math
import os
from collections.abc import Callable
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from services.analysis.run_arrays import Result
from services.errors import BadInput
from shared.scoring.columns import SHOWN
from shared.signal.array import spatial_frequency

OF_ALL = ("gospa_km", "gospa_localisation_km", "gospa_missed_km", "gospa_false_km", "ospa_km")  # fields of `Picture`
# Columns of the scores that the table has in its own order; further ones come last.
_PLACED = {
    *("run", "k", "t", "target", "track", "true_bin", "bin", "detected", "snr_db", "x", "vx", "y", "vy", "x_hat"),
    *("vx_hat", "y_hat", "vy_hat", "share", "late", "stale", "hit", "best_bin", "outage", "nees", "cells"),
}
FURTHER = tuple(column.name for column in SHOWN if column.name not in _PLACED)
Table = dict[str, NDArray[Any]]  # (T M,) each: of floats, with NaN for what is unknown, of integers or of texts


def table(result: Result) -> Table:
    """The columns of a run, rows in the order of dwell and target.

    Angles are from boresight, nu = 0.5 sin(angle); without _hat they are the target's. `statistic`, `alpha_hat`,
    `sigma_hat` and what else was measured are those of the cell that `detected` is about: one that holds the target,
    without truth that of the track's brightest beam; NaN if none was reported. `hit`: the true bin, or within half a
    bin of it, was lit for the track. `in_bin`: it was the belief's most probable one. `outage`: dwells in a row that
    the track has been out of it. Of a target that is not there true_bin is -1, and its state is NaN. `gospa_km`, its
    parts and `ospa_km` are of all targets together. Without truth, or
    scans in the store, what needs them is left out. Raises BadInput if there is no dwell yet. Of tracks of an unknown
    number: `_by_track`.
    """
    if not result.t.size:
        raise BadInput(f"{result.run}: has no dwell to write yet")
    if result.scenario.radar.is_unknown:
        return _by_track(result)
    shape = result.shares.shape
    of_run = {"run": result.run, "scenario": result.scenario.name, "strategy": result.strategy.value}
    columns: dict[str, Any] = {name: np.full(shape, text) for name, text in of_run.items()}
    columns |= {"seed": np.full(shape, result.seed, dtype=np.int64)}
    columns |= {"t": np.broadcast_to(result.t[:, None], shape), "t_s": np.broadcast_to(result.times_s[:, None], shape)}
    columns |= {"target": np.broadcast_to(np.arange(1, shape[1] + 1), shape)}
    if result.has_truth:
        columns |= _place(result.truth, "") | {"true_bin": result.true_bins, "snr_db": result.snr_db}
    columns |= _place(result.estimates, "_hat") | {"bin": result.bins, "best_bin": result.best_bins}
    columns |= {"detected": result.detections}
    if result.has_scans:
        of_targets = result.measured
        columns |= {"statistic": of_targets.statistic}
        columns |= {"alpha_hat_real": of_targets.alpha_hat.real, "alpha_hat_imag": of_targets.alpha_hat.imag}
        columns |= {"sigma_hat": of_targets.sigma_hat}
        if result.scenario.radar.receiver.monopulse:
            columns |= {"nu_measured": of_targets.nu_hat, "nu_measured_sigma": of_targets.nu_sigma}
        if result.scenario.radar.receiver.range_cell_km:
            columns |= {"range_measured_km": of_targets.range_km}
    columns |= {"share": result.shares, "late": result.late}
    if result.has_truth:
        in_bin = result.present & (result.best_bins == result.true_bins)
        columns |= {"stale": result.stale, "hit": result.hits, "in_bin": in_bin}
        columns |= {"outage": result.outages, "nees": result.nees}
        columns |= {name: np.broadcast_to(getattr(result.picture, name)[:, None], shape) for name in OF_ALL}
    columns |= {name: result.column(name) for name in FURTHER}
    return {name: _flat(values) for name, values in columns.items()}


def _by_track(result: Result) -> Table:
    """A row per dwell and track, the targets that they follow beside them; then one per target without a track.

    `track` is 0 without a track, `target` 0 of a track of none. Without a track `existence` and the estimate are NaN,
    and `detected` is of a cell that holds the target; with one, of a cell that it asked for.
    """
    tracks, present = result.tracks, result.present.copy()
    i, n = np.nonzero(tracks.alive)
    m = tracks.targets[i, n]
    present[i[m > 0], m[m > 0] - 1] = False
    alone, targets = np.nonzero(present)
    rows, of_target = np.concatenate((i, alone)), np.concatenate((m, targets + 1))
    track = np.concatenate((tracks.numbers[n], np.zeros_like(alone)))
    order = np.lexsort((of_target, track, track == 0, rows))
    is_there, at = of_target > 0, np.maximum(of_target - 1, 0)

    def joined(of_tracks: NDArray[Any], missing: float) -> NDArray[Any]:
        found = of_tracks[i, n]
        return np.concatenate((found, np.full((alone.size, *found.shape[1:]), missing)))[order]

    columns = {"run": result.run, "scenario": result.scenario.name, "strategy": result.strategy.value}
    table: dict[str, Any] = {name: np.full(rows.size, text) for name, text in columns.items()}
    table |= {"seed": np.full(rows.size, result.seed), "t": result.t[rows][order], "t_s": result.times_s[rows][order]}
    table |= {"track": track[order], "target": of_target[order]}
    table |= {"confirmed": joined(tracks.confirmed, 0).astype(np.int64), "existence": joined(tracks.existence, np.nan)}
    if result.has_truth:
        truth = np.where(is_there[:, np.newaxis], result.truth[rows, at], np.nan)[order]
        table |= _place(truth, "") | {"snr_db": np.where(is_there, result.snr_db[rows, at], np.nan)[order]}
    table |= _place(joined(tracks.estimates, np.nan), "_hat") | {"share": joined(tracks.shares, 0.0)}
    of_cells = result.detections[rows, at] if result.has_truth else np.zeros(rows.size, dtype=np.bool_)
    table |= {"detected": np.where(track[order] > 0, joined(tracks.detections, 0), of_cells[order]).astype(np.int64)}
    if result.has_truth:
        table |= {name: getattr(result.picture, name)[rows][order] for name in OF_ALL}
    further = {column.name: column.kind.missing for column in SHOWN if column.name in FURTHER and present.shape[1]}
    return table | {
        name: np.where(is_there, result.column(name)[rows, at], missing)[order] for name, missing in further.items()
    }


def write(result: Result, file: Path, form: str | None, *, force: bool = False) -> str:
    """Write a run's table in a format, guessed from the name of the file if None; returns the format.

    The file is there whole or not at all. Raises BadInput if it is there already, unless `force` is given.
    """
    form = form or file.suffix.removeprefix(".").lower()
    if form not in FORMATS:
        raise BadInput(f"{file}: format must be one of {', '.join(FORMATS)}, as its suffix or as --format")
    columns = table(result)
    if file.exists() and not force:
        raise BadInput(f"{file}: is there already; --force replaces it")
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            FORMATS[form](columns, stream)
        part.replace(file)
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return form


def send(result: Result, stream: BinaryIO, form: str | None) -> None:
    """Write a run's table to a stream, which stays open: text only. Raises BadInput."""
    if form not in TEXTS:
        raise BadInput(f"--format {form}: must be {' or '.join(TEXTS)} for --out -, standard output")
    FORMATS[form](table(result), stream)
    stream.flush()


def _place(states: NDArray[np.float64], suffix: str) -> dict[str, Any]:
    """Columns of states [x, vx, y, vy], (T, M, 4)."""
    nu = spatial_frequency(states)
    return {
        f"range{suffix}_km": np.hypot(states[..., 0], states[..., 2]),
        f"angle{suffix}_deg": np.degrees(np.arcsin(np.clip(2.0 * nu, -1.0, 1.0))),
        f"nu{suffix}": nu,
        f"x{suffix}": states[..., 0],
        f"vx{suffix}": states[..., 1],
        f"y{suffix}": states[..., 2],
        f"vy{suffix}": states[..., 3],
    }


def _flat(values: NDArray[Any]) -> NDArray[Any]:
    flat = np.ascontiguousarray(values).reshape(-1)
    return flat.astype(np.int64) if flat.dtype == np.bool_ else flat


def _write_csv(columns: Table, stream: BinaryIO) -> None:
    """Numbers as Python writes them, which come back bit for bit; what is unknown is empty."""
    text = TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*(values.tolist() for values in columns.values()), strict=True):
        writer.writerow(["" if _is_unknown(value) else value for value in row])
    text.detach()  # or it would close the stream


def _is_unknown(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _write_json(columns: Table, stream: BinaryIO) -> None:
    rows = [
        {name: None if _is_unknown(value) else value for name, value in zip(columns, row, strict=True)}
        for row in zip(*(values.tolist() for values in columns.values()), strict=True)
    ]
    stream.write(json.dumps(rows).encode())


def _write_npz(columns: Table, stream: BinaryIO) -> None:
    np.savez_compressed(stream, allow_pickle=False, **columns)


def _write_mat(columns: Table, stream: BinaryIO) -> None:
    """MATLAB's version 5, a column vector per column; texts are rows of characters."""
    from scipy.io import savemat

    savemat(stream, columns, oned_as="column", do_compression=True)  # type: ignore[arg-type] # it takes files, too; its stubs lack them


def _write_parquet(columns: Table, stream: BinaryIO) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise BadInput("parquet needs pyarrow: pip install 'cogradar[parquet]'") from None
    arrays = {name: pyarrow.array(values, from_pandas=True) for name, values in columns.items()}
    pyarrow.parquet.write_table(pyarrow.table(arrays), stream)


FORMATS: dict[str, Callable[[Table, BinaryIO], None]] = {
    "csv": _write_csv,
    "json": _write_json,
    "npz": _write_npz,
    "parquet": _write_parquet,
    "mat": _write_mat,
}
TEXTS = ("csv", "json")  # can be shown, too
