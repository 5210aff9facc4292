"""How a process reaches the others: the protocol, and the local queue for cores that share one process."""

import logging
import threading
from collections import Counter, deque
from collections.abc import Sequence
from queue import Empty
from typing import Generic, NamedTuple, Protocol, TypeVar

from cogradar.shared.protocol.events import Event, Membership, Rewind
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.slots import ALL_SLOTS, may_be_said, slots_of
from cogradar.shared.protocol.topics import BY_MESSAGE, GivesWay, Role, is_for, topic_of, topics_read_by
from cogradar.shared.wire.codec import WHOLE, BadMessage, Parts, decode, encode, split
from cogradar.shared.wire.epochs import Epochs, Stamp

log = logging.getLogger(__name__)
Item = TypeVar("Item")


class Bus(Protocol):
    """One process's connection. Everything arrives in one queue, read by the one thread that owns the core."""

    def publish(self, *messages: Message) -> None:
        """Send messages on their topics, in order; messages of one topic may travel together."""

    def receive(self, timeout_s: float) -> Event | None:
        """Next event, or None if there is none in time. Bad messages are dropped, counted, and logged once a key."""

    def is_drained(self) -> bool:
        """Whether nothing waits. What is received may be no event; then None says nothing of that."""

    def has_paused(self) -> bool:
        """Whether this process was away for so long that others do its part: what is due is not to be done here."""

    def refuse(self, message: Message, reason: str) -> None:
        """Drop a message that the core refuses, like a bad one."""

    def close(self) -> None:
        """Leave, within two seconds."""


LOCAL = "local"  # build of the cores that share one process
MAX_BAD_KEYS = 100  # counted apart; a faulty sender may use ever new keys
OTHER_KEYS = "other keys"
MAX_WAITING = 20_000  # payloads of one topic, ...
MAX_WAITING_BYTES = 32 << 20  # ... and their bytes, that wait at a process


class Inbox:
    """Decodes what arrives; drops, counts and logs what is no valid message."""

    def __init__(self, build: str | None = None, parts: Parts = WHOLE) -> None:
        """`build` of the senders; None: of any, to watch only. `parts`: of `decode`."""
        self._build, self._parts = build, parts
        self._whole = {part: whole for whole, part in parts.items()}
        self.bad: Counter[str] = Counter()  # per key; of the keys beyond the first hundred together
        self.bad_of_topic: Counter[str] = Counter()
        self.epochs = Epochs()
        self.void: set[str] = set()  # runs that the core must forget first: `Rewind`

    def open(self, key: str, payload: bytes, stamp: bytes | None = None) -> list[Message]:
        """Messages of a payload that came on `key`: none if it is bad, several if they travelled together.

        stamp : what came beside it, `cogradar.shared.wire.epochs.Stamp`; None: nothing
        """
        try:
            messages = [decode(one, self._parts) for one in split(payload)]
            made_of = None if stamp is None else Stamp.of(stamp)
        except BadMessage as error:
            self.drop(key, str(error))
            return []
        # A lot is on the key of its first message.
        kinds = {(type(message), message.run) for message in messages}
        if len(kinds) > 1 or not self._is_key_of(messages, key):
            self.drop(key, "the message belongs on another key")
            return []
        return [message for message in messages if self._is_current(message, key, made_of)]

    def _is_current(self, message: Message, key: str, stamp: Stamp | None) -> bool:
        if self.epochs.voids(message):
            self.void.add(message.run)
        if fault := self.epochs.fault(message, stamp):
            self.drop(key, fault)
        return not fault

    def _is_key_of(self, messages: Sequence[Message], key: str) -> bool:
        build = next(iter(key.split("/")[2:]), "") if self._build is None else self._build
        kind = type(messages[0])
        topic = BY_MESSAGE[self._whole.get(kind, kind)]
        slots = topic.slots_on(key)
        is_key = key == topic.key_of(messages[0], build, slots)
        return is_key and (topic.producer is not Role.PLANNER or all(may_be_said(one, slots) for one in messages))

    def drop(self, key: str, reason: str, n: int = 1) -> None:
        """Count messages that are dropped; the first on a key is logged."""
        self.bad_of_topic[topic_of(key)] += n
        if key not in self.bad and len(self.bad) >= MAX_BAD_KEYS:
            key = OTHER_KEYS
        self.bad[key] += n
        if self.bad[key] == n:
            log.warning("dropping messages on %s, the first: %s", key, reason)


class _Waiting(NamedTuple, Generic[Item]):
    order: int
    n_byte: int
    item: Item


class _Lane(Generic[Item]):
    def __init__(self) -> None:
        self.waiting: deque[_Waiting[Item]] = deque()
        self.n_byte = 0

    def has_room(self, n_byte: int) -> bool:
        return len(self.waiting) < MAX_WAITING and self.n_byte + n_byte <= MAX_WAITING_BYTES

    def pop(self) -> Item:
        first = self.waiting.popleft()
        self.n_byte -= first.n_byte
        return first.item


