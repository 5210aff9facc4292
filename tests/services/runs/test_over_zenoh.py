"""Whatever a scenario asks for, a run over Zenoh is the run of one process; played on the same services in turn."""

import threading
from typing import Any

import pytest

from cogradar.services.runs import cluster, in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.runs.looks import SETTINGS
from tests.skies import sky_start

ASKED = {name: SETTINGS[name] for name in ("wide, joint", "urgency, joint", "best-range")}
ASKED |= {
    "fluctuating": ("world.rcs=swerling1", "radar.assumes.rcs=unknown"),
    "array": (
        "world.signal=array",
        "radar.fidelity=best-range",
        "world.array.phase_sigma_deg=5.0",
        "world.jammers=[{bearing_deg = 40.0, jnr_db = 10.0, on_s = 5.0, off_s = 12.0}]",
        "world.clutter={cnr_db = -30.0}",
    ),
    "array, echoes told apart": (
        "world.signal=array",
        "radar.fidelity=best-range",
        "radar.echo.amplitude_db=90",
        "radar.receiver.separation=joint",
        "radar.receiver.noise=rows",
        "world.jammers=[{bearing_deg = 40.0, jnr_db = 10.0, on_s = 5.0, off_s = 12.0}]",
    ),
    "exact": ("radar.planner.rule=exact",),
}


@pytest.mark.zenoh
@pytest.mark.parametrize("name", ASKED)
def test_over_zenoh_it_is_the_same_run(name: str, endpoint: str) -> None:
    start = RunStart.of(load("smoke", ASKED[name]), Strategy.POWER_AWARE, 1, 24)
    nobody: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}
    there = cluster.play_on(endpoint, start, **nobody)
    assert there.run["digest"] == in_process.play(start).run["digest"]


@pytest.mark.zenoh
def test_in_real_time_tracks_begin_while_the_radar_goes_on(endpoint: str) -> None:
    """Two aircraft from the start; nobody told the radar of them.

    So slowly that a radar whose planners still get ready misses a dwell or two at most.
    """
    start = sky_start(dwells=12).model_copy(update={"rate_hz": 2.0, "run": "in-real-time"})
    nobody: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}
    run = cluster.play_on(endpoint, start, **nobody)
    assert (run.run["status"], run.run["t"]) == ("complete", 12)
    first, other, _third = run.as_json()["targets"]
    assert all(1 < one["confirmed_t"] <= 12 for one in (first, other))
    assert run.picture["completeness"] > 0.3
