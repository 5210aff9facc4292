"""Targets whose RCS fluctuates, through the whole system: the same run everywhere, and tracks that are kept."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner import owned_track
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.faulty_network import FaultyNetwork, play

DWELLS = 24


def start_of(world: str, assumed: str, dwells: int = DWELLS) -> RunStart:
    settings = [f"world.rcs={world}", f"radar.assumes.rcs={assumed}"]
    return RunStart.of(load("smoke", settings), Strategy.POWER_AWARE, 1, dwells)


def test_planners_and_faults_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planner that is killed goes on from a snapshot, which carries what was learned of the echoes."""
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", 8)
    start = start_of("swerling3", "unknown")
    alone = in_process.play(start).run["digest"]
    assert in_process.play(start, planners=3).run["digest"] == alone
    network = FaultyNetwork(start, 2, np.random.default_rng(1), loss=0.1)
    faults: dict[int, Callable[[], None]] = {
        200: partial(network.kill, "planner-0"),
        240: partial(network.start, "planner-0"),
    }
    assert play(network, faults) == alone
    assert network.refused == []


def test_what_is_assumed_and_what_is_true_both_matter() -> None:
    pairs = ("constant", "known"), ("swerling1", "known"), ("constant", "mean"), ("constant", "unknown")
    assert len({in_process.play(start_of(*pair, 4)).run["digest"] for pair in pairs}) == 4


@pytest.mark.parametrize("assumed", ["mean", "unknown"])
def test_fluctuating_targets_are_kept(assumed: str) -> None:
    """The smoke scenario's targets have P_D near 1 at a constant RCS, of Swerling I some .9."""
    store = in_memory()
    in_process.play(start_of("swerling1", assumed, 60), store=store)
    rows: list[dict[str, Any]] = [row for row in answer(store, "tracks", {}) if row["t"] > 0]
    store.close()
    for target in (1, 2):
        own = [row for row in rows if row["target"] == target]
        assert np.mean([row["detected"] for row in own]) > 0.7
        assert np.mean([row["best_bin"] == row["true_bin"] for row in own]) > 0.9