class Arrivals(Generic[Item]):
    """What waits for the thread that owns the core, in the order in which it came; bounded for each name apart.

    A flood of one kind takes no place of another; within a kind, one sender may take the place of all. Threads
    of the transport put items in, and never wait here.
    """

    def __init__(self) -> None:
        self._lanes: dict[str, _Lane[Item]] = {}
        self._n_put = 0
        self._dropped: Counter[str] = Counter()
        # Not a SimpleQueue: its get waits for ever if a signal arrives when its time is over, as after a pause.
        self._changed = threading.Condition()

    def admit(self, name: str, n_byte: int, gives_way: GivesWay) -> bool:
        """Whether an item may wait, and be copied for it; the oldest of its name make room if they give way."""
        with self._changed:
            lane = self._lanes.setdefault(name, _Lane())
            while not lane.has_room(n_byte):
                self._dropped[name] += 1
                if gives_way is GivesWay.ARRIVING or not lane.waiting:
                    return False
                lane.pop()
            return True

    def put(self, item: Item, name: str = "", n_byte: int = 0) -> None:
        """Let an item wait; one that was not admitted is of this process itself, or rare."""
        with self._changed:
            self._n_put += 1
            self._lanes.setdefault(name, _Lane()).waiting.append(_Waiting(self._n_put, n_byte, item))
            self._lanes[name].n_byte += n_byte
            self._changed.notify()

    def get(self, timeout_s: float) -> Item:
        """The item that came first; raises Empty if there is none in time."""
        with self._changed:
            if not self._changed.wait_for(self._is_any, timeout_s):
                raise Empty
            lanes = (lane for lane in self._lanes.values() if lane.waiting)
            return min(lanes, key=lambda lane: lane.waiting[0].order).pop()

    def is_empty(self) -> bool:
        """Whether nothing waits."""
        with self._changed:
            return not self._is_any()

    def dropped(self) -> dict[str, int]:
        """How many were dropped of each name since this was asked last."""
        if not self._dropped:
            return {}
        with self._changed:
            dropped, self._dropped = self._dropped, Counter()
            return dropped

    def _is_any(self) -> bool:
        return any(lane.waiting for lane in self._lanes.values())


class LocalBus:
    """Endpoint of a LocalNetwork."""

    def __init__(self, network: "LocalNetwork", role: Role, name: str) -> None:
        self.role, self.name = role, name
        self._slots = slots_of(name) if role is Role.PLANNER else ALL_SLOTS
        self.queue: deque[Event] = deque()
        self.reads = {topic.message for topic in topics_read_by(role)}
        self.inbox = Inbox(LOCAL)
        self._network = network

    def publish(self, *messages: Message) -> None:
        """Put the encoded messages into every reader's queue."""
        for message in messages:
            self._network.deliver(message, self._slots)

    def receive(self, timeout_s: float) -> Event | None:  # noqa: ARG002 - nothing can arrive while we wait
        """Next event, or None if the queue is empty."""
        return self.queue.popleft() if self.queue else None

    def is_drained(self) -> bool:
        """Whether the queue is empty."""
        return not self.queue

    def has_paused(self) -> bool:
        """False: in one process there is no other that could do its part."""
        return False

    def refuse(self, message: Message, reason: str) -> None:
        """Count and log a message that the core refuses."""
        self.inbox.drop(BY_MESSAGE[type(message)].key_of(message, LOCAL), f"{message.run}: {reason}")

    def close(self) -> None:
        """Leave the network."""
        self._network.endpoints.remove(self)


class LocalNetwork:
    """Endpoints in one process. Messages arrive in the order sent, encoded and decoded as on the wire.

    They are decoded and checked once, and all readers share the result: a core changes no message.
    """

    def __init__(self) -> None:
        self.endpoints: list[LocalBus] = []
        self.inbox = Inbox(LOCAL)

    def endpoint(self, role: Role, name: str) -> LocalBus:
        """A new endpoint; planners are told of all planners."""
        bus = LocalBus(self, role, name)
        self.endpoints.append(bus)
        if role is Role.PLANNER:
            planners = [other for other in self.endpoints if other.role is role]
            for other in planners:
                other.queue.append(Membership(role, tuple(sorted(planner.name for planner in planners))))
        return bus

    def deliver(self, message: Message, slots: str = ALL_SLOTS) -> None:
        """Queue a message at all readers of its topic; `slots` of a planner that sends it."""
        self.deliver_bytes(BY_MESSAGE[type(message)].key_of(message, LOCAL, slots), encode(message))

    def deliver_bytes(self, key: str, payload: bytes) -> None:
        """Queue the messages of a payload that came on `key` at all its readers."""
        messages = self.inbox.open(key, payload)
        while self.inbox.void:
            rewound = Rewind(self.inbox.void.pop())
            for bus in self.endpoints:
                bus.queue.append(rewound)
        for message in messages:
            for bus in self.endpoints:
                if type(message) in bus.reads and is_for(message, bus.role, bus.name):
                    bus.queue.append(message)
