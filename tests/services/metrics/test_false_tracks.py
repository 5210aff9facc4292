"""A track that a false alarm began is no target's: its target counts as not tracked, the others as they are."""

import numpy as np
import pytest

from cogradar.services.analysis.report import report
from cogradar.services.cli.display import run_caption, run_tables
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.runs.run import Result
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

DWELLS = 25


@pytest.fixture(scope="module")
def played() -> tuple[Store, Result]:
    """The first target is 400 km away, twice the prior's range, and is acquired by false alarms; the second is fine."""
    far = ["world.targets.1.state=[300.0, 0.0, -260.0, 0.0]", "radar.acquisition.max_scans=3000"]
    scenario = load("smoke", [*far, "radar.detector.p_fa=1e-3"])
    store = in_memory()
    return store, play(RunStart.of(scenario, Strategy.UNIFORM, 1, DWELLS), store=store)


def test_the_healthy_target_has_its_own_track_s_score(played: tuple[Store, Result]) -> None:
    _, result = played
    lost, healthy = result.targets
    assert (lost["lost"], lost["false_track"], lost["hit_rate"]) == (True, True, 0.0)
    assert (lost["position_rmse_km"], lost["velocity_rmse_km_s"]) == (None, None)
    assert lost["p_d"] < 0.1
    assert (healthy["lost"], healthy["false_track"]) == (False, False)
    assert healthy["position_rmse_km"] < 10.0  # with the other's truth it would be hundreds
    assert healthy["p_d"] > 0.8


def test_rows_of_a_target_without_a_track_have_its_truth_only(played: tuple[Store, Result]) -> None:
    store, _ = played
    rows = answer(store, "tracks", {"target": "1"})
    assert len(rows) == DWELLS
    for row in rows:
        of_track = [row[name] for name in ("track", "bin", "x_hat", "vx_hat", "y_hat", "vy_hat")]
        assert of_track == [None] * 6
        assert (row["best_bin"], row["cells"], row["hit"], row["outage"]) == (None, [], 0, row["t"])
        assert (row["share"], row["late"], row["x"]) == (0.0, 0, pytest.approx(300.0, abs=60.0))
    assert {row["track"] for row in answer(store, "tracks", {"target": "2"})} <= {1, 2}


def test_it_is_shown_and_counted(played: tuple[Store, Result]) -> None:
    _, result = played
    assert result.as_json()["false_tracks"] == 1
    false, healthy = (table.title.partition("scans")[2] for table in run_tables(result))
    assert false == f", out of its bin for {DWELLS} dwells, at most {DWELLS} in a row  LOST, not tracked"
    assert "LOST" not in healthy
    assert "false tracks: 1" in run_caption(result)


def test_a_report_leaves_the_unknown_error_out(played: tuple[Store, Result]) -> None:
    store, _ = played
    (only,) = experiments(store, Selection(run="all"))
    rows = [row for row in report(store, only)["windows"] if row["target"] == 1]
    assert rows
    assert all(
        row["p_d"] < 0.1 and (row["position_rmse_km"] is None or np.isnan(row["position_rmse_km"])) for row in rows
    )
