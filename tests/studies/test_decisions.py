"""The decisions of a run judged one by one."""

import threading
from collections import Counter

import pytest

from cogradar.services.sweeps.grid import axis, variants
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import BIN_RULES
from studies.decisions.decisions import OVER, Decisions, judged, play, table

DWELLS = 30


def test_losses_and_open_decisions_of_a_run() -> None:
    found = judged(RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, DWELLS))
    assert found.n == 2 * (DWELLS + 1)  # with those after the acquisition
    assert 0 <= found.open["open"] <= found.open["open_any"] < found.n
    assert found.loss["exact"] == 0.0
    assert set(found.loss) == set(BIN_RULES)
    for policy in BIN_RULES:
        assert 0.0 <= found.loss_open[policy] <= found.loss[policy] + 1e-12
    assert found.loss["mode"] == pytest.approx(found.loss_open["mode"])  # elsewhere it is the best


def test_means_are_over_the_decisions_of_all_runs() -> None:
    axes = [axis("radar.fidelity=robust")]
    runs = [
        Decisions(n, Counter(open=n_open, open_any=n_open), Counter({"mode": loss}), Counter({"mode": loss}))
        for n, n_open, loss in ((90, 1, 0.2), (10, 3, 0.6))
    ]
    found = table(axes, variants("smoke", (), axes), [runs])
    (row,) = [row for row in found.rows if row["policy"] == "mode"]
    assert (row["runs"], row["decisions"], row["open"]) == (2, 100, 4.0)
    assert (row["loss"], row["loss_open"]) == pytest.approx((8.0, 200.0))


def test_a_row_for_each_combination_and_policy() -> None:
    told: list[str] = []
    found = play("smoke", ["dwells=2,3"], 1, told.append, threading.Event())
    assert told == ["1 of 2 runs", "2 of 2 runs"]
    assert [(row["dwells"], row["policy"]) for row in found.rows] == [(n, rule) for n in (2, 3) for rule in BIN_RULES]
    assert {row["decisions"] for row in found.rows} == {6, 8}


def test_the_settings_of_the_study_are_twelve_with_the_world_as_the_radar_expects() -> None:
    grid = variants("paper", (), [axis(text) for text in OVER])
    assert len(grid) == 12
    for variant in grid:
        radar, world = variant.scenario.radar, variant.scenario.simulated
        assert radar.echo.amplitude_db == world.echo.amplitude_db
        assert radar.motion.sigma_s_km_s2 == world.motion.sigma_s_km_s2
