"""A run in the types of Stone Soup: its detections with their models, its targets and tracks, and their metrics."""

import sys
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cogradar
from cogradar.stonesoup import BEGAN, DwellDetectionReader, DwellGroundTruthReader, tracks, truth
from tests.oracles import stone_soup
from tests.skies import small_sky

DWELLS = 24
COSINE = (1.0 - 0.999**2) ** 0.5  # of the steepest direction


@pytest.fixture(scope="module")
def result() -> cogradar.Result:
    return cogradar.run(small_sky(), seed=4, dwells=DWELLS)


def test_each_echo_is_a_detection_with_its_model(result: cogradar.Result) -> None:
    table, errors = result.detections(), []
    chosen = table[(table["t"] > 0) & (table["strongest"] == 1)]
    states = result.true_states
    found = list(DwellDetectionReader(result.dwells()))
    assert [time for time, _ in found] == [datetime(2000, 1, 1, 0, 0, t) for t in range(1, DWELLS + 1)]
    assert sum(len(detections) for _, detections in found) == len(chosen) > DWELLS
    every = DwellDetectionReader(result.dwells(), every_row=True)
    assert sum(len(detections) for _, detections in every) == (table["t"] > 0).sum()
    for time, detections in found:
        for detection in detections:
            row = detection.metadata
            bearing, range_km = np.ravel(detection.state_vector).astype(float)
            assert np.sin(bearing) / 2.0 == pytest.approx(row["nu_measured"], abs=1e-12)
            assert (detection.timestamp, range_km) == (time, row["range_km"])
            noise = np.diag(detection.measurement_model.covar())
            cosine = max(np.cos(bearing), COSINE)
            assert noise == pytest.approx(
                [(2.0 * row["nu_measured_sigma"] / cosine) ** 2, row["range_cell_km"] ** 2 / 12.0]
            )
            if row["target"]:
                expected = _seen(detection, states[row["t"] - 1, row["target"] - 1])
                off = np.ravel(detection.state_vector - expected).astype(float)
                errors.append(float(np.sum(off**2 / noise)))
    assert len(errors) > DWELLS
    assert 1.2 < np.mean(errors) < 3.2  # of two numbers


def _seen(detection: Any, state: Any) -> Any:
    return detection.measurement_model.function(stone_soup.state(state), noise=False)


def test_a_live_run_says_what_it_says_afterwards(result: cogradar.Result) -> None:
    with cogradar.play(small_sky(), seed=4, dwells=DWELLS) as player:
        live = list(DwellDetectionReader(player))
    for (time, ours), (later, theirs) in zip(live, DwellDetectionReader(result.dwells()), strict=True):
        assert time == later
        assert sorted(map(_numbers, ours)) == sorted(map(_numbers, theirs))


def _numbers(detection: Any) -> list[float]:
    return [float(one) for one in np.ravel(detection.state_vector)]


def test_what_is_not_measured_is_as_wide_as_a_bin() -> None:
    result = cogradar.run("smoke", dwells=6)
    found = [one for _, detections in DwellDetectionReader(result.dwells()) for one in detections]
    assert found
    for detection in found:
        (bearing,) = _numbers(detection)
        assert np.sin(bearing) / 2.0 == pytest.approx(detection.metadata["nu"])
        width = 2.0 / (result.scenario.radar.array.n_bin - 1) / max(np.cos(bearing), COSINE)
        assert detection.measurement_model.covar() == pytest.approx(np.array([[width**2 / 12.0]]))


def test_targets_are_there_while_they_are(result: cogradar.Result) -> None:
    for i, (time, paths) in enumerate(DwellGroundTruthReader(result.dwells())):
        there = {str(m + 1): result.true_states[i, m] for m in np.flatnonzero(result.present[i])}
        assert {path.id for path in paths} == set(there)
        for path in paths:
            assert path[-1].timestamp == time
            assert np.array_equal(np.ravel(path[-1].state_vector).astype(float), there[path.id])


@pytest.mark.parametrize("kind", ["known", "unknown"])
def test_its_metrics_are_those_of_the_run(kind: str, result: cogradar.Result) -> None:
    played = result if kind == "unknown" else cogradar.run("smoke", set={"radar.fidelity": "paper"}, dwells=DWELLS)
    theirs = stone_soup.metrics_of(tracks(played.dwells()), truth(played.dwells()))
    ours = played.picture
    for part in ("localisation", "missed", "false"):
        squares = getattr(ours, f"gospa_{part}_km") ** 2
        assert squares.tolist() == pytest.approx(getattr(theirs, part), abs=1e-9)
    assert (ours.ospa_km**2).tolist() == pytest.approx(theirs.ospa, abs=1e-9)
    for name in ("completeness", "ambiguity", "spuriousness"):
        assert ours.figures[name] == pytest.approx(getattr(theirs, name), abs=1e-9)


def test_tracks_have_the_beliefs(result: cogradar.Result) -> None:
    table = result.tracks()
    for track in tracks(result.dwells(), tentative=True):
        rows = table[(table["track"] == int(track.id)) & (table["t"] > 0)]
        assert [state.timestamp for state in track] == [BEGAN.replace(second=int(t)) for t in rows["t"]]
        assert np.array_equal([state.covar for state in track], rows["covariance"])
    confirmed = sum(map(len, tracks(result.dwells())))
    assert confirmed == (table["confirmed"] & (table["t"] > 0)).sum() < len(table)


def test_times_are_the_sites_where_there_is_one() -> None:
    site = {"site.latitude_deg": 48.0, "site.longitude_deg": 11.0, "site.boresight_deg": 90.0}
    result = cogradar.run("smoke", set=site | {"site.begin_utc": "2026-01-01T00:00:00Z"}, dwells=2)
    times = [time for time, _ in DwellDetectionReader(result.dwells())]
    assert times == [datetime(2026, 1, 1, 0, 0, t) for t in (1, 2)]


RECEIVED = "return receive(self._received(w), waveform, self._radar)"
WITH_A_CLOCK = """if t in {1, 3, 4}:
            raise SenselessScan("nothing came")
        return replace(receive(self._received(w), waveform, self._radar), utc_s=1.79e9 + t)"""


def test_dwells_that_were_not_measured_are_on_the_clock_of_the_others(tmp_path: Path) -> None:
    code = Path("cogradar/templates/front_end.py").read_text().replace(RECEIVED, WITH_A_CLOCK)
    imports = "from dataclasses import replace\nfrom cogradar.front_end import SenselessScan\n"
    (tmp_path / "receiver.py").write_text(code.replace("import numpy as np\n", f"import numpy as np\n{imports}", 1))
    result = cogradar.run("smoke", front_end=f"{tmp_path}/receiver.py:Receiver", dwells=6)
    assert [dwell.utc_s is None for dwell in result.dwells() if dwell.t] == [True, False, True, True, False, False]
    expected = [datetime(2026, 9, 21, 14, 13, 20 + t) for t in range(1, 7)]
    assert [time for time, _ in DwellDetectionReader(result.dwells())] == expected
    found = tracks(result.dwells())
    assert found
    for track in found:
        assert [state.timestamp for state in track] == expected[-len(track) :]


def test_without_stone_soup_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stonesoup.base", None)
    monkeypatch.delitem(sys.modules, "cogradar.stonesoup")
    for expected in (cogradar.BadInput, ImportError):
        with pytest.raises(expected, match=r"pip install 'cogradar\[stonesoup\]'"):
            import_module("cogradar.stonesoup")
    with pytest.raises(pytest.skip.Exception):
        pytest.importorskip("cogradar.stonesoup")
