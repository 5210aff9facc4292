"""The studies of an array's world: recorded I/Q, jammers, heights, equal antennas, figures of both worlds."""

import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import cogradar
from cogradar.services.analysis.tables import markdown
from cogradar.services.campaigns.campaign import Campaign, open_store
from cogradar.services.campaigns.pool import play_one
from cogradar.services.sweeps.grid import axis, variants
from cogradar.shared.protocol.build import build
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import steering_vector
from studies.array import antennas, heights, jammer, noise, sea, worlds

DWELLS = 6
Played = Callable[[str, str, tuple[str, ...]], str]


@pytest.fixture
def played(tmp_path: Path) -> Played:
    """The store of a short sweep over one axis, two runs each."""

    def play(scenario: str, over: str, settings: tuple[str, ...] = ()) -> str:
        scenarios = tuple(variant.scenario for variant in variants(scenario, settings, [axis(over)]))
        asked = Campaign(scenarios, (Strategy.POWER_AWARE,), runs=2, first_seed=1, dwells=DWELLS)
        file = str(tmp_path / "sweep.db")
        with closing(open_store(file, asked, resume=False)) as kept:
            for place, start in enumerate(asked.starts(), 1):
                kept.journal.add_recording(play_one(start, build())[0], place)
        return file

    return play


def test_a_recording_has_a_line_and_a_texture(tmp_path: Path) -> None:
    file = tmp_path / "new" / "sea.npy"
    textures, data = sea.write(file, 6), np.load(file)
    assert data.shape == (6, sea.N_RANGE, sea.N, sea.N)
    assert textures.max() > 8.0 * np.median(textures)  # impulsive
    plain = data / np.sqrt(textures)[..., np.newaxis, np.newaxis]
    a = steering_vector(sea.LINE_NU, sea.N).conj()
    line = np.abs(np.einsum("...tr,t,r->...", plain, a, a)) ** 2 / sea.N**4
    assert 10.0 * np.log10(line.mean()) == pytest.approx(sea.LINE_DB, abs=1.5)
    np.testing.assert_array_equal(data[0, 3], next(sea.dwells(1)).y[3].astype(np.complex64))


def test_only_noise_from_other_range_cells_stands_the_recording(tmp_path: Path) -> None:
    told: list[str] = []
    rows = noise.measure(tmp_path / "sea.npy", 10, told.append, threading.Event())
    by_lags, by_rows, by_range = rows
    assert [row["noise"] for row in rows] == list(noise.NOISES)
    assert {row["tests"] for row in rows} == {10 * sea.N_RANGE}
    assert by_lags["blind"] > 10.0
    assert by_rows["blind"] == by_range["blind"] == 0.0
    assert min(by_lags["worst_4"], by_rows["worst_4"]) > 0.5
    assert by_range["worst_2"] < 0.04
    assert by_range["p_d"] > 0.4
    assert by_range["p_d_more"] > by_range["p_d"]
    assert len(told) == 10 / noise.WITH_TARGET
    assert "| range-cells | 640 |" in markdown(noise.table(rows))


def test_equal_antennas_lose_little_and_no_less_than_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(antennas, "N_PROBLEM", 4)
    monkeypatch.setattr(antennas, "TRACKS", (12,))
    (row,) = antennas.measure()
    assert 0.0 <= row["bound"] <= row["equal"] < row["conventional"] < 1.0 < row["scaled"]
    assert row["equal"] <= row["equal_most"] < 0.5
    assert "| 12 | 4 |" in markdown(antennas.table([row]))


@pytest.mark.nightly
def test_a_jammer_blinds_lags_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jammer, "DWELLS", 4)
    monkeypatch.setattr(jammer, "JNRS_DB", (20.0,))
    monkeypatch.setattr(jammer, "DRAWS", 100)
    rows = {(row["noise"], row["jnr"]): row for row in jammer.measure()}
    assert rows["lags", "20"]["blind"] > 25.0
    assert [rows[place]["blind"] for place in (("lags", "none"), ("rows", "none"), ("rows", "20"))] == [0.0] * 3
    assert rows["rows", "20"]["tests"] >= 4 * (100 - 9)
    assert rows["rows", "20"]["false"] <= 3
    assert rows["rows", "20"]["more_null"] > rows["rows", "20"]["p_d_null"] > rows["rows", "20"]["p_d_lobe"]
    assert rows["lags", "20"]["p_d_lobe"] < 0.1
    bins, detection = map(markdown, jammer.tables(list(rows.values())))
    assert "| rows | 20 | 0.0 |" in bins
    assert "| 24.5 beams off |" in detection


def test_heights_that_are_assumed_are_in_the_covariance(played: Played) -> None:
    settings = ("radar.fidelity=best-range", *(f"world.targets.{i}.height_km=10" for i in (1, 2)))
    plain, assumed = heights.measure(played("smoke", "radar.assumes.height_max_km=0,12", settings))
    assert (plain["assumed"], assumed["assumed"]) == (0.0, 12.0)
    assert plain["runs"] == assumed["runs"] == 2
    assert assumed["nees"] < 12.0 < plain["nees"]
    for row in (plain, assumed):
        assert row["left"] > 0.1
        assert row["rmse_low"] <= row["rmse"] <= row["rmse_high"]
    assert "| 0 to 12 | 2 |" in markdown(heights.table([plain, assumed]))


def test_both_worlds_are_in_one_figure(played: Played, tmp_path: Path) -> None:
    files = worlds.draw(played("smoke", "world.signal=cells,array", ()), tmp_path / "new" / "both")
    assert [file.name for file in files] == ["both.png", "both.pdf"]
    assert all(file.stat().st_size > 10_000 for file in files)


def test_one_world_alone_is_no_comparison(played: Played, tmp_path: Path) -> None:
    store = played("smoke", "world.signal=cells", ())
    with pytest.raises(cogradar.BadInput, match=r"must have runs with world.signal = cells and array"):
        worlds.draw(store, tmp_path / "both")
    assert list(tmp_path.glob("both*")) == []
