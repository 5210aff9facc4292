"""The bus over Zenoh: every process is a client of one router.

Publishers and subscribers are "advanced" ones: the publisher keeps its last samples, the subscriber notices a gap and
fetches what is missing, a late joiner gets the history. Blocking alone loses messages when a link freezes.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from queue import Empty, SimpleQueue
from typing import Any
from urllib.parse import unquote

import zenoh
from zenoh.ext import (
    AdvancedPublisher,
    CacheConfig,
    HistoryConfig,
    MissDetectionConfig,
    RecoveryConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from shared.protocol.messages import Checkpoint, Event, Membership, Message
from shared.protocol.topics import ALIVE, BY_MESSAGE, CACHE_SAMPLES, QUERY, TIMING, Role, Topic, topics_read_by
from shared.wire.bus import Inbox
from shared.wire.codec import MAX_LOT, encode, join
from shared.wire.keys import Lanes
from shared.wire.timestamps import Stamps

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.2  # how soon a lost last sample is noticed
LEFT_S = 3.0  # a process that went is reported gone after this: a router's restart hides everybody for up to 2.8 s
LOT_BYTES = 64 << 10  # of messages that travel together
KEPT_ANSWERS = 8  # messages of a topic of which only the newest counts: what a reader can miss and still recover


class ZenohBus:
    """One process's connection over a session, which it owns."""

    def __init__(self, session: zenoh.Session, role: Role, name: str) -> None:
        """Subscribe to what the role reads, then show the process alive."""
        self.inbox = Inbox()
        self.stamps = Stamps()
        self.missed = 0  # samples that could not be recovered
        self._session = session
        self._queue: SimpleQueue[Callable[[], Event | None]] = SimpleQueue()
        self._opened: deque[tuple[Message, float]] = deque()  # travelled together, wait; and when they arrived
        self._publishers: dict[str, AdvancedPublisher] = {}  # per key; none is ever undeclared
        self._lanes = Lanes()
        self._names: set[str] = set()
        self._left: dict[str, float] = {}  # names that went, and when
        self._answer: Callable[[str, Mapping[str, str]], bytes] | None = None
        self._subscribers: list[Any] = [self._subscribe(topic) for topic in topics_read_by(role)]
        if role is Role.PLANNER:
            self._subscribers.append(
                session.liveliness().declare_subscriber(
                    ALIVE.format(role=role, name="*"), self._on_liveliness, history=True
                )
            )
        self._token = session.liveliness().declare_token(ALIVE.format(role=role, name=name))

    def publish(self, *messages: Message) -> None:
        """Send messages on their topics; blocks while the link is congested.

        Those of one topic and run that follow each other travel together, on the key of the first: to wake every
        thread on the way for each of them costs more CPU time than to read it.
        """
        lot: list[tuple[Message, bytes, float]] = []  # message, encoded, since when
        for message in messages:
            begun = time.monotonic()
            payload = encode(message)
            if lot and not _fits(lot, message, payload):
                self._put(lot)
                lot = []
            lot.append((message, payload, begun))
        if lot:
            self._put(lot)

    def _put(self, lot: Sequence[tuple[Message, bytes, float]]) -> None:
        first = lot[0][0]
        topic = BY_MESSAGE[type(first)]
        key = topic.key_of(first, self._lanes.of(first.run))
        if key not in self._publishers:
            self._publishers[key] = self._publisher(key, min(CACHE_SAMPLES, KEPT_ANSWERS * topic.history))
        self._publishers[key].put(join([payload for _, payload, _ in lot]))
        for message, payload, begun in lot:
            self.stamps.say(message, begun, len(payload))
            if isinstance(message, Checkpoint) and message.ended:
                self.forget(message.run)

    def forget(self, run: str) -> None:
        """A run is over: another may take its keys."""
        self._lanes.leave(run)

    def receive(self, timeout_s: float) -> Event | None:
        """Next event, or None if there is none in time; answers queries meanwhile."""
        self.stamps.rest()
        deadline = time.monotonic() + timeout_s
        while True:
            if (members := self._after_leaving()) is not None:
                return members
            until = min([deadline, *(since + LEFT_S for since in self._left.values())])
            try:
                event = self._next(until)
            except Empty:
                event = None
            if isinstance(event, Checkpoint) and event.ended:
                self.forget(event.run)
            if event is not None or time.monotonic() >= deadline:
                return event

    def _next(self, until: float) -> Event | None:
        """What waits, None for what is no event. Raises Empty if nothing comes until then."""
        if not self._opened:
            return self._queue.get(timeout=max(0.0, until - time.monotonic()))()
        message, arrived = self._opened.popleft()
        self.stamps.hear(message, arrived, time.monotonic())
        return message

    def refuse(self, message: Message, reason: str) -> None:
        """Count and log a message that the core refuses."""
        self.inbox.drop(BY_MESSAGE[type(message)].key_of(message), f"{message.run}: {reason}")

    def serve_queries(self, answer: Callable[[str, Mapping[str, str]], bytes]) -> None:
        """Answer queries with `answer`, in the thread that calls `receive`; its ValueErrors go to the asker."""
        self._answer = answer
        queryable = self._session.declare_queryable(
            QUERY.format(metric="*"), lambda query: self._queue.put(lambda: self._reply(query)), complete=True
        )
        self._subscribers.append(queryable)

    def serve_timing(self, role: Role, name: str) -> None:
        """Say when asked, in the thread that calls `receive`, what was heard and said when."""
        key = TIMING.format(role=role, name=name)
        queryable = self._session.declare_queryable(
            key, lambda query: self._queue.put(lambda: self._reply_stamps(query, key)), complete=True
        )
        self._subscribers.append(queryable)

    def alive(self) -> dict[Role, list[str]]:
        """Names of the processes that are alive, by role."""
        there: dict[Role, list[str]] = {}
        for reply in self._session.liveliness().get(ALIVE.format(role="*", name="*"), timeout=1.0):
            if reply.ok is not None:
                role, name = str(reply.ok.key_expr).split("/")[-2:]
                if role in set(Role):
                    there.setdefault(Role(role), []).append(name)
        return there

    def close(self) -> None:
        """Leave: first the subscribers, whose callbacks must not outlive the session."""
        if self._session.is_closed():
            return
        self._token.undeclare()
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._session.close()

    def _subscribe(self, topic: Topic) -> Any:
        # On the transport's own thread: one thread less to wake for each message. It only enqueues.
        enqueue: Any = zenoh.handlers.Callback(
            lambda sample: self._enqueue(str(sample.key_expr), sample.payload.to_bytes()), indirect=False
        )
        subscriber = declare_advanced_subscriber(
            self._session,
            topic.pattern,
            enqueue,
            history=HistoryConfig(detect_late_publishers=True, max_samples=topic.history),
            recovery=RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        subscriber.sample_miss_listener(lambda miss: self._queue.put(lambda: self._on_miss(topic.pattern, miss.nb)))
        return subscriber

    def _enqueue(self, key: str, payload: bytes) -> None:
        arrived = time.monotonic()
        self._queue.put(lambda: self._open(key, payload, arrived))

    def _open(self, key: str, payload: bytes, arrived: float) -> Message | None:
        taken, messages = time.monotonic(), self.inbox.open(key, payload)
        if not messages:
            return None
        self._opened += [(message, arrived) for message in messages[1:]]
        self.stamps.hear(messages[0], arrived, taken)
        return messages[0]

    def _on_miss(self, pattern: str, count: int) -> None:
        self.missed += count
        log.warning("%d messages on %s are lost; what is needed of them will be said again", count, pattern)

    def _publisher(self, key: str, n_kept: int) -> AdvancedPublisher:
        return declare_advanced_publisher(
            self._session,
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
            cache=CacheConfig(max_samples=n_kept),
            sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
            publisher_detection=True,
        )

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        name, came = str(sample.key_expr).split("/")[-1], sample.kind == zenoh.SampleKind.PUT
        self._queue.put(lambda: self._came(name) if came else self._went(name))

    def _came(self, name: str) -> Membership | None:
        self._left.pop(name, None)
        if name in self._names:
            return None
        self._names.add(name)
        return Membership(Role.PLANNER, tuple(sorted(self._names)))

    def _went(self, name: str) -> None:
        if name in self._names:
            self._left[name] = time.monotonic()

    def _after_leaving(self) -> Membership | None:
        if self._left and not self._session.info.routers_zid():  # it is we who are cut off
            self._left = dict.fromkeys(self._left, time.monotonic())
        gone = {name for name, since in self._left.items() if time.monotonic() - since >= LEFT_S}
        if not gone:
            return None
        self._names -= gone
        self._left = {name: since for name, since in self._left.items() if name not in gone}
        return Membership(Role.PLANNER, tuple(sorted(self._names)))

    def _reply_stamps(self, query: zenoh.Query, key: str) -> None:
        with query:  # the question may be for all processes; the answer is on a key of our own
            query.reply(key, self.stamps.of(_parameters(str(query.parameters)).get("run", "")))

    def _reply(self, query: zenoh.Query) -> None:
        with query:
            metric = str(query.key_expr).split("/")[-1]
            try:
                if self._answer is None:
                    raise ValueError("this process answers no queries")
                answer = self._answer(metric, _parameters(str(query.parameters)))
            except ValueError as error:
                query.reply_err(str(error).encode())
            except Exception as error:
                log.exception("query %s failed", query.selector)
                query.reply_err(f"{type(error).__name__}: {error}".encode())
            else:
                query.reply(query.key_expr, answer)


def _fits(lot: Sequence[tuple[Message, bytes, float]], message: Message, payload: bytes) -> bool:
    """Whether a message may travel with those of a lot."""
    first, n_byte = lot[0][0], sum(len(encoded) for _, encoded, _ in lot)
    alike = type(first) is type(message) and first.run == message.run
    return alike and len(lot) < MAX_LOT and n_byte + len(payload) <= LOT_BYTES


def _parameters(text: str) -> dict[str, str]:
    pairs = (pair.partition("=") for pair in text.split(";") if pair)
    return {key: unquote(value) for key, _, value in pairs}
