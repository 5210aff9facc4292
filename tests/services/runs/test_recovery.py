"""Whatever dies, freezes or is lost, a run ends with the digest and the store of an undisturbed one."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from cogradar.services.metrics.store import in_memory
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.runner import TICK_S
from studies.processes.many_targets import many_targets
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

DWELLS = 20
START = smoke_start(dwells=DWELLS)
ROLES = ("emulator-0", "allocator-0", "recorder-0", "planner-0")


@pytest.fixture(scope="module")
def undisturbed() -> tuple[str, int, list[dict[str, object]]]:
    """Digest, messages handled and scores of a run in which nothing happens."""
    store = in_memory()
    digest = in_process.play(START, store=store).run["digest"]
    network = FaultyNetwork(START, 2, np.random.default_rng(0))
    steps = 0
    while network.step():
        steps += 1
    return digest, steps, store.read("SELECT * FROM score ORDER BY t, target")


Undisturbed = tuple[str, int, list[dict[str, object]]]


def _is_as(network: FaultyNetwork, digest: str, undisturbed: Undisturbed) -> None:
    assert digest == undisturbed[0]
    assert network.scores() == undisturbed[2]
    assert network.refused == []


def test_without_a_fault_no_tick_is_needed(undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 3, np.random.default_rng(1))
    while network.step():
        pass
    (row,) = network.store.read("SELECT status, digest FROM run")
    assert (row["status"], row["digest"]) == ("complete", undisturbed[0])


@pytest.mark.parametrize("name", [*ROLES, "planner-1"])
@pytest.mark.parametrize("when", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("away", [0, 40])
def test_a_process_that_is_killed_and_started_again(
    name: str, when: float, away: int, undisturbed: Undisturbed
) -> None:
    network = FaultyNetwork(START, 2, np.random.default_rng(2))
    step = int(when * undisturbed[1])
    faults = {step: lambda: network.kill(name), step + away + 1: lambda: network.start(name)}
    _is_as(network, play(network, faults), undisturbed)


def test_workers_that_leave_and_come_in_mid_run(undisturbed: Undisturbed) -> None:
    network, n = FaultyNetwork(START, 2, np.random.default_rng(3)), undisturbed[1]
    faults: dict[int, Callable[[], None]] = {
        n // 4: lambda: network.kill("planner-0"),
        n // 3: lambda: network.start("planner-7"),
        n // 2: lambda: network.freeze("planner-1"),
        n // 2 + 60: lambda: network.thaw("planner-1"),
    }
    _is_as(network, play(network, faults), undisturbed)


@pytest.mark.parametrize("when", [0.0, 0.3, 0.7])
def test_a_worker_that_is_alive_and_does_nothing_loses_its_tracks(when: float, undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 3, np.random.default_rng(7))
    _is_as(network, play(network, {int(when * undisturbed[1]): lambda: network.hang("planner-1")}), undisturbed)


def test_two_of_three_workers_that_do_nothing_from_the_start(undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 3, np.random.default_rng(8))
    network.hang("planner-0")
    network.hang("planner-2")
    _is_as(network, play(network, {}), undisturbed)


def test_all_workers_killed_at_once_and_one_started(undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 2, np.random.default_rng(4))

    def massacre() -> None:
        network.kill("planner-0")
        network.kill("planner-1")

    faults = {undisturbed[1] // 2: massacre, undisturbed[1] // 2 + 1: lambda: network.start("planner-9")}
    _is_as(network, play(network, faults), undisturbed)


def test_everything_but_the_store_is_lost(undisturbed: Undisturbed) -> None:
    """Even the operator is gone: what the store holds is enough."""
    network = FaultyNetwork(START, 2, np.random.default_rng(5))

    def massacre() -> None:
        for name in list(network.processes):
            network.kill(name)
        for name in (*ROLES, "planner-1"):
            network.start(name)

    _is_as(network, play(network, {undisturbed[1] // 2: massacre}), undisturbed)


@pytest.mark.parametrize(
    "pair", [("emulator-0", "allocator-0"), ("recorder-0", "planner-0"), ("allocator-0", "planner-1")]
)
@pytest.mark.parametrize("when", [0.3, 0.45, 0.6, 0.75])
def test_two_processes_killed_at_once(pair: tuple[str, str], when: float, undisturbed: Undisturbed) -> None:
    """An emulator and an allocator between two checkpoints once waited for each other for ever."""
    network, step = FaultyNetwork(START, 2, np.random.default_rng(6)), int(when * undisturbed[1])

    def both() -> None:
        for name in pair:
            network.kill(name)
            network.start(name)

    _is_as(network, play(network, {step: both}), undisturbed)


@pytest.mark.parametrize("seed", range(6))
def test_messages_that_are_lost(seed: int, undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 2, np.random.default_rng(seed), loss=0.05)
    _is_as(network, play(network, {}), undisturbed)


@pytest.mark.parametrize("name", [*ROLES, "planner-1"])
def test_a_process_for_which_something_always_waits_sends_again_what_was_lost(
    name: str, undisturbed: Undisturbed
) -> None:
    """Of many runs: it never finds its inbox empty, and waited for that before it answered a request."""
    network = FaultyNetwork(START, 2, np.random.default_rng(9), loss=0.05)
    network.processes[name].busy = True
    _is_as(network, play(network, {}), undisturbed)


# Of 24 seeds one takes 31 s, three 15 s, the others 11 s at most: each request, or its answer, that is lost doubles it.
STANDSTILL_S = 40.0


@pytest.mark.parametrize("seed", range(6))
def test_a_run_of_which_a_tenth_of_all_messages_is_lost_goes_on_within_seconds(seed: int) -> None:
    """Each request, and each answer to it, may be lost, too; waits that doubled for every dwell made it minutes."""
    start = RunStart.of(many_targets(12), Strategy.POWER_AWARE, 1, DWELLS).model_copy(update={"run": "r"})
    network = FaultyNetwork(start, 2, np.random.default_rng(seed), loss=0.1)
    ticks, acknowledged = 0, -1
    while (
        not (row := network.store.read("SELECT status, acknowledged_k AS k FROM run")) or row[0]["status"] == "running"
    ):
        if network.step():
            continue
        network.tick()
        now = row[0]["k"] if row else -1
        ticks, acknowledged = (0 if now > acknowledged else ticks + 1), now
        assert ticks * TICK_S < STANDSTILL_S


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_chaos(seed: int, undisturbed: Undisturbed) -> None:
    """Kills and losses at random places, several at a time."""
    rng = np.random.default_rng(100 + seed)
    network = FaultyNetwork(START, 3, rng, loss=0.01)
    names = (*ROLES, "planner-1", "planner-2")

    def kill(name: str) -> None:
        if name in network.processes:
            network.kill(name)

    def start(*missing: str) -> None:
        for name in missing:
            if name not in network.processes:
                network.start(name)

    faults: dict[int, Callable[[], None]] = {}
    for step in sorted(rng.choice(2 * undisturbed[1], size=8, replace=False)):
        name, away = str(rng.choice(names)), int(rng.integers(1, 50))
        faults[int(step)] = partial(kill, name)
        faults[int(step) + away] = partial(start, name)
    faults[max(faults) + 1] = partial(start, *names)
    _is_as(network, play(network, faults), undisturbed)
