"""Every supported combination of settings is played."""

from typing import Any

import pytest

from cogradar.services.runs.in_process import play
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.combinations import A_NUMBER, A_WIDTH, ROWS, UNKNOWN, YOUR_OWN, Allowed, as_toml
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

SMALL = (
    "radar.belief.n_particle=100",
    "radar.planner.n_sim=50",
    "radar.acquisition.max_scans=20",
    "radar.echo.amplitude_db=85",  # acquired at once
    "world.rcs=swerling1",
)
FREE: Allowed = {"assumes.rcs": ("known", "mean", "unknown"), "motion.modes": ("constant-velocity", "mixture")}
SOME = {A_NUMBER: 2, A_WIDTH: 0.5}  # of the smoke scenario's two targets


def values(row: Allowed) -> dict[str, list[Any]]:
    """Of each key, those that come with the program; tests of plug-ins play others."""
    return {key: [value for value in allowed if value != YOUR_OWN] for key, allowed in {**row, **FREE}.items()}


def settings(row: Allowed, i: int) -> list[str]:
    """The i-th value of each key, and again from the first."""
    chosen = {key: allowed[i % len(allowed)] for key, allowed in values(row).items()}
    given = [f"radar.{key}={as_toml(SOME.get(value, value))}" for key, value in chosen.items()]
    return given + (["radar.search.beams=2"] if chosen["tracks"] == UNKNOWN else [])


@pytest.mark.parametrize("name", ROWS)
def test_every_supported_combination_is_played(name: str) -> None:
    """And every value of each of its keys."""
    row = ROWS[name]
    for i in range(max(map(len, values(row).values()))):
        scenario = load("smoke", [*SMALL, *settings(row, i)])
        result = play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, 2))
        assert result.run["status"] == "complete", settings(row, i)
