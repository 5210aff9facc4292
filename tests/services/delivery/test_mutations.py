"""Broken messages by the thousand: each core refuses them or copes, and goes on."""

import gc
import tracemalloc
from collections.abc import Callable, Iterable
from functools import lru_cache, partial

import numpy as np
import pytest

from services.allocator.core import AllocatorCore
from services.emulator.core import EmulatorCore
from services.emulator.simulated import SimulatedFrontEnd
from services.planner.core import PlannerCore
from services.recorder.core import RecorderCore
from services.recorder.journal import Journal
from shared.numerics.seeds import Purpose, generator
from shared.protocol.events import Membership, Tick
from shared.protocol.messages import Message, Refused, RunStart
from shared.protocol.topics import BY_MESSAGE, Role, Topic, topics_read_by
from shared.wire.codec import BadMessage, decode, encode
from shared.wire.runner import Flush
from tests.mutations import mutated
from tests.samples import FIELDS, sample
from tests.services.loop import checkpoint, play, smoke_start
from tests.skies import sky_start

Core = EmulatorCore | PlannerCore | AllocatorCore | RecorderCore
CORES: dict[Role, Callable[[], Core]] = {
    Role.EMULATOR: lambda: EmulatorCore(SimulatedFrontEnd.open),
    Role.PLANNER: lambda: PlannerCore("p"),
    Role.ALLOCATOR: AllocatorCore,
    Role.RECORDER: lambda: RecorderCore(Journal(":memory:")),
}
STARTS: dict[str, Callable[[], RunStart]] = {
    "announced": partial(smoke_start, dwells=8),
    "unannounced": partial(sky_start, "radar.belief.n_particle=200", dwells=12),
    "real time": lambda: smoke_start(dwells=8).model_copy(update={"rate_hz": 10.0}),
}
PAIRS = [(role, topic) for role in CORES for topic in topics_read_by(role)]
IN_CI = 10_000 // (len(PAIRS) * len(STARTS))  # of each role, topic and run
AGAIN = 20  # accepted ones, after which a core begins anew
MOST_TRIED, ENOUGH, SOME = 600, 20, 1  # broken messages, and how many of them that make no sense


@lru_cache
def said(kind: str) -> tuple[Message, ...]:
    """What is said in a run, with one of everything that is said only when something fails."""
    start = STARTS[kind]()
    heard = play(start.model_copy(update={"rate_hz": 0.0}))
    return (start, checkpoint(start), *heard[2:])


@lru_cache
def payloads(kind: str, topic: Topic) -> tuple[bytes, ...]:
    """Payloads of a topic to begin with."""
    found = [message for message in said(kind) if type(message) is topic.message]
    made = [sample(kind_, run="r") for kind_ in FIELDS if kind_ is topic.message]
    return tuple(encode(message) for message in (*found, *made))


def in_mid_run(role: Role, kind: str) -> tuple[Core, list[Message]]:
    """A core that has seen half of a run, and the other half of what it reads."""
    core, reads = CORES[role](), tuple(topic.message for topic in topics_read_by(role))
    heard = [message for message in said(kind) if isinstance(message, (*reads, RunStart))]
    heard = [message for message in heard if role is Role.RECORDER or not isinstance(message, RunStart)]
    if role is Role.PLANNER:
        answers(core, Membership("planner", ("p",)))
    half = len(heard) // 2
    for message in heard[:half]:
        answers(core, message)
    return core, heard[half:]


def answers(core: Core, event: Message | Membership | Tick) -> list[bytes]:
    """What a core says to an event, encoded: what it says must be what can be said."""
    found: Iterable[Message | Flush] = core.handle(event)
    return [encode(answer) for answer in found if isinstance(answer, Message)]


@pytest.mark.parametrize("kind", STARTS)
@pytest.mark.parametrize("n", [IN_CI, pytest.param(1_000_000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("role", "topic"), PAIRS, ids=lambda value: getattr(value, "name", value))
def test_no_message_harms_a_core(role: Role, topic: Topic, n: int, kind: str) -> None:
    rng = generator(1, Purpose.FAULT, PAIRS.index((role, topic)), list(STARTS).index(kind))
    originals, others = payloads(kind, topic), payloads(kind, BY_MESSAGE[RunStart])
    core, accepted = in_mid_run(role, kind)[0], 0
    bad = refused = 0
    for _ in range(n):
        payload = mutated(originals[rng.integers(len(originals))], others, rng)
        try:
            message = decode(payload)
        except BadMessage:
            bad += 1
            continue
        if not isinstance(message, tuple(topic_.message for topic_ in topics_read_by(role))):
            continue
        try:
            answers(core, message)
            answers(core, Tick(1.0))
        except Refused:
            refused += 1
            continue
        core.validate()
        accepted += 1
        if accepted % AGAIN == 0:
            core = in_mid_run(role, kind)[0]
    assert bad > n // 4


@pytest.mark.parametrize("kind", STARTS)
@pytest.mark.parametrize("role", CORES)
def test_what_is_refused_changes_nothing(role: Role, kind: str) -> None:
    core, rest = in_mid_run(role, kind)
    expected = [answers(core, message) for message in rest]
    rng = generator(2, Purpose.FAULT, list(CORES).index(role), list(STARTS).index(kind))
    refused = list[Message]()
    core, _ = in_mid_run(role, kind)
    for _ in range(MOST_TRIED):
        topic = topics_read_by(role)[rng.integers(len(topics_read_by(role)))]
        originals = payloads(kind, topic)
        try:
            message = decode(mutated(originals[rng.integers(len(originals))], originals, rng))
            answers(core, message)
        except BadMessage:
            continue
        except Refused:
            refused.append(message)
            if len(refused) == ENOUGH:
                break
        else:  # it may have changed something: the next ones meet another core
            core, _ = in_mid_run(role, kind)
    core, _ = in_mid_run(role, kind)
    for message in refused:
        with pytest.raises(Refused):
            answers(core, message)
    assert len(refused) >= SOME
    assert [answers(core, message) for message in rest] == expected


def test_what_is_broken_takes_no_memory() -> None:
    rng = generator(3, Purpose.FAULT, 0, 0)
    originals = [encode(sample(kind)) for kind in FIELDS]
    tracemalloc.start()
    try:
        for _ in range(3000):
            try:
                decode(mutated(originals[rng.integers(len(originals))], originals, rng))
            except BadMessage:
                continue
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] < 1 << 20
    finally:
        tracemalloc.stop()


def test_numbers_of_any_size_are_drawn() -> None:
    """The mutations reach arrays, nested tables and single numbers."""
    rng = generator(4, Purpose.FAULT, 0, 0)
    (scan,) = (encode(sample(kind)) for kind in FIELDS if kind.__name__ == "Scan")
    texts = set()
    for _ in range(2000):
        try:
            decode(mutated(scan, [scan], rng))
        except BadMessage as error:
            texts.add(str(error).partition(":")[0])
    assert {"scan.bins", "scan.statistic", "scan.k", "scan.beams", "not MessagePack"} <= texts
    assert np.isfinite(len(texts))
