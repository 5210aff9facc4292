"""Every detection of a run in a table: what the scans say, and which target is in each cell."""

from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export import formats
from cogradar.services.analysis.export.tables import TABLES
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart, Scan, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.association import echoes
from cogradar.shared.wire.codec import decode
from tests.services.stored import result as result_of
from tests.services.stored import rows

DWELLS, WIDTH = 14, 0.5
SETTINGS = {
    "bins": (),
    "steered": ("radar.fidelity=best-range",),
    "unknown": ("radar.fidelity=best-range", 'radar.tracks="unknown"'),
}


@pytest.fixture(scope="module", params=SETTINGS)
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("store") / f"{request.param}.db")
    store = Store(Journal(path))
    scenario = load("smoke", list(SETTINGS[request.param]))
    in_process.play(RunStart.of(scenario, Strategy.POWER_AWARE, 3, DWELLS), store=store)
    store.close()
    return path


def _messages(file: str, topic: str) -> dict[int, Any]:
    found = rows(file, "SELECT k, payload FROM message WHERE topic = ? ORDER BY k", [topic])
    return {row["k"]: decode(row["payload"]) for row in found}


def test_there_is_a_row_for_each_cell_over_its_limit(file: str, tmp_path: Path) -> None:
    result, path = result_of(file), tmp_path / "detections.csv"
    done = CliRunner().invoke(app, ["export", "--store", file, "--what", "detections", "--out", str(path)])
    assert done.exit_code == 0, done.output
    found, radar = pd.read_csv(path), result.scenario.radar
    scans: dict[int, Scan] = _messages(file, "scan")
    truths: dict[int, Truth] = _messages(file, "truth")
    at = 0
    for k, scan in scans.items():
        limits = np.full(scan.bins.size, threshold(radar.detector.p_fa)) if scan.limits is None else scan.limits
        for i in np.flatnonzero(scan.statistic >= limits).tolist():
            row = found.iloc[at]
            at += 1
            assert (row["k"], row["t"], row["t_s"]) == (k, scan.t, scan.t * radar.motion.dt_s)
            assert (row["statistic"], row["limit"]) == (scan.statistic[i], limits[i])
            assert row["p_fa"] == pytest.approx(np.exp(-limits[i] / 2))
            assert row["alpha_hat_real"] + 1j * row["alpha_hat_imag"] == complex(scan.alpha_hat[i])
            assert (row["sigma_hat"], row["signature_power"]) == (scan.sigma_hat[i], scan.signature_power[i])
            nu = (scan.bins[i] / (radar.array.n_bin - 1) - 0.5) if scan.nus is None else scan.nus[i]
            assert row["nu"] == pytest.approx(nu, abs=1e-12)
            if scan.nu_hats is None or scan.nu_sigmas is None or scan.ranges_km is None:
                assert np.isnan([row["nu_measured"], row["nu_measured_sigma"], row["range_km"]]).all()
                continue
            measured = (row["nu_measured"], row["nu_measured_sigma"], row["range_km"], row["range_cell_km"])
            assert measured == (scan.nu_hats[i], scan.nu_sigmas[i], scan.ranges_km[i], WIDTH)
            if row["target"]:
                state = truths[k].states[int(row["target"]) - 1]
                assert abs(np.hypot(state[0], state[2]) - row["range_km"]) <= 0.5 * WIDTH
                assert abs(spatial_frequency(state) - row["nu_measured"]) < 6.0 * row["nu_measured_sigma"]
    assert at == len(found) > DWELLS
    assert f"{at} rows of detections" in done.output.replace("\n", " ")
    of_targets = found[(found["target"] > 0) & (found["t"] > 0)].groupby(["t", "target"]).size()
    assert len(of_targets) == result.detected.sum()  # whoever asked for the cell


def test_the_strongest_rows_are_what_a_tracker_takes(file: str) -> None:
    result = result_of(file)
    found, rows = result.detections(), ScanRows.of(result.scenario.radar)
    for k, scan in _messages(file, "scan").items():
        seen = rows.read(vars(scan))
        over = np.flatnonzero(seen.is_over())
        assert over[found["strongest"][found["k"] == k] == 1].tolist() == echoes(rows.response, seen, over).tolist()


@pytest.mark.parametrize("form", ["npz", "parquet", "mat", "nc", "json"])
def test_every_format_has_the_same_rows(form: str, file: str, tmp_path: Path) -> None:
    result, path = result_of(file), tmp_path / f"detections.{form}"
    expected = TABLES["detections"](result)
    assert formats.write(result, path, None, "detections") == f"{result.detections().size} rows of detections"
    assert len({values.size for values in expected.values()}) == 1
    if form == "npz":
        with np.load(path) as loaded:
            assert all(np.array_equal(loaded[n], v, equal_nan=v.dtype.kind == "f") for n, v in expected.items())


def test_what_cannot_be_written_is_bad_input(file: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["export", "--store", file, "--what", "plots", "--out", str(tmp_path / "x.csv")])
    assert done.exit_code == 2
    assert "--what plots: must be one of scores, tracks, detections, looks" in done.stderr
    with closing(Store(Journal(file, read_only=True))) as store:
        kept, recording = in_memory(), take(store, result_of(file).run)
    assert recording is not None
    kept.journal.add_recording(recording, 1)
    with pytest.raises(BadInput, match="is stored, as in the store of a campaign"):
        TABLES["detections"](Result(StoredRun(partial(answer, kept))))
