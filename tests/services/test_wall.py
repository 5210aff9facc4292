"""The wall between world and radar: nothing that a planner or the allocator can receive tells of the truth."""

import struct
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest

from cogradar.services.emulator.cycle import transmission
from cogradar.services.planner import owned_track
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, RunStart, Scan, Truth
from cogradar.shared.protocol.recovery import Handover, History, NoPlans
from cogradar.shared.protocol.topics import Role, topics_read_by
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.world_config import (
    TargetSection,
    WorldConfig,
    WorldEchoSection,
    WorldMotionSection,
)
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.world.cell_scene import CellScene
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import SMOKE, checkpoint

SEED = 0x1234_5678_9ABC_DEF  # found nowhere by chance
RADAR_ROLES = ("planner", "allocator")
EVERY = 8  # dwells between snapshots
WORLD_KEYS = {"world", "world_seed", "targets", "disturbance", "states", "snr_db", "waveform_k"}


def _scenario() -> Scenario:
    """A world in which nothing is as the radar assumes, and no value occurs by chance."""
    states = ([40.1873, 0.10331, -30.2711, 0.05417], [50.3391, -0.05273, 20.4457, 0.10793])
    changed = {
        "motion": WorldMotionSection(sigma_s_km_s2=0.003771),
        "echo": WorldEchoSection(amplitude_db=71.293),
        "targets": [TargetSection(state=state) for state in states],
    }
    return SMOKE.model_copy(update={"world": SMOKE.simulated.model_copy(update=changed)})


class Tapped(FaultyNetwork):
    """Keeps the bytes of all that planners and allocator are handed."""

    def __init__(self, start: RunStart, rng: np.random.Generator) -> None:
        self.received: dict[type[Message], list[bytes]] = {}
        self.other: list[Event] = []
        super().__init__(start, 2, rng)

    def _handle(self, name: str, event: Event) -> None:
        if name.startswith(RADAR_ROLES) and isinstance(event, Message):
            self.received.setdefault(type(event), []).append(encode(event))
        elif name.startswith(RADAR_ROLES) and not isinstance(event, Tick):
            self.other.append(event)
        super()._handle(name, event)


@pytest.fixture(scope="module")
def start() -> RunStart:
    return RunStart.of(_scenario(), Strategy.POWER_AWARE, SEED, dwells=6 * EVERY)


@pytest.fixture(scope="module")
def network(start: RunStart) -> Tapped:
    """A whole run in which planners die and come back, so that scans and snapshots are recalled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owned_track, "SNAPSHOT_DWELLS", EVERY)
        tapped = Tapped(start, np.random.default_rng(1))
        _replace_when(
            tapped, "SELECT 1 FROM message WHERE k = 9", ("planner-0", "planner-1"), ("planner-2", "planner-3")
        )
        _replace_when(
            tapped, "SELECT 1 FROM snapshot", ("planner-2", "planner-3", "allocator-0"), ("allocator-0", "planner-4")
        )
        play(tapped, {})
    return tapped


def _replace_when(network: Tapped, query: str, old: tuple[str, ...], new: tuple[str, ...]) -> None:
    """Let processes die, and start others, as soon as the journal has something."""
    while not network.store.read(query):
        if not network.step():
            network.tick()
    for name in old:
        network.kill(name)
    for name in new:
        network.start(name)


def _payloads(network: Tapped) -> Iterator[bytes]:
    """Every message received, and every message inside of one."""
    for payload in (payload for payloads in network.received.values() for payload in payloads):
        yield payload
        message = decode(payload)
        if isinstance(message, History):
            yield from message.payloads


def _values(document: Any) -> Iterator[Any]:
    """Keys and values of a decoded document, however deep."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield key
            yield from _values(value)
    elif isinstance(document, list | tuple):
        for value in document:
            yield from _values(value)
    else:
        yield document


def _truth(network: Tapped, start: RunStart) -> list[Truth]:
    messages = [decode(payload) for payload in network.store.journal.messages(start.run, ("truth",))]
    return [message for message in messages if isinstance(message, Truth)]


def test_what_planners_and_allocator_received_is_everything_they_can(network: Tapped) -> None:
    readable = {topic.message for role in (Role.PLANNER, Role.ALLOCATOR) for topic in topics_read_by(role)}
    # Handovers have numbers of tracks alone; that a planner cannot plan has its own words.
    assert readable == {Checkpoint, Scan, Plan, History, Handover, NoPlans}
    assert set(network.received) == readable - {Handover, NoPlans}
    recalled = {type(decode(inner)).__name__ for payload in network.received[History] for inner in _inner(payload)}
    assert {"Scan", "Snapshot"} <= recalled <= {"Scan", "Snapshot", "Waveform", "Plan"}
    assert {type(event) for event in network.other} == {Membership}


def _inner(payload: bytes) -> list[bytes]:
    history = decode(payload)
    assert isinstance(history, History)
    return history.payloads


def test_no_key_and_no_value_of_the_world_is_in_it(network: Tapped, start: RunStart) -> None:
    world = start.scenario["world"]
    secrets = {value for value in _values(world) if isinstance(value, float) and value} | {
        world["disturbance"]["model"],
        SEED,
    }
    assert len(secrets) == 2 * 4 + 4
    for payload in _payloads(network):
        document = msgpack.unpackb(payload, ext_hook=lambda *_: None)
        assert secrets.union(WORLD_KEYS).isdisjoint(_values(document))


def test_no_bytes_of_truth_seed_or_model_are_in_it(network: Tapped, start: RunStart) -> None:
    """Whatever a value is packed into: arrays are little-endian, single numbers big-endian."""
    secrets = {SEED.to_bytes(8, "little"), SEED.to_bytes(8, "big"), str(SEED).encode(), f"{SEED:x}".encode()}
    secrets.add(start.scenario["world"]["disturbance"]["model"].encode())
    truths = _truth(network, start)
    assert len(truths) > 6 * EVERY
    for value in {value for truth in truths for array in (truth.states, truth.snr_db) for value in array.ravel()}:
        secrets |= {struct.pack("<d", value), struct.pack(">d", value)}
    everything = b"|".join(_payloads(network))
    assert [secret for secret in secrets if secret in everything] == []
    told = encode(checkpoint(start))  # to the emulator: what is there is found
    assert sum(secret in told for secret in secrets) == 2 + 2 * 4


def test_the_radar_s_seed_does_not_lead_to_the_world(start: RunStart) -> None:
    """Drawn from the seed that planners have, the targets fly elsewhere and the disturbance is another."""
    scenario, seeds = _scenario(), (SEED, radar_seed(SEED))
    assert seeds[0] != seeds[1]
    assert radar_seed(seeds[1]) not in seeds
    world, radar = WorldConfig.model_validate(start.scenario["world"]), scenario.radar
    looks = transmission(radar, None).looks
    factor = np.empty((radar.array.n_tx, 0), np.complex128)
    scenes = [CellScene(world, radar, seed, t=3) for seed in seeds]
    assert not np.isclose(scenes[0].states, scenes[1].states, rtol=1e-9).any()
    true, guessed = (scene.observe(3, 1.0, factor, looks) for scene in scenes)
    assert not any(a.cell.sigma_hat == b.cell.sigma_hat for a, b in zip(true, guessed, strict=True))


def test_the_name_of_a_run_tells_nothing_of_its_seed() -> None:
    names = [RunStart.of(SMOKE, Strategy.POWER_AWARE, seed, 1).run for seed in (SEED, SEED, 1)]
    assert len(set(names)) == 3
    assert not any(str(SEED) in name or f"{SEED:x}" in name for name in names)
