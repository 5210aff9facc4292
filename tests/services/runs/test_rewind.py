"""A journal that is restored from an older state rewinds its run: all begin anew where it is, and nothing differs."""

from collections.abc import Callable

import numpy as np
import pytest

from cogradar.services.delivery import pacing
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder import core
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.sqlite import SqliteConnection
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import Command, Plan
from cogradar.shared.protocol.orders import PowerLimit
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

DWELLS = 60
START = smoke_start(dwells=DWELLS)
Undisturbed = tuple[str, list[dict[str, object]]]


@pytest.fixture(scope="module")
def undisturbed() -> Undisturbed:
    """Digest and scores of a run in which nothing happens."""
    store = in_memory()
    digest = in_process.play(START, store=store).run["digest"]
    return digest, store.read("SELECT * FROM score ORDER BY t, target")


def _copy(network: FaultyNetwork) -> Journal:
    """The journal as a backup has it."""
    network.store.journal.commit()
    copy = Journal(":memory:")
    theirs, ours = (journal._connection for journal in (network.store.journal, copy))
    assert isinstance(theirs, SqliteConnection)
    assert isinstance(ours, SqliteConnection)
    theirs.db.backup(ours.db)
    return copy


def _acknowledged(network: FaultyNetwork) -> int:
    rows = network.store.read("SELECT acknowledged_k AS k FROM run")
    return rows[0]["k"] if rows else -1


def _begin_on(network: FaultyNetwork, store: Store) -> None:
    """A recorder begins on this journal, in place of the one that there was."""
    network.kill("recorder-0")
    network.store = store
    network.start("recorder-0")


def _step_until(network: FaultyNetwork, is_so: Callable[[], bool]) -> None:
    while not is_so():
        if not network.step():
            network.tick()


@pytest.mark.parametrize("back", [-1, 0, 16, 32])
@pytest.mark.parametrize("loss", [0.0, 0.03])
def test_the_digest_is_the_same_after_a_rewind(back: int, loss: float, undisturbed: Undisturbed) -> None:
    """To a state before the run, at its start, and in its course."""
    network = FaultyNetwork(START, 2, np.random.default_rng(back + 2), loss)
    _step_until(network, lambda: _acknowledged(network) >= back)
    copy, copied = _copy(network), _acknowledged(network)
    _step_until(network, lambda: _acknowledged(network) >= max(48, copied + 1))
    acknowledged = _acknowledged(network)
    _begin_on(network, Store(copy))
    assert _acknowledged(network) < acknowledged
    assert play(network, {}) == undisturbed[0]
    assert network.scores() == undisturbed[1]
    assert network.store.read("SELECT conflicts FROM run") == [{"conflicts": 0}]


def test_a_rewind_and_then_the_loss_of_everybody_else(undisturbed: Undisturbed) -> None:
    network = FaultyNetwork(START, 2, np.random.default_rng(7))
    _step_until(network, lambda: _acknowledged(network) >= 16)
    copy = _copy(network)
    _step_until(network, lambda: _acknowledged(network) >= 48)
    _begin_on(network, Store(copy))
    for _ in range(200):
        if not network.step():
            network.tick()
    for name in ("emulator-0", "allocator-0", "planner-0", "planner-1"):
        network.kill(name)
        network.start(name)
    assert play(network, {}) == undisturbed[0]
    assert network.scores() == undisturbed[1]


@pytest.fixture
def _acknowledged_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The journal is right behind the radar, so that an order takes effect within the run."""
    monkeypatch.setattr(pacing, "MAX_AHEAD_DWELLS", 2)
    monkeypatch.setattr(core, "CHECKPOINT_DWELLS", 1)


def _order(network: FaultyNetwork) -> None:
    network.publish("operator", Command(run=START.run, id="0f" * 16, by="operator", action=PowerLimit(share=0.3)))
    network.processes.pop("operator")


@pytest.mark.usefixtures("_acknowledged_at_once")
@pytest.mark.parametrize("seed", range(3))
def test_what_was_ordered_on_another_copy_of_the_journal_is_forgotten(seed: int, undisturbed: Undisturbed) -> None:
    """A recorder goes on for a while on a copy; the original, which then goes on, has more dwells and no order."""
    network = FaultyNetwork(START, 2, np.random.default_rng(seed))
    _step_until(network, lambda: _acknowledged(network) >= 12)
    copy, original = Store(_copy(network)), network.store
    _step_until(network, lambda: _acknowledged(network) >= 30)
    _begin_on(network, copy)
    _step_until(network, lambda: 14 <= _acknowledged(network) < 20)
    _order(network)
    _step_until(network, lambda: _acknowledged(network) >= 24)
    _begin_on(network, original)
    assert play(network, {}) == undisturbed[0]


@pytest.mark.usefixtures("_acknowledged_at_once")
@pytest.mark.parametrize("seed", range(6))
def test_who_was_away_while_a_recorder_began_twice_forgets_what_the_journal_lost(
    seed: int, undisturbed: Undisturbed
) -> None:
    """The journal lost an order. When its second recorder begins it has more dwells than the planner was told of."""
    network = FaultyNetwork(START, 2, np.random.default_rng(seed))
    _step_until(network, lambda: _acknowledged(network) >= 12)
    copy = _copy(network)
    _order(network)
    _step_until(network, lambda: _acknowledged(network) >= 30)
    of_planners = {name: one for name, one in network.processes.items() if name.startswith("planner")}
    away, process = max(of_planners.items(), key=lambda one: sum(isinstance(sent, Plan) for sent in one[1].sent))
    network.freeze(away)
    _begin_on(network, older := Store(copy))
    _step_until(network, lambda: _acknowledged(network) >= 40)
    _begin_on(network, older)
    _step_until(network, lambda: _acknowledged(network) >= 44)
    process.queues.clear()  # nothing reached it
    network.thaw(away)
    assert play(network, {}) == undisturbed[0]
