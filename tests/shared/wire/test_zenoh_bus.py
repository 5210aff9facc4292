"""The bus over a real router: delivery, lots, and messages that are too long."""

import signal
import time
from collections.abc import Callable, Iterator

import pytest
import zenoh

from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.events import Event, Rewind
from cogradar.shared.protocol.messages import Checkpoint, Lead, Message, Plan, RunStart, Scan
from cogradar.shared.protocol.topics import BY_MESSAGE, EXPOSITION, QUERY, TIMESTAMPS, TOPICS, Role
from cogradar.shared.wire.bus import MAX_WAITING_BYTES
from cogradar.shared.wire.codec import MAX_BYTES, MAX_LOT, encode
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.samples import plan, sample

pytestmark = pytest.mark.zenoh

Connect = Callable[[Role, str], ZenohBus]


@pytest.fixture
def connect(router: str) -> Iterator[Connect]:
    """Connects processes to the router, and closes their buses in the end."""
    buses: list[ZenohBus] = []

    def bus(role: Role, name: str) -> ZenohBus:
        buses.append(ZenohBus(open_session([router], 10.0, lambda: None), role, name))
        return buses[-1]

    yield bus
    for opened in buses:
        opened.close()


def _received(bus: ZenohBus, n: int) -> list[Message]:
    received: list[Message] = []
    deadline = time.monotonic() + 10.0
    while len(received) < n and time.monotonic() < deadline:
        event = bus.receive(0.1)
        if isinstance(event, Message):
            received.append(event)
    return received


def test_every_message_of_many_runs_arrives_in_order(connect: Connect) -> None:
    reader, operator = connect(Role.RECORDER, "m"), connect(Role.OPERATOR, "o")
    starts = [sample(RunStart, run=f"r{i}") for i in range(200)]
    for start in starts:
        operator.publish(start)  # right after opening: nobody waits for a match
    assert _received(reader, len(starts)) == starts
    assert reader.inbox.bad.total() == 0


def test_messages_of_one_topic_and_run_travel_together(connect: Connect) -> None:
    reader, planner = connect(Role.RECORDER, "m"), connect(Role.PLANNER, "p")
    sent = [*(plan(k) for k in range(MAX_LOT + 1)), plan(run="other"), sample(Scan), plan(0)]
    planner.publish(*sent)
    assert _received(reader, len(sent)) == sent
    arrivals = {row.arrived for row in reader.timestamps.received}
    assert len(arrivals) <= 5  # a full lot and the rest of it; three alone; the last is not noted yet
    assert len(planner.timestamps.sent) == len(sent)


def test_what_is_made_of_a_journal_that_is_no_more_is_dropped(connect: Connect) -> None:
    """Two planners hear a recorder; one does not hear its successor, which has an older journal."""

    def event_of(bus: ZenohBus) -> Event | None:
        until = time.monotonic() + 10.0
        while time.monotonic() < until:
            event = bus.receive(0.1)
            if isinstance(event, Message | Rewind) and event != before:
                return event
        return None

    first, second = connect(Role.RECORDER, "one"), connect(Role.RECORDER, "two")
    emulator, planner = connect(Role.EMULATOR, "e"), connect(Role.PLANNER, "p")
    leads = [Lead(epoch=5, revision=0), Lead(epoch=6, revision=11)]
    before = sample(Checkpoint, epoch=5, revision=12, leads=leads[:1], rate_hz=0.0)
    after = sample(Checkpoint, epoch=6, revision=11, leads=leads, rate_hz=0.0)
    deaf = [second, planner]
    while deaf:  # what is sent before the router knows of a reader never comes
        first.publish(before)
        deaf = [reader for reader in deaf if reader.receive(0.1) != before]
    planner.publish(plan())
    assert event_of(second) == plan()
    emulator.publish(sample(Scan))  # it has heard no checkpoint: no stamp
    assert event_of(planner) == sample(Scan)
    second.publish(after)
    planner.publish(plan(1))  # made before it hears of the older journal
    assert event_of(planner) == Rewind(after.run)
    assert event_of(planner) == after
    planner.publish(plan(2))
    assert event_of(second) == sample(Scan)
    assert event_of(second) == plan(2)
    assert second.inbox.bad_of_topic == {"plan": 1}


