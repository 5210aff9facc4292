"""The bus over Zenoh: every process is a client of one router.

Messages are put on keys that are never declared, so neither the router nor a reader keeps anything of a run that is
over. A message that a broken link loses is not recovered here: its sender redelivers it until a checkpoint acknowledges
it (docs/adr/0008-recovery-by-checkpoints.md).
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from queue import Empty
from typing import Any, Final, NamedTuple

import zenoh

from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.events import Event, Membership, Rewind, Shards
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.slots import ALL_SLOTS, slots_of
from cogradar.shared.protocol.topics import (
    ALIVE,
    BY_MESSAGE,
    EXPOSITION,
    PROTOCOL,
    QUERY,
    TIMESTAMPS,
    TOPICS,
    GivesWay,
    Role,
    Topic,
    topics_read_by,
)
from cogradar.shared.wire.bus import MAX_WAITING, MAX_WAITING_BYTES, Arrivals, Inbox
from cogradar.shared.wire.codec import MAX_BYTES, MAX_LOT, WHOLE, Parts, encode, join
from cogradar.shared.wire.meter import Meter
from cogradar.shared.wire.pool.live_names import LiveNames
from cogradar.shared.wire.pool.members import Pool
from cogradar.shared.wire.queries import ENCODINGS, REFUSAL, Alive, Answer, alive, names_alive, parameters, reply
from cogradar.shared.wire.timestamps import Timestamps

LOT_BYTES = 64 << 10  # of messages that travel together
QUALITY: Final[dict[str, Any]] = {  # of every sample
    "congestion_control": zenoh.CongestionControl.BLOCK,
    "priority": zenoh.Priority.DATA,
    "express": True,
}
TOLD_OF_PLANNERS = (Role.PLANNER, Role.RECORDER)  # which of them are there
_SAMPLES = {topic.message: zenoh.Encoding(topic.encoding) for topic in TOPICS}


class _Payload(NamedTuple):
    key: str
    payload: bytes
    stamp: bytes | None
    arrived: float


class _TooLong(NamedTuple):
    key: str
    n_byte: int


class _Token(NamedTuple):
    name: str
    is_alive: bool


class _Query(NamedTuple):
    query: zenoh.Query
    answer: Callable[[zenoh.Query], None]


class _Encoded(NamedTuple):
    message: Message
    payload: bytes
    begun: float  # when encoding began


class ZenohBus:
    """One process's connection over a session, which it owns.

    The transport's threads only put items into a queue. The thread that calls `receive` handles them.
    """

    def __init__(
        self, session: zenoh.Session, role: Role, name: str, *, reads: bool = True, pool: Pool | None = None
    ) -> None:
        """Subscribe to what the role reads, then show the process alive. `reads` False: it only sends and asks.

        pool : whose runs it hears; None: all

        An operator hears every build; the others hear their own only, and whatever an operator says.
        """
        self.build = build()
        self._slots = slots_of(name) if role is Role.PLANNER else ALL_SLOTS
        heard = None if role is Role.OPERATOR else self.build
        self.inbox = Inbox(heard)
        self.timestamps, self.meter = Timestamps(), Meter(role)
        self._session, self.pool = session, pool
        self._queue: Arrivals[_Payload | _TooLong | _Token | _Query | Membership] = Arrivals()
        self._decoded: deque[tuple[Message, float]] = deque()  # rest of a lot, and when it arrived
        self._declared: list[Any] = []
        token = partial(ALIVE.format, protocol=PROTOCOL, build=self.build, role=role)
        self._planners = LiveNames()
        self._routers = frozenset(map(str, session.info.routers_zid()))
        if role in TOLD_OF_PLANNERS:
            # Whole, and before any message: a planner that knew only some of the others would take tracks that are
            # theirs. Asked first: just after the subscription, which tells of them one by one, the answer may be that
            # there is none.
            own = {name} if role is Role.PLANNER else set()
            self._planners = LiveNames(own.union(names_alive(session, self.build, Role.PLANNER)))
            self._queue.put(self._membership())
            shown = ALIVE.format(protocol=PROTOCOL, build=self.build, role=Role.PLANNER, name="*")
            self._declared.append(session.liveliness().declare_subscriber(shown, self._on_token, history=True))
        address = name if role is Role.PLANNER else role
        self._declared += [
            session.declare_subscriber(
                topic.pattern(heard or "*", address), self._reader(topic), allowed_origin=zenoh.Locality.REMOTE
            )
            for topic in topics_read_by(role)
            if reads
        ]
        self._token = session.liveliness().declare_token(token(name=name))

    def publish(self, *messages: Message) -> None:
        """Send messages on their topics; blocks while the link is congested.

        Consecutive messages of one topic and run travel together, on the key of the first: to wake every thread on the
        way for each of them costs more CPU time than to read it.
        """
        lot: list[_Encoded] = []
        for message in messages:
            begun = time.monotonic()
            encoded = _Encoded(message, encode(message), begun)
            if lot and not _fits(lot, encoded):
                self._put(lot)
                lot = []
            lot.append(encoded)
        if lot:
            self._put(lot)

    def _put(self, lot: Sequence[_Encoded]) -> None:
        first = lot[0].message
        stamps = [self.inbox.epochs.say(encoded.message) for encoded in lot]  # one and the same
        self._session.put(
            BY_MESSAGE[type(first)].key_of(first, self.build, self._slots),
            join([encoded.payload for encoded in lot]),
            encoding=_SAMPLES[type(first)],
            attachment=None if stamps[0] is None else stamps[0].packed(),
            **QUALITY,
        )
        for message, payload, begun in lot:
            self.timestamps.send(message, begun, len(payload))
            self.meter.send(message, len(payload))

    def receive(self, timeout_s: float) -> Event | None:
        """Next event, or None if there is none in time; answers queries meanwhile."""
        self.timestamps.finish()
        for name, n in self._queue.dropped().items():
            self.inbox.drop(name, f"{MAX_WAITING} payloads or {MAX_WAITING_BYTES} bytes wait already", n)
        deadline = time.monotonic() + timeout_s
        while True:
            event = self._shards() or self._expired() or self._next(deadline)
            if self.has_paused():
                continue  # nothing of its runs is to be handled, nor is a tick: what is dropped is sent again
            if event is not None or time.monotonic() >= deadline:
                return event

    def has_paused(self) -> bool:
        """Whether this process of a pool was away for so long that it was missed."""
        return self.pool is not None and self.pool.has_paused()

    def is_drained(self) -> bool:
        """Whether no message and no question waits."""
        return not self._decoded and self._queue.is_empty()

    def refuse(self, message: Message, reason: str) -> None:
        """Count and log a message that the core refuses."""
        self.inbox.drop(BY_MESSAGE[type(message)].key_of(message, self.build), f"{message.run}: {reason}")

    def serve_queries(self, answer: Answer) -> None:
        """Answer queries with `answer`, in the thread that calls `receive`; its ValueErrors go to the asker."""

        def counted(query: zenoh.Query) -> None:
            began = time.monotonic()
            self.meter.answer(reply(query, answer), time.monotonic() - began)

        self._serve(QUERY.format(metric="*"), counted)

    def serve_timestamps(self, role: Role, name: str) -> None:
        """Report when asked, in the thread that calls `receive`, what was received and sent when."""
        # The question may be for all; the answer is on a key of our own.
        key, encoding = TIMESTAMPS.format(role=role, name=name), ENCODINGS[TIMESTAMPS]
        self._serve(
            key, lambda query: query.reply(key, self.timestamps.of(parameters(query).get("run", "")), encoding=encoding)
        )

    def serve_exposition(self, role: Role, name: str, text: Callable[[], bytes]) -> None:
        """Answer Prometheus's questions, in the thread that calls `receive`."""
        key, encoding = EXPOSITION.format(role=role, name=name), ENCODINGS[EXPOSITION]
        self._serve(key, lambda query: query.reply(key, text(), encoding=encoding))

    def is_connected(self) -> bool:
        """Whether there is a router."""
        return bool(self._session.info.routers_zid())

    def alive(self) -> Alive:
        """Which processes are alive."""
        return alive(self._session, self.build)

    def close(self) -> None:
        """Leave: first what was declared, whose callbacks must not outlive the session."""
        if self._session.is_closed():
            return
        self._token.undeclare()
        if self.pool is not None:
            self.pool.close()
        for declared in self._declared:
            declared.undeclare()
        self._session.close()

    def _reader(self, topic: Topic) -> Any:
        name = topic.pattern("*")

        def on_sample(sample: zenoh.Sample) -> None:
            key, n_byte = str(sample.key_expr), len(sample.payload)
            if self.pool is not None and not self.pool.serves(key):
                return
            is_long = n_byte > MAX_BYTES  # what is too long, or has no room, is not copied
            waits = len(key) + (0 if is_long else n_byte)
            if self._queue.admit(name, waits, topic.gives_way):
                arrived = time.monotonic()
                item = _TooLong(key, n_byte) if is_long else _Payload(key, *_bytes_of(sample), arrived)
                self._queue.put(item, name, waits)

        # On the transport's own thread: one thread less to wake for each message.
        return zenoh.handlers.Callback(on_sample, indirect=False)

    def _on_token(self, sample: zenoh.Sample) -> None:
        self._queue.put(_Token(str(sample.key_expr).split("/")[-1], sample.kind == zenoh.SampleKind.PUT))

    def _serve(self, key: str, answer: Callable[[zenoh.Query], None]) -> None:
        def on_query(query: zenoh.Query) -> None:
            n_byte = len(str(query.parameters)) + len(query.payload or b"")
            if self._queue.admit(key, n_byte, GivesWay.ARRIVING):
                self._queue.put(_Query(query, answer), key, n_byte)
            else:
                with query:
                    query.reply_err(b"too many questions wait", encoding=REFUSAL)

        self._declared.append(self._session.declare_queryable(key, on_query, complete=True))

    def _next(self, deadline: float) -> Event | None:
        """Handle the next item of the queue: an event if it is or makes one."""
        if self._decoded:
            message, arrived = self._decoded.popleft()
            return self._taken(message, arrived, time.monotonic())
        try:
            until = min(deadline, self._planners.due_s)
            item = self._queue.get(max(0.0, until - time.monotonic()))
        except Empty:
            return None
        match item:
            case _Payload():
                return self._decode(item)
            case Membership():
                return item
            case _TooLong(key, n_byte):
                self.inbox.drop(key, f"{n_byte} bytes, more than {MAX_BYTES}")
            case _Token(name, True):
                return self._membership() if self._planners.appear(name) else None
            case _Token(name, False):
                self._planners.disappear(name, time.monotonic())
            case _Query(query, answer):
                with query:
                    answer(query)
        return None

    def _decode(self, item: _Payload) -> Event | None:
        taken, messages = time.monotonic(), self.inbox.open(item.key, item.payload, item.stamp)
        if not messages:
            return None
        self.meter.receive(messages, len(item.payload))
        if self.inbox.void:
            self._decoded.extend((message, item.arrived) for message in messages)
            return Rewind(self.inbox.void.pop())
        self._decoded.extend((message, item.arrived) for message in messages[1:])
        return self._taken(messages[0], item.arrived, taken)

    def _taken(self, message: Message, arrived: float, taken: float) -> Message:
        self.timestamps.receive(message, arrived, taken)
        self.meter.take(message, arrived)
        return message

    def _shards(self) -> Shards | None:
        held = None if self.pool is None else self.pool.news()
        return None if held is None else Shards(held)

    def _expired(self) -> Membership | None:
        if not self._planners.absent:
            return None
        # A router that was started again between two looks hides all tokens, too.
        before, self._routers = self._routers, frozenset(map(str, self._session.info.routers_zid()))
        is_connected = bool(self._routers) and self._routers == before
        has_changed = self._planners.expire(time.monotonic(), is_connected=is_connected)
        return self._membership() if has_changed else None

    def _membership(self) -> Membership:
        return Membership(Role.PLANNER, self._planners.names)


