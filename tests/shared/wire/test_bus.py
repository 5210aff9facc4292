"""The local network: order, readers, members; and what happens to messages that are none."""

import logging
from queue import Empty

import pytest

from cogradar.shared.protocol.events import Membership
from cogradar.shared.protocol.messages import Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.recovery import Handover, NoPlans, Snapshot
from cogradar.shared.protocol.topics import BY_MESSAGE, GivesWay, Role, is_for
from cogradar.shared.wire.bus import (
    LOCAL,
    MAX_BAD_KEYS,
    MAX_WAITING,
    MAX_WAITING_BYTES,
    OTHER_KEYS,
    Arrivals,
    Inbox,
    LocalBus,
    LocalNetwork,
)
from cogradar.shared.wire.codec import encode, join
from tests.samples import FIELDS, plan, sample

SENT = [sample(kind) for kind in FIELDS] + [plan(k) for k in range(20)]
PLAN_KEY = "cogradar/10/local/run/run-1/plan/0-15"


def drain(bus: LocalBus) -> list[object]:
    events: list[object] = []
    while (event := bus.receive(0.0)) is not None:
        events.append(event)
    return events


def test_every_role_receives_what_it_reads_in_the_order_sent() -> None:
    network = LocalNetwork()
    buses = {role: network.endpoint(role, role) for role in Role}
    for message in SENT:
        buses[Role.EMULATOR].publish(message)
    received = {role: drain(bus) for role, bus in buses.items()}
    assert received.pop(Role.PLANNER)[0] == Membership(Role.PLANNER, ("planner",))
    for role, messages in received.items():
        assert messages == [
            message for message in SENT if role in BY_MESSAGE[type(message)].readers and is_for(message, role, role)
        ]
    assert network.inbox.bad.total() == 0


def test_messages_are_copies_as_on_the_wire() -> None:
    network = LocalNetwork()
    metrics, sent = network.endpoint(Role.RECORDER, "m"), plan()
    network.deliver(sent)
    received = metrics.receive(0.0)
    assert received == sent
    assert isinstance(received, Plan)
    sent.estimate[0] = 99.0
    assert received.estimate[0] == 1.0


def test_planners_are_told_of_all_planners() -> None:
    network = LocalNetwork()
    second = network.endpoint(Role.PLANNER, "b")
    others = [network.endpoint(role, "x") for role in Role if role is not Role.PLANNER]
    first = network.endpoint(Role.PLANNER, "a")
    assert drain(second) == [Membership("planner", ("b",)), Membership("planner", ("a", "b"))]
    assert drain(first) == [Membership("planner", ("a", "b"))]
    assert all(drain(other) == [] for other in others)


def test_a_closed_endpoint_receives_nothing() -> None:
    network = LocalNetwork()
    metrics, other = network.endpoint(Role.RECORDER, "m"), network.endpoint(Role.RECORDER, "n")
    metrics.close()
    network.deliver(plan())
    assert drain(metrics) == []
    assert drain(other) == [plan()]


@pytest.mark.parametrize(
    ("key", "payload", "reason"),
    [
        (PLAN_KEY, b"\xc1", "not MessagePack"),
        (PLAN_KEY, encode(sample(RunEnd)), "the message belongs on another key"),  # another topic
        (PLAN_KEY.replace("0-15", "2-15"), encode(plan(target=1)), "the message belongs on another key"),
        (PLAN_KEY, encode(plan(run="run-2")), "the message belongs on another key"),
        ("cogradar/10/local/run/run-1/waveform", encode(plan()), "the message belongs on another key"),
    ],
)
def test_bad_and_misaddressed_payloads_are_dropped_counted_and_logged_once_a_key(
    caplog: pytest.LogCaptureFixture, key: str, payload: bytes, reason: str
) -> None:
    inbox = Inbox(LOCAL)
    with caplog.at_level(logging.WARNING):
        assert [inbox.open(key, payload) for _ in range(3)] == [[]] * 3
        assert inbox.open(PLAN_KEY, encode(plan())) == [plan()]  # and the key goes on
        assert inbox.open("cogradar/10/local/run/run-1/end", b"") == []
    assert dict(inbox.bad) == {key: 3, "cogradar/10/local/run/run-1/end": 1}
    first, second = [record.getMessage() for record in caplog.records]
    assert first.startswith(f"dropping messages on {key}, the first: {reason}")
    assert second.startswith("dropping messages on cogradar/10/local/run/run-1/end")


@pytest.mark.parametrize("key", ["", "cogradar/7", "cogradar/10/local/run/run-1", f"{PLAN_KEY}/1", f"a/{PLAN_KEY}"])
def test_a_message_on_a_key_of_no_topic_is_dropped(key: str) -> None:
    assert Inbox(LOCAL).open(key, encode(plan())) == []


def test_bad_messages_on_ever_new_keys_take_no_more_memory(caplog: pytest.LogCaptureFixture) -> None:
    inbox = Inbox(LOCAL)
    for i in range(5 * MAX_BAD_KEYS):
        inbox.open(f"cogradar/10/local/run/{i}/scan", b"noise")
    inbox.open("cogradar/10/local/run/0/scan", b"noise")
    assert len(inbox.bad) == MAX_BAD_KEYS + 1
    assert (inbox.bad["cogradar/10/local/run/0/scan"], inbox.bad[OTHER_KEYS]) == (2, 4 * MAX_BAD_KEYS)
    assert inbox.bad.total() == 5 * MAX_BAD_KEYS + 1
    assert len(caplog.records) == MAX_BAD_KEYS + 1