def test_samples_and_answers_say_how_they_are_encoded_and_no_reader_asks(connect: Connect, router: str) -> None:
    reader, metrics = connect(Role.RECORDER, "m"), connect(Role.METRICS, "x")
    senders = {role: connect(role, f"s-{role}") for role in dict.fromkeys(topic.producer for topic in TOPICS)}
    metrics.serve_queries(lambda metric, _: {"runs": b"[]"}[metric])
    metrics.serve_timestamps(Role.METRICS, "x")
    metrics.serve_exposition(Role.METRICS, "x", lambda: b"cogradar_up 1")
    with open_session([router], 10.0, lambda: None) as session:
        heard = session.declare_subscriber("cogradar/**")
        while heard.try_recv() is None:  # what is sent before the router knows of it would never come
            metrics._session.put("cogradar/heard", b"")
            time.sleep(0.01)
        for topic in TOPICS:
            senders[topic.producer].publish(sample(topic.message))
            got = next(one for one in heard if str(one.key_expr) != "cogradar/heard")
            assert str(got.encoding) == f"application/msgpack;schema=urn:cogradar:10:{topic.name}"
        read = [topic for topic in TOPICS if Role.RECORDER in topic.readers]
        assert len(_received(reader, len(read))) == len(read)
        for lie in zenoh.Encoding("application/json"), zenoh.Encoding("\u2028;" * 50), None:
            key = BY_MESSAGE[Plan].key_of(plan(), build())
            session.put(key, encode(plan()), encoding=lie, congestion_control=zenoh.CongestionControl.BLOCK)
        assert _received(reader, 3) == [plan()] * 3
        assert reader.inbox.bad.total() == 0
        answers = [
            session.get(key.format(metric=metric, role="metrics", name="x"))
            for key, metric in ((QUERY, "runs"), (QUERY, "nothing"), (TIMESTAMPS, ""), (EXPOSITION, ""))
        ]
        for _ in range(4):
            metrics.receive(0.5)
        replies = [next(iter(answer)) for answer in answers]
    assert [str(said.encoding) for reply in replies if (said := reply.ok or reply.err)] == [
        "application/json",
        "text/plain",
        "application/json",
        "text/plain;version=0.0.4",
    ]


def test_a_payload_that_is_too_long_is_counted_and_never_decoded(connect: Connect, router: str) -> None:
    reader, session = connect(Role.RECORDER, "m"), open_session([router], 10.0, lambda: None)
    key = BY_MESSAGE[Plan].key_of(plan(), build())
    with session:
        for payload in bytes(MAX_BYTES + 1), encode(plan()):  # Zenoh's default may drop the second behind the first
            session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        assert _received(reader, 1) == [plan()]
    assert reader.inbox.bad == {key: 1}


def test_what_waits_is_not_drained_though_it_is_no_message(connect: Connect, router: str) -> None:
    """Else whoever is sent nothing but junk for a moment would seem to have handled all."""
    reader = connect(Role.ALLOCATOR, "m")  # which is told of no planners
    key = BY_MESSAGE[Plan].key_of(plan(), build())
    assert reader.is_drained()
    with open_session([router], 10.0, lambda: None) as session:
        for payload in b"junk", encode(plan()):
            session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        until = time.monotonic() + 10.0
        while reader.is_drained():
            assert time.monotonic() < until, "nothing has arrived"
            time.sleep(0.01)
        assert _received(reader, 1) == [plan()]
    assert reader.is_drained()


def test_a_flood_is_dropped_and_counted_and_what_comes_behind_it_arrives(connect: Connect, router: str) -> None:
    """While the reader has no time to read: 40 MiB of one topic, then a message of another."""
    reader, n, size = connect(Role.RECORDER, "m"), 40, 1 << 20
    key, blocking = BY_MESSAGE[Plan].key_of(plan(), build()), zenoh.CongestionControl.BLOCK
    with open_session([router], 10.0, lambda: None) as session:
        for _ in range(n):
            session.put(key, bytes(size), congestion_control=blocking)
        scan = sample(Scan)
        session.put(BY_MESSAGE[Scan].key_of(scan, build()), encode(scan), congestion_control=blocking)
        until = time.monotonic() + 10.0
        while not any(reader._queue._lanes[name].waiting for name in reader._queue._lanes if name.endswith("scan")):
            assert time.monotonic() < until, "it has not arrived"
            time.sleep(0.01)
        assert _received(reader, 1) == [scan]
    no_room = n - MAX_WAITING_BYTES // (size + len(key))
    assert reader.inbox.bad == {BY_MESSAGE[Plan].pattern("*"): no_room, key: n - no_room}  # those are no messages


def test_a_signal_that_takes_longer_than_the_wait_does_not_prolong_it(connect: Connect) -> None:
    """As after a pause: the process goes on when its time is over, and is told to end."""
    signals: list[int] = []

    def on_alarm(number: int, _: object) -> None:
        signals.append(number)
        assert len(signals) == 1, "it waits for ever"
        time.sleep(0.3)

    bus = connect(Role.METRICS, "metrics")
    before = signal.signal(signal.SIGALRM, on_alarm)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1, 2.0)
        assert bus.receive(0.2) is None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert len(signals) == 1