class Listener:
    """For an observer, no process of a run: messages of some kinds, of all runs and builds, in the order in which they
    came. The oldest give way.
    """

    def __init__(self, session: zenoh.Session, kinds: Sequence[type[Message]], parts: Parts = WHOLE) -> None:
        """Subscribe; the session stays its owner's. `parts`: of `decode`."""
        self._inbox = Inbox(parts=parts)
        self._arrivals: Arrivals[_Payload] = Arrivals()
        self._subscribers = [
            session.declare_subscriber(BY_MESSAGE[kind].pattern("*"), self._reader(BY_MESSAGE[kind].name))
            for kind in kinds
        ]

    def receive(self, timeout_s: float) -> list[Message]:
        """The messages that came next together; none if there is none in time."""
        until = time.monotonic() + timeout_s
        while (left := until - time.monotonic()) > 0.0:
            try:
                found = self._arrivals.get(left)
            except Empty:
                break
            messages = self._inbox.open(found.key, found.payload)
            self._inbox.void.clear()  # it has no core
            if messages:
                return messages
        return []

    def close(self) -> None:
        """Hear no more."""
        for subscriber in self._subscribers:
            subscriber.undeclare()

    def _reader(self, name: str) -> Any:
        def on_sample(sample: zenoh.Sample) -> None:
            n_byte = len(sample.payload)
            if n_byte <= MAX_BYTES and self._arrivals.admit(name, n_byte, GivesWay.OLDEST):
                item = _Payload(str(sample.key_expr), *_bytes_of(sample), time.monotonic())
                self._arrivals.put(item, name, n_byte)

        return zenoh.handlers.Callback(on_sample, indirect=False)


def _bytes_of(sample: zenoh.Sample) -> tuple[bytes, bytes | None]:
    """What a sample carries, and its stamp."""
    stamp = sample.attachment
    return sample.payload.to_bytes(), None if stamp is None else stamp.to_bytes()


def _fits(lot: Sequence[_Encoded], encoded: _Encoded) -> bool:
    """Whether a message may travel with a lot."""
    first, n_byte = lot[0].message, sum(len(before.payload) for before in lot)
    alike = type(first) is type(encoded.message) and first.run == encoded.message.run
    return alike and len(lot) < MAX_LOT and n_byte + len(encoded.payload) <= LOT_BYTES