def test_a_lot_is_all_of_one_topic_and_run_on_the_key_of_its_first() -> None:
    inbox, lot = Inbox(LOCAL), [plan(target=1), plan(target=2), plan(k=9, target=2)]
    assert inbox.open(PLAN_KEY, join([encode(message) for message in lot])) == lot
    assert not inbox.bad
    for others in ([plan(run="run-2")], [sample(RunEnd)], [plan(target=2), plan(run="run-2")]):
        assert inbox.open(PLAN_KEY, join([encode(message) for message in [plan(target=1), *others]])) == []
    assert inbox.open(PLAN_KEY, join([encode(plan(target=1)), b"junk"])) == []
    assert inbox.bad == {PLAN_KEY: 4}


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        ("0-7", plan(target=8)),
        ("0-7", plan(target=24)),
        ("8-8", plan(target=7)),
        ("0-7", sample(Snapshot, run="run-1", target=15)),
        ("0-7", sample(Handover, run="run-1", planner="p@0-7", targets=[1, 9])),
        ("0-7", sample(Handover, run="run-1", planner="p", targets=[1])),  # on the key of another
        ("0-15", sample(Handover, run="run-1", planner="p@0-7", targets=[1])),
        ("0-7", sample(NoPlans, run="run-1", process="p@8-15")),  # in the name of another
        ("0-16", plan(target=1)),
        ("7-0", plan(target=1)),
        ("00-7", plan(target=1)),
        ("all", plan(target=1)),
    ],
)
def test_what_a_planner_says_of_tracks_outside_of_its_slots_is_dropped(slots: str, message: Message) -> None:
    inbox, topic = Inbox(LOCAL), BY_MESSAGE[type(message)]
    key = topic.key_of(message, LOCAL, slots)
    assert inbox.open(key, encode(message)) == []
    assert inbox.bad == {key: 1}


@pytest.mark.parametrize(("slots", "target"), [("0-7", 7), ("0-7", 16), ("8-8", 24), ("0-15", 31)])
def test_what_it_says_of_its_own_arrives(slots: str, target: int) -> None:
    inbox = Inbox(LOCAL)
    handover = sample(Handover, run="run-1", planner=f"p@{slots}", targets=[target])
    for message in (plan(target=target), sample(Snapshot, run="run-1", target=target), handover):
        assert inbox.open(BY_MESSAGE[type(message)].key_of(message, LOCAL, slots), encode(message)) == [message]
    other = join([encode(plan(target=target)), encode(plan(target=target + 8))])  # in one lot with another's
    assert len(inbox.open(f"cogradar/10/local/run/run-1/plan/{slots}", other)) == (2 if slots == "0-15" else 0)


def test_a_bad_payload_does_not_hide_the_next_message() -> None:
    network = LocalNetwork()
    metrics = network.endpoint(Role.RECORDER, "m")
    for payload in (b"junk", encode(plan())):
        network.deliver_bytes(PLAN_KEY, payload)
    assert metrics.receive(0.0) == plan()
    assert network.inbox.bad[PLAN_KEY] == 1


@pytest.mark.parametrize("kind", [RunStart, Scan, Truth, Plan, Waveform, RunEnd], ids=lambda kind: kind.__name__)
def test_what_a_core_refuses_is_counted_on_its_key(kind: type[Message], caplog: pytest.LogCaptureFixture) -> None:
    bus, message = LocalNetwork().endpoint(Role.RECORDER, "m"), sample(kind)
    bus.refuse(message, "no such run")
    bus.refuse(message, "no such run")
    key = BY_MESSAGE[kind].key_of(message, LOCAL)
    assert dict(bus.inbox.bad) == {key: 2}
    assert [record.getMessage() for record in caplog.records] == [
        f"dropping messages on {key}, the first: {message.run}: no such run"
    ]


def _arrive(arrivals: Arrivals[int], name: str, n_byte: int, gives_way: GivesWay, items: range) -> None:
    for item in items:
        if arrivals.admit(name, n_byte, gives_way):
            arrivals.put(item, name, n_byte)


def _all_of(arrivals: Arrivals[int]) -> list[int]:
    items = []
    try:
        while True:
            items.append(arrivals.get(0.0))
    except Empty:
        return items


@pytest.mark.parametrize("n_byte", [0, 1 << 20])
@pytest.mark.parametrize("gives_way", GivesWay)
def test_a_flood_of_one_topic_is_bounded_and_counted_and_takes_no_place_of_another(
    gives_way: GivesWay, n_byte: int
) -> None:
    room = min(MAX_WAITING, MAX_WAITING_BYTES // max(n_byte, 1))
    arrivals: Arrivals[int] = Arrivals()
    _arrive(arrivals, "other", 100, GivesWay.ARRIVING, range(-3, -1))
    _arrive(arrivals, "flood", n_byte, gives_way, range(room + 10))
    _arrive(arrivals, "other", 100, GivesWay.ARRIVING, range(-1, 0))
    assert arrivals.dropped() == {"flood": 10}
    assert arrivals.dropped() == {}
    kept = range(room) if gives_way is GivesWay.ARRIVING else range(10, room + 10)
    assert _all_of(arrivals) == [-3, -2, *kept, -1]  # in the order in which they came
    _arrive(arrivals, "flood", n_byte, gives_way, range(room))
    assert (len(_all_of(arrivals)), arrivals.dropped()) == (room, {})  # all its place is free again


def test_what_is_larger_than_all_the_place_there_is_is_dropped() -> None:
    arrivals: Arrivals[int] = Arrivals()
    assert not arrivals.admit("a", MAX_WAITING_BYTES + 1, GivesWay.OLDEST)
    assert arrivals.dropped() == {"a": 1}
