"""One run in every format: other people's programs read the files, and all of them find the same numbers."""

import json
import shutil
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from mcap.reader import make_reader
from scipy.io import loadmat
from typer.testing import CliRunner

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export import formats
from cogradar.services.analysis.export.formats import FORMATS, TEXTS, Format
from cogradar.services.analysis.export.table_writers import write_netcdf
from cogradar.services.analysis.export.tables import FURTHER, OF_ALL, OF_RUN, TABLES, Table, attributes_of, scores
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.app import app
from cogradar.services.emulator.front_end import ScanData, Transmission
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.skies.place import Place
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.stored import answered
from tests.services.stored import result as result_of

DWELLS, TARGETS = 12, 2
Columns = dict[str, list[Any]]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("store") / "runs.db")
    store = Store(Journal(path))
    in_process.play(RunStart.of(load("smoke"), Strategy.POWER_AWARE, 2**63 - 1, DWELLS), store=store)
    store.close()
    return path


def _exported(file: str, out: Path, *options: str) -> str:
    done = CliRunner().invoke(app, ["export", "--store", file, "--out", str(out), *options])
    assert done.exit_code == 0, done.output
    return done.output


def _csv(path: Path) -> Columns:
    frame = pd.read_csv(path)
    return {str(name): frame[name].tolist() for name in frame}


def _json(path: Path) -> Columns:
    rows = json.loads(path.read_text())
    return {name: [np.nan if row[name] is None else row[name] for row in rows] for name in rows[0]}


def _npz(path: Path) -> Columns:
    with np.load(path, allow_pickle=False) as loaded:
        return {name: loaded[name].tolist() for name in loaded}


def _parquet(path: Path) -> Columns:
    rows = duckdb.read_parquet(str(path))
    values = zip(*rows.fetchall(), strict=True)
    return {
        name: [np.nan if value is None else value for value in column]
        for name, column in zip(rows.columns, values, strict=True)
    }


def _mat(path: Path) -> Columns:
    loaded = loadmat(path, appendmat=False)
    return {name: np.ravel(loaded[name]).tolist() for name in loaded if not name.startswith("__")}


def _netcdf(path: Path) -> Columns:
    with xr.open_dataset(path) as loaded:
        assert loaded["x_hat"].attrs == {"units": "km", "long_name": "position along boresight, of the estimate"}
        of_run = {name: [loaded.attrs[name]] * loaded.sizes["row"] for name in OF_RUN}
        return of_run | {str(name): loaded[name].to_numpy().tolist() for name in loaded}


READERS = {"csv": _csv, "json": _json, "npz": _npz, "parquet": _parquet, "mat": _mat, "nc": _netcdf}


@pytest.mark.parametrize("form", READERS)
def test_every_format_holds_the_run_bit_for_bit(form: str, file: str, tmp_path: Path) -> None:
    result, path = result_of(file), tmp_path / f"run.{form}"
    assert result.run in _exported(file, path)
    expected = {name: values.tolist() for name, values in scores(result).items()}
    found = READERS[form](path)
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert len(values) == DWELLS * TARGETS
        if isinstance(values[0], str):
            assert found[name] == values
        else:
            assert np.array_equal(found[name], values, equal_nan=True), name
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]  # nothing is left beside it


def test_rows_say_what_the_arrays_say(file: str) -> None:
    result = result_of(file)
    columns = scores(result)
    assert not [name for name in columns if "latitude" in name or "utc" in name]  # without a site
    assert columns["t"].tolist() == [t for t in range(1, DWELLS + 1) for _ in range(TARGETS)]
    assert columns["t_s"].tolist() == [t * 1.0 for t in columns["t"]]
    assert columns["target"].tolist() == DWELLS * [1, 2]
    assert columns["seed"].tolist() == DWELLS * TARGETS * [2**63 - 1]
    at = 5 * TARGETS + 1  # dwell 6, target 2
    x, _, y, _ = result.true_states[5, 1]
    assert columns["range_km"][at] == pytest.approx(np.hypot(x, y))
    assert columns["angle_deg"][at] == pytest.approx(np.degrees(np.arctan2(y, x)))
    assert columns["nu"][at] == pytest.approx(0.5 * np.sin(np.arctan2(y, x)))
    assert columns["x_hat"][at] == result.estimates[5, 1, 0]
    cell = result.true_bins[5, 1]
    amplitude = columns["alpha_hat_real"][at] + 1j * columns["alpha_hat_imag"][at]
    assert np.array_equal(amplitude, result.alpha_hat[5, cell], equal_nan=True)
    assert np.array_equal(columns["statistic"][at], result.statistics[5, cell], equal_nan=True)
    assert columns["detected"].sum() == result.detected.sum()
    rows = answered(file, "tracks", run=result.run)
    assert columns["hit"].tolist() == [row["hit"] for row in rows]
    assert columns["in_bin"].tolist() == [int(row["best_bin"] == row["true_bin"]) for row in rows]
    assert columns["outage"].tolist() == [row["outage"] for row in rows]
    (picture,) = answered(file, "picture", run=result.run)
    for name in OF_ALL:
        of_dwells = columns[name][::TARGETS]
        assert np.array_equal(columns[name], np.repeat(of_dwells, TARGETS))
        assert np.sqrt(np.mean(of_dwells**2)) == pytest.approx(picture[name], rel=1e-12)
    assert result.picture.figures == picture


