"""Processes replaced and messages lost in runs whose tracks begin and end: births and ends are the same."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from cogradar.services.planner import owned_track
from cogradar.services.recorder import core as recorder
from cogradar.services.runs import in_process
from tests.services.faulty_network import FaultyNetwork, play
from tests.skies import BORN_S, crossing_start, sky_start

DWELLS = 45
START = sky_start(dwells=DWELLS)


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Snapshots and checkpoints so close that a short run has several."""
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", 8)
    monkeypatch.setattr(recorder, "CHECKPOINT_DWELLS", 2)


@pytest.fixture(scope="module")
def undisturbed() -> str:
    return str(in_process.play(START).run["digest"])


def _newest(network: FaultyNetwork) -> int:
    (row,) = network.store.read("SELECT MAX(k) AS k FROM message WHERE topic = 'scan'")
    return -1 if row["k"] is None else int(row["k"])


@pytest.mark.parametrize(
    "k",
    [
        *(int(BORN_S), int(BORN_S) + 1, 25),
        *(pytest.param(more, marks=pytest.mark.nightly) for more in (1, 10, 11, 24, 26, 27)),
    ],
)
def test_all_planners_replaced_about_births_and_ends(k: int, undisturbed: str) -> None:
    network = FaultyNetwork(START, 2, np.random.default_rng(k))
    while _newest(network) < k:
        assert network.step()
    for name in ("planner-0", "planner-1"):
        network.kill(name)
    network.start("planner-9")
    assert play(network, {}) == undisturbed
    assert network.refused == []


def test_planners_killed_one_by_one_while_two_aircraft_cross() -> None:
    """Whose detection is whose is found from the scan alone, by whoever follows the tracks."""
    start = crossing_start(24)
    together = in_process.play(start)
    assert together.picture["completeness"] > 0.6
    assert together.picture["swaps"] == 0
    network = FaultyNetwork(start, 2, np.random.default_rng(5))
    for k, name in ((13, "planner-0"), (15, "planner-1"), (17, "planner-13")):
        ticks = 0
        while _newest(network) < k:
            if not network.step():  # what died with a planner is sent again after a moment
                network.tick()
                ticks += 1
                assert ticks < 200
        network.start(f"planner-{k}")
        network.kill(name)
    assert play(network, {}) == together.run["digest"]
    assert network.refused == []


@pytest.mark.parametrize("loss", [0.02, 0.1])
@pytest.mark.parametrize("seed", [0, *(pytest.param(more, marks=pytest.mark.nightly) for more in range(1, 12))])
def test_losses_and_deaths_of_everybody(loss: float, seed: int, undisturbed: str) -> None:
    rng = np.random.default_rng(90 + seed)
    network = FaultyNetwork(START, 3, rng, loss=loss)
    faults: dict[int, Callable[[], None]] = {}

    def restart(name: str) -> None:
        network.kill(name)
        network.start(name)

    mortal = ["planner-0", "planner-1", "planner-2", "recorder-0", "allocator-0", "emulator-0"]
    for step in sorted(rng.choice(600, size=8, replace=False)):
        faults[int(step)] = partial(restart, str(rng.choice(mortal)))
    assert play(network, faults) == undisturbed
    assert network.refused == []
