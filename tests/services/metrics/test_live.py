"""Numbers of the runs that go on, against what the views of the store say of the same dwells."""

import math
from pathlib import Path

import pytest

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.scoring import live
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, RunStart, Scan
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.loop import play
from tests.services.web.conftest import record


def test_the_newest_dwells_of_runs_that_go_on(tmp_path: Path) -> None:
    known = play(RunStart.of(load("smoke"), Strategy.POWER_AWARE, 3, 30))
    begun = known[: next(i for i, message in enumerate(known) if isinstance(message, Scan) and message.t > 20)]
    record(tmp_path / "runs.db", {"over": known, "begun": begun})
    core = MetricsCore(str(tmp_path / "runs.db"))
    core.handle(Tick(0.0))
    core.store.derive()
    (row,) = core.store.read("SELECT * FROM picture WHERE run = 'begun' ORDER BY t DESC LIMIT 1")
    scores = core.store.read("SELECT * FROM score WHERE run = 'begun' AND t = ?", [row["t"]])
    measures = core.measures()
    assert row["t"] > 10
    assert (measures["tracks"], measures["targets"]) == (row["tracks"], row["targets"])
    assert measures["targets_missed"] == row["targets"] - row["followed"]
    assert measures["detected_share"] == sum(score["detected"] for score in scores) / len(scores)
    squares = [row[name] for name in ("localisation_km2", "missed_km2", "false_km2")]
    assert measures["gospa_km"] == pytest.approx(math.sqrt(sum(squares)))
    assert measures["dwell_age_seconds"] == 0.0  # no checkpoint has come
    core.close()


def test_a_run_that_stands_still_grows_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path / "runs.db", {})
    core, now = MetricsCore(str(tmp_path / "runs.db")), [100.0]
    monkeypatch.setattr("cogradar.services.metrics.core.time.monotonic", lambda: now[0])
    scenario = load("smoke")
    settings = {"run": "a", "strategy": Strategy.UNIFORM, "dwells": 50, "radar": scenario.radar.model_dump(), "seed": 1}
    for at_s, k in ((100.0, 3), (103.0, 8), (110.0, 8)):
        now[0] = at_s
        core.handle(Checkpoint.model_validate(settings | {"k": k, "t": k - 2}))
    assert core.measures()["dwell_age_seconds"] == 7.0
    core.handle(Checkpoint.model_validate(settings | {"k": 9, "t": 7, "ended": True}))
    assert core.measures()["dwell_age_seconds"] == 0.0
    core.close()


def test_without_runs_there_is_nothing_to_say() -> None:
    measures = live.measures([])
    assert (measures["tracks"], measures["tracks_lost"]) == (0, 0)
    assert all(
        math.isnan(float(str(measures[name]))) for name in ("targets", "gospa_km", "detected_share", "blind_share")
    )
