"""Planners replaced late in a run, in a network with faults: they go on from snapshots, and the run is the same."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from cogradar.services.planner import owned_track
from cogradar.services.recorder import core as metrics
from cogradar.services.runs import in_process
from cogradar.shared.protocol.recovery import ScanRecall
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

EVERY, DWELLS = 4, 80
START = smoke_start(dwells=DWELLS)


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Snapshots and checkpoints so close that a short run has several."""
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", EVERY)
    monkeypatch.setattr(metrics, "CHECKPOINT_DWELLS", 2)


@pytest.fixture(scope="module")
def undisturbed() -> str:
    return str(in_process.play(START).run["digest"])


def _questions(network: FaultyNetwork, name: str) -> list[ScanRecall]:
    return [question for question in network.processes[name].sent if isinstance(question, ScanRecall)]


@pytest.mark.parametrize("seed", range(8))
def test_all_planners_replaced_late_in_a_run(seed: int, undisturbed: str) -> None:
    """The new one asks for nothing between the first dwell and the snapshots."""
    network = FaultyNetwork(START, 2, np.random.default_rng(seed))
    while not (kept := network.store.read("SELECT MIN(k) AS k FROM snapshot HAVING COUNT(*) = 2 AND MIN(k) > 10")):
        assert network.step()
    for name in ("planner-0", "planner-1"):
        network.kill(name)
    network.start("planner-9")
    assert play(network, {}) == undisturbed
    assert network.refused == []
    asked = {question.k for question in _questions(network, "planner-9")}
    assert min(asked) == 0
    assert min(asked - {0}, default=100) > kept[0]["k"]


@pytest.mark.parametrize("loss", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_planners_with_slots_are_replaced_late_in_a_run(seed: int, loss: float, undisturbed: str) -> None:
    """Each by one with its slots: nobody else may take the tracks, and recalls are of its own."""
    network = FaultyNetwork(START, 0, np.random.default_rng(seed), loss=loss)
    for name in ("planner-0@0-0", "planner-1@1-15"):
        network.start(name)
    while not network.store.read("SELECT MIN(k) FROM snapshot HAVING COUNT(*) = 2 AND MIN(k) > 10"):
        if not network.step():
            network.tick()
    for name in ("planner-0@0-0", "planner-1@1-15"):
        network.kill(name)
    for name in ("planner-2@0-0", "planner-3@1-15"):
        network.start(name)
    assert play(network, {}) == undisturbed
    assert network.refused == []
    for m, name in enumerate(("planner-2@0-0", "planner-3@1-15")):
        assert {track for question in _questions(network, name) for track in question.targets} == {m}


def test_a_run_without_a_planner_for_one_of_its_tracks_waits_for_one(
    undisturbed: str, caplog: pytest.LogCaptureFixture
) -> None:
    network = FaultyNetwork(START, 0, np.random.default_rng(1))
    network.start("planner-0@0-0")
    for _ in range(200):
        if not network.step():
            network.tick()
    assert network.store.read("SELECT 1 FROM message WHERE topic = 'waveform'") == []
    said = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert said[0] == "r: no planner here may plan for tracks 2"
    assert not any("no plans from" in line for line in said)
    network.start("planner-1@1-1")
    assert play(network, {}) == undisturbed


@pytest.mark.parametrize("loss", [0.02, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_takeovers_with_losses(loss: float, seed: int, undisturbed: str) -> None:
    """Planners and metrics die and messages are lost, snapshots and their recall among them."""
    rng = np.random.default_rng(50 + seed)
    network = FaultyNetwork(START, 3, rng, loss=loss)
    faults: dict[int, Callable[[], None]] = {}

    def restart(name: str) -> None:
        network.kill(name)
        network.start(name)

    for step in sorted(rng.choice(500, size=6, replace=False)):
        faults[int(step)] = partial(restart, str(rng.choice(["planner-0", "planner-1", "planner-2", "recorder-0"])))
    assert play(network, faults) == undisturbed
    assert network.refused == []
    assert network.store.read("SELECT * FROM snapshot") == []
