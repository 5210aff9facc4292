"""Variants compared with a baseline on the same seeds."""

import numpy as np
import pytest

from cogradar.services.analysis.report import sample_of
from cogradar.services.campaigns.campaign import Campaign
from cogradar.services.campaigns.pool import play_one
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.sweeps import differences, results
from cogradar.services.sweeps.grid import Variant, axis, baseline, variants
from cogradar.shared.protocol.build import build
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.tables import assert_shown_whole

DWELLS = 24
SEEDS = 3
AXES = [axis("radar.planner.rule=mode,mean,oracle"), axis("radar.echo.amplitude_db=70,-100")]
PLACE, VALUE = baseline("radar.planner.rule=mode", AXES)


@pytest.fixture(scope="module")
def grid() -> list[Variant]:
    return variants("smoke", ("radar.acquisition.max_scans=5",), AXES)


@pytest.fixture(scope="module")
def store(grid: list[Variant]) -> Store:
    """The mean of the particles lacks the first seed; with the weak echoes no run is complete."""
    kept = in_memory()
    asked = Campaign(tuple(one.scenario for one in grid), (Strategy.POWER_AWARE,), SEEDS, 1, DWELLS)
    lacks = grid[2].scenario.name, 1
    for place, start in enumerate(asked.starts(), 1):
        if (start.scenario["name"], start.seed) != lacks:
            kept.journal.add_recording(play_one(start, build())[0], place)
    return kept


@pytest.fixture(scope="module")
def rows(store: Store, grid: list[Variant]) -> results.Rows:
    return differences.compared(results.rows(store, AXES, grid), store, grid, PLACE, VALUE)


def _p_d(store: Store, scenario: str) -> dict[int, np.ndarray]:
    """By seed: P_D of each target."""
    (one,) = experiments(store, Selection.of({"run": "all", "scenario": scenario}))
    sample = sample_of(store, one, Strategy.POWER_AWARE)
    return dict(zip(sample.seeds.tolist(), sample.detected.mean(axis=1), strict=True))


def test_differences_are_taken_within_seeds(store: Store, grid: list[Variant], rows: results.Rows) -> None:
    by_values = {(row["radar.planner.rule"], row["radar.echo.amplitude_db"]): row for row in rows}
    base = _p_d(store, grid[0].scenario.name)
    for rule, variant, seeds in (("mean", grid[2], {2, 3}), ("oracle", grid[4], {1, 2, 3})):
        row, own = by_values[rule, 70], _p_d(store, variant.scenario.name)
        target = row["compared_target"] - 1
        assert own.keys() & base.keys() == seeds
        assert row["pairs"] == len(seeds)
        assert row["compared_target"] == by_values["mode", 70]["target"]
        expected = np.mean([own[seed][target] - base[seed][target] for seed in seeds])
        assert row["p_d_difference"] == pytest.approx(expected)
        assert row["p_d_difference_low"] <= expected + 1e-12
        assert row["p_d_difference_high"] >= expected - 1e-12
    assert by_values["oracle", 70]["p_d_difference"] >= 0.0


def test_the_baseline_and_what_was_not_played_have_none(rows: results.Rows) -> None:
    known = [(row["radar.planner.rule"], row["radar.echo.amplitude_db"]) for row in rows if row["pairs"] is not None]
    assert known == [("mean", 70), ("oracle", 70)]
    assert {row[name] for row in rows if row["pairs"] is None for name in differences.NAMES} == {None}
    assert len({tuple(row) for row in rows}) == 1  # as CSV needs them


def test_the_table_has_the_variants_that_are_compared(rows: results.Rows) -> None:
    table = differences.table(rows, AXES, PLACE, VALUE)
    assert table.title == "Minus radar.planner.rule = mode, on the same seeds"
    assert [table.columns[0].cell(row) for row in table.rows] == ["mean", "oracle (knows the truth)"]
    assert_shown_whole([table])