SITE = [
    "site.latitude_deg=48.0",
    "site.longitude_deg=11.0",
    "site.boresight_deg=90",
    'site.begin_utc="2026-01-01T00:00:00Z"',
]


@pytest.mark.parametrize("site", [[], SITE])
def test_the_time_of_a_dwell_is_the_front_ends_where_it_says_one(
    site: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, transmit = str(tmp_path / "runs.db"), SimulatedFrontEnd.transmit

    def timed(self: SimulatedFrontEnd, k: int, t: int, asked: Transmission) -> ScanData:
        return replace(transmit(self, k, t, asked), utc_s=None if t == 2 else 1e9 + t)

    monkeypatch.setattr(SimulatedFrontEnd, "transmit", timed)
    store = Store(Journal(path))
    in_process.play(RunStart.of(load("smoke", site), Strategy.POWER_AWARE, 1, 3), store=store)
    store.close()
    found = scores(result_of(path))["utc_s"]
    assert np.array_equal(found, [1e9 + 1, 1e9 + 1, np.nan, np.nan, 1e9 + 3, 1e9 + 3], equal_nan=True)


def test_with_a_site_rows_say_where_on_the_earth_and_when(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    store = Store(Journal(path))
    in_process.play(RunStart.of(load("smoke", SITE), Strategy.POWER_AWARE, 1, 3), store=store)
    store.close()
    columns = scores(result_of(path))
    assert columns["utc_s"].tolist() == [1767225600.0 + t for t in (1, 1, 2, 2, 3, 3)]
    place = Place(48.0, 11.0, 90.0)
    for suffix in ("", "_hat"):
        at = columns[f"latitude{suffix}_deg"][0], columns[f"longitude{suffix}_deg"][0]
        assert place.seen(*at) == pytest.approx((columns[f"x{suffix}"][0], columns[f"y{suffix}"][0]), abs=1e-6)


def test_of_a_campaigns_run_there_is_what_its_store_has(file: str, tmp_path: Path) -> None:
    with closing(Store(Journal(file, read_only=True))) as store:
        recording = take(store, result_of(file).run)
    assert recording is not None
    kept = in_memory()
    kept.journal.add_recording(recording, 1)
    columns = scores(Result(StoredRun(partial(answer, kept))))
    whole = scores(result_of(file))
    assert set(whole) - set(columns) == {"statistic", "alpha_hat_real", "alpha_hat_imag", "sigma_hat"}
    assert all(np.array_equal(values, whole[name]) for name, values in columns.items())
    with pytest.raises(BadInput, match="no scan is stored"):
        formats.write(Result(StoredRun(partial(answer, kept))), tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_without_truth_what_needs_it_is_left_out(file: str) -> None:
    blind, name = in_memory(), result_of(file).run
    scenario = load("smoke").model_copy(update={"world": None})
    start = RunStart.of(scenario, Strategy.POWER_AWARE, 2**63 - 1, DWELLS)
    in_process.play(start, store=blind, front_end=f"recorded:{file}#{name}")
    columns = scores(Result(StoredRun(partial(answer, blind))))
    assert {"x", "range_km", "snr_db", "true_bin", "hit", "in_bin", "outage", "gospa_km"} & set(columns) == set()
    assert {"x_hat", "angle_hat_deg", "statistic", "late", "stale"} <= set(columns)
    assert columns["statistic"].min() >= 0.0  # that of the cell asked for is always there


def test_a_track_that_was_dark_has_no_numbers_of_another_cell(tmp_path: Path) -> None:
    path = str(tmp_path / "seen.db")
    seen, blind = Store(Journal(path)), in_memory()
    words = ["radar.planner.looks=joint", "radar.allocation.objective=urgency", "radar.echo.amplitude_db=57"]
    scenario = load("smoke", words)
    done = in_process.play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, DWELLS), store=seen)
    seen.close()
    start = RunStart.of(scenario.model_copy(update={"world": None}), Strategy.POWER_AWARE, 1, DWELLS)
    in_process.play(start, store=blind, front_end=f"recorded:{path}#{done.run['run']}")
    columns = scores(Result(StoredRun(partial(answer, blind))))
    is_dark = columns["bin"] < 0
    assert 0 < is_dark.sum() < is_dark.size
    for name in ("statistic", "alpha_hat_real", "alpha_hat_imag", "sigma_hat"):
        assert np.array_equal(np.isnan(columns[name]), is_dark), name


def test_a_file_is_replaced_only_on_request_and_written_whole_or_not_at_all(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.csv"
    path.write_text("mine")
    refused = CliRunner().invoke(app, ["export", "--store", file, "--out", str(path)])
    assert (refused.exit_code, path.read_text()) == (2, "mine")
    assert "--force" in refused.stderr

    def full_disk(*_: object) -> str:
        (tmp_path / ".run.csv").touch()
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setitem(FORMATS, "csv", Format(("scores",), full_disk))
        with pytest.raises(BadInput, match=r"run\.csv: No space left on device"):
            formats.write(result_of(file), path, None, force=True)
    assert path.read_text() == "mine"
    _exported(file, path, "--force")
    assert path.read_text().startswith("run,scenario,")
    _exported(file, tmp_path / "run.txt", "--format", "csv")
    assert (tmp_path / "run.txt").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("form", TEXTS)
def test_text_goes_to_standard_output_on_request(form: str, file: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{form}"
    _exported(file, path)
    done = CliRunner().invoke(app, ["export", "--store", file, "--out", "-", "--format", form])
    assert (done.exit_code, done.stdout) == (0, path.read_text())
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


ANY = (["--out", "x.csv"], ["--out", "-", "--format", "csv"], ["--out", "x.mcap"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--out", "x.xlsx"], "must be one of csv, json, npz, parquet, mat, nc, mcap, rrd, gif"),
        (["nobody", "--out", "x.csv"], "run = 'nobody': no such run"),
        (["--out", "-", "--format", "mat"], "--format mat: must be csv or json for --out -, standard output"),
        (["--out", "-"], "must be csv or json for --out -"),
        (["--out", "x.mcap", "--what", "scores"], "--what scores: mcap files hold run; use --format csv, json"),
        (["--out", "x.csv", "--what", "clip"], "--what clip: csv files hold scores"),
        *(([*to, "--dwells", "13:"], "has no such dwell; there are 1 to 12") for to in ANY),
        *(([*to, "--rate", "5"], "--rate 5: has no effect on") for to in ANY),
    ],
)
def test_what_cannot_be_written_is_bad_input(options: list[str], words: str, file: str, tmp_path: Path) -> None:
    options = [str(tmp_path / option) if "x." in option else option for option in options]
    done = CliRunner().invoke(app, ["export", "--store", file, *options])
    assert done.exit_code == 2
    assert words in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_help_says_what_can_be_written() -> None:
    said = set(CliRunner().invoke(app, ["export", "--help"]).stdout.replace(":", ",").replace(",", " ").split())
    assert said >= set(formats.CONTENTS)


def test_a_run_that_has_not_begun_to_track_has_nothing_to_write(tmp_path: Path) -> None:
    begun = in_memory()
    begun.journal.add_run(RunStart.of(load("smoke"), Strategy.UNIFORM, 1, 5))
    with pytest.raises(BadInput, match="has no dwell to write yet"):
        formats.write(Result(StoredRun(partial(answer, begun))), tmp_path / "run.csv", None)


@pytest.mark.parametrize(
    ("form", "module", "extra"),
    [
        ("parquet", "pyarrow", "parquet"),
        ("nc", "netCDF4", "netcdf"),
        ("mcap", "mcap.writer", "mcap"),
        ("rrd", "rerun", "rerun"),
    ],
)
def test_without_its_library_a_format_says_what_to_install(
    form: str, module: str, extra: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    done = CliRunner().invoke(app, ["export", "--store", file, "--out", str(tmp_path / f"run.{form}")])
    assert done.exit_code == 2
    assert f"pip install 'cogradar[{extra}]'" in done.stderr.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", TABLES)
def test_every_table_can_be_written_whole_and_in_columns(what: str, file: str, tmp_path: Path) -> None:
    result, csv, npz = result_of(file), tmp_path / "run.csv", tmp_path / "run.npz"
    expected = TABLES[what](result)
    assert f"{len(expected['run'])} rows of {what}" in _exported(file, csv, "--what", what)
    _exported(file, npz, "--what", what)
    with np.load(npz, allow_pickle=False) as loaded:
        assert list(loaded) == list(expected)
        for name, values in expected.items():
            assert np.array_equal(loaded[name], values, equal_nan=values.dtype.kind in "fc"), name
    n_column = sum(values[0].size * (2 if values.dtype.kind == "c" else 1) for values in expected.values())
    assert len(_csv(csv)) == n_column


def test_matrices_and_complex_numbers_are_whole_where_a_format_has_them(file: str, tmp_path: Path) -> None:
    result = result_of(file)
    covariance, factor = result.tracks()["covariance"], result.waveforms()["factor"]
    paths = {(what, form): tmp_path / f"{what}.{form}" for what in ("tracks", "waveforms") for form in ("nc", "mat")}
    for (what, _), path in paths.items():
        _exported(file, path, "--what", what)
    assert np.array_equal(loadmat(paths["tracks", "mat"])["covariance"], covariance)
    assert np.array_equal(loadmat(paths["waveforms", "mat"])["factor"], factor, equal_nan=True)
    with xr.open_dataset(paths["tracks", "nc"]) as tracks, xr.open_dataset(paths["waveforms", "nc"]) as sent:
        assert np.array_equal(tracks["covariance"], covariance)
        assert tracks["covariance"].dims == ("row", "covariance_0", "covariance_1")
        assert np.array_equal(sent["factor_real"] + 1j * sent["factor_imag"], factor, equal_nan=True)
        assert sent.attrs["run"] == result.run
    columns = _csv_of(file, tmp_path, "tracks")
    assert np.array_equal(columns["covariance_0_2"], covariance[:, 0, 2])


def _csv_of(file: str, folder: Path, what: str) -> Columns:
    _exported(file, folder / f"{what}.csv", "--what", what)
    return _csv(folder / f"{what}.csv")


@pytest.mark.parametrize(("dwells", "chosen"), [("4:6", [4, 5, 6]), (":1", [0, 1]), ("12:", [12])])
def test_some_dwells_are_written_in_every_format(dwells: str, chosen: list[int], file: str, tmp_path: Path) -> None:
    _exported(file, tmp_path / "looks.csv", "--what", "looks", "--dwells", dwells)
    assert sorted(set(_csv(tmp_path / "looks.csv")["t"])) == chosen
    options = ["--format", "csv", "--what", "looks", "--dwells", dwells]
    done = CliRunner().invoke(app, ["export", "--store", file, "--out", "-", *options])
    assert done.stdout == (tmp_path / "looks.csv").read_text()
    _exported(file, tmp_path / "run.mcap", "--dwells", dwells)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = [json.loads(message.data)["t"] for *_, message in make_reader(stream).iter_messages(topics=["/looks"])]
    assert sorted(set(found)) == chosen


def test_units_are_as_xarray_and_udunits_have_them(tmp_path: Path) -> None:
    columns: Table = {name: np.array([0.5, 1e9]) for name in ("utc_s", "acceleration_g", "nu")}
    write_netcdf(columns, tmp_path / "table.nc")
    with xr.open_dataset(tmp_path / "table.nc") as loaded:
        assert loaded["utc_s"].to_numpy()[1] == np.datetime64("2001-09-09T01:46:40")
        assert loaded["acceleration_g"].attrs["units"] == "standard_free_fall"
        assert loaded["nu"].attrs == {"long_name": "direction, 0.5 sin(angle)"}
    assert attributes_of("vx_hat") == {"long_name": "velocity along boresight, of the estimate", "units": "km/s"}


def test_each_column_says_what_it_means(file: str) -> None:
    found = result_of(file)
    columns = {column for table in TABLES.values() for column in table(found)} - set(OF_RUN)
    columns |= {*FURTHER, "existence", "modes", "utc_s", "latitude_hat_deg", "alpha_hat_imag"}
    assert {column for column in columns if "long_name" not in attributes_of(column)} == set()


if shutil.which("octave-cli"):

    def test_octave_reads_the_mat_file(file: str, tmp_path: Path) -> None:
        path = tmp_path / "run.mat"
        _exported(file, path)
        script = f"load('{path}'); printf('%.17g\\n', x_hat(end)); printf('%s\\n', run(1, :));"
        done = subprocess.run(["octave-cli", "--eval", script], capture_output=True, text=True, check=True)
        number, name = done.stdout.split()
        result = result_of(file)
        assert (float(number), name) == (result.estimates[-1, -1, 0], result.run)
