"""The bus over Zenoh: every process is a client of one router. The only module that imports zenoh.

Publishers and subscribers are "advanced" ones: the publisher keeps its last samples, the subscriber notices a gap and
fetches what is missing, a late joiner gets the history. Blocking alone loses messages when a link freezes.
"""

import json
import logging
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from queue import Empty, SimpleQueue
from typing import Any
from urllib.parse import quote, unquote

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

from shared.messages import Checkpoint, Event, Members, Message
from shared.topics import ALIVE, BY_MESSAGE, CACHE_SAMPLES, QUERY, TIMING, Role, Topic, topics_read_by
from shared.wire.bus import Inbox
from shared.wire.codec import encode
from shared.wire.stamps import Stamps, Timing

log = logging.getLogger(__name__)

Session = zenoh.Session

HEARTBEAT_S = 0.2  # how soon a lost last sample is noticed
LEASE_MS = 2000  # a silent process counts as gone after this
LEFT_S = 3.0  # a process that went is reported gone after this: a router's restart hides everybody for up to 2.8 s
ENDED_RUNS = 16  # runs whose caches are kept after their end, for readers that are late
KEPT_ANSWERS = 8  # messages of a topic of which only the newest counts: what a reader can miss and still recover
RETRY_S = 0.1
POLL_S = 0.002  # for the replies to a query
OPEN_MS = 500  # per attempt: a blocking open would not notice a signal


class NoAnswer(RuntimeError):
    """Nobody answered a query in time."""


class BadRequest(RuntimeError):
    """The answer to a query is that it cannot be answered; the text is the answerer's."""


def open_session(endpoints: Sequence[str], within_s: float | None, check: Callable[[], None]) -> zenoh.Session:
    """Connect to one of the routers at `endpoints`, trying again until one is there.

    `check` is called between attempts and may raise to give up. Raises ConnectionError after `within_s`.
    """
    deadline = None if within_s is None else time.monotonic() + within_s
    where = ", ".join(endpoints)
    retry = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    try:
        config = _config(
            "client", connect__endpoints=list(endpoints), connect__timeout_ms=OPEN_MS, connect__retry=retry
        )
    except zenoh.ZError:
        raise ConnectionError(f"{where}: not an endpoint, such as tcp/127.0.0.1:7447") from None
    log.info("looking for a router at %s", where)
    while True:
        check()
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if deadline is not None and time.monotonic() > deadline:
                raise ConnectionError(f"no Zenoh router at {where} within {within_s:g} s: {_reason(error)}") from None
        time.sleep(RETRY_S)


def run_router(listen: str, stop: threading.Event) -> None:
    """Be a Zenoh router until `stop` is set; raises ConnectionError if it cannot listen."""
    try:
        session = zenoh.open(_config("router", listen__endpoints=[listen]))
    except zenoh.ZError as error:
        raise ConnectionError(f"cannot listen on {listen}: {_reason(error)}") from None
    key, nothing = TIMING.format(role=Role.ROUTER, name="router"), Stamps()

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, nothing.of(""))

    with session:
        session.declare_queryable(key, answer, complete=True)
        stop.wait()


def free_port() -> int:
    """A TCP port on the loopback interface that nobody listens on just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def ask(
    session: zenoh.Session,
    metric: str,
    parameters: Mapping[str, str],
    timeout_s: float,
    check: Callable[[], None] = lambda: None,
) -> bytes:
    """Answer of the metrics service to a query.

    An empty reply is asked again until the time is over, since a service that has just started gives one. `check` is
    called all the while and may raise to give up. Raises NoAnswer, or BadRequest with the service's reason.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]+", metric):
        raise BadRequest(f"metric = {metric!r}: not a name")
    selector = zenoh.Selector(QUERY.format(metric=metric), ";".join(f"{k}={quote(v)}" for k, v in parameters.items()))
    deadline = time.monotonic() + timeout_s
    while (left := deadline - time.monotonic()) > 0:
        for reply in _replies(session.get(selector, timeout=left), check):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            if reply.err is not None and (text := reply.err.payload.to_string()) != "Timeout":
                raise BadRequest(text)
        time.sleep(POLL_S)
    raise NoAnswer(f"nobody answered {metric} within {timeout_s:g} s")


def ask_timing(session: zenoh.Session, run: str, timeout_s: float) -> dict[str, Timing]:
    """What every process says of a run's messages and of its own CPU time, by the process's name."""
    selector = zenoh.Selector(TIMING.format(role="*", name="*"), f"run={quote(run)}")
    found: dict[str, Timing] = {}
    for reply in session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout_s):
        if reply.ok is not None:
            found[str(reply.ok.key_expr).rsplit("/", 1)[-1]] = Timing.read(reply.ok.payload.to_bytes())
    return found


def _replies(channel: Any, check: Callable[[], None]) -> Iterator[zenoh.Reply]:
    """Replies as they come. A blocking read of the channel would not let the asker give up."""
    while True:
        check()
        try:
            reply = channel.try_recv()
        except zenoh.ZError:  # empty, and no more will come
            return
        if reply is None:
            time.sleep(POLL_S)
        else:
            yield reply


class ZenohBus:
    """One process's connection over a session, which it owns."""

    def __init__(self, session: zenoh.Session, role: Role, name: str) -> None:
        """Subscribe to what the role reads, then show the process alive."""
        self.inbox = Inbox()
        self.stamps = Stamps()
        self.missed = 0  # samples that could not be recovered
        self._session = session
        self._queue: SimpleQueue[Callable[[], Event | None]] = SimpleQueue()
        self._publishers: dict[str, dict[str, AdvancedPublisher]] = {}  # per run and key
        self._ended: deque[str] = deque()
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

    def publish(self, message: Message) -> None:
        """Send a message on its topic; blocks while the link is congested."""
        begun, topic = time.monotonic(), BY_MESSAGE[type(message)]
        key, publishers = topic.key_of(message), self._publishers.setdefault(message.run, {})
        if key not in publishers:
            publishers[key] = self._publisher(key, min(CACHE_SAMPLES, KEPT_ANSWERS * topic.history))
        payload = encode(message)
        publishers[key].put(payload)
        self.stamps.say(message, begun, len(payload))
        if isinstance(message, Checkpoint) and message.ended:
            self.forget(message.run)

    def forget(self, run: str) -> None:
        """A run is over: its messages need not be kept. Those of the last few runs are, for readers that are late."""
        if run not in self._ended:
            self._ended.append(run)
        if len(self._ended) > ENDED_RUNS:
            for publisher in self._publishers.pop(self._ended.popleft(), {}).values():
                publisher.undeclare()

    def receive(self, timeout_s: float) -> Event | None:
        """Next event, or None if there is none in time; answers queries meanwhile."""
        self.stamps.rest()
        deadline = time.monotonic() + timeout_s
        while True:
            if (members := self._after_leaving()) is not None:
                return members
            until = min([deadline, *(since + LEFT_S for since in self._left.values())])
            try:
                event = self._queue.get(timeout=max(0.0, until - time.monotonic()))()
            except Empty:
                event = None
            if isinstance(event, Checkpoint) and event.ended:
                self.forget(event.run)
            if event is not None or time.monotonic() >= deadline:
                return event

    def refuse(self, message: Message, reason: str) -> None:
        """Count and log a message that the core refuses."""
        self.inbox.drop(BY_MESSAGE[type(message)].key_of(message), reason)

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
        taken, message = time.monotonic(), self.inbox.open(key, payload)
        if message is not None:
            self.stamps.hear(message, arrived, taken)
        return message

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

    def _came(self, name: str) -> Members | None:
        self._left.pop(name, None)
        if name in self._names:
            return None
        self._names.add(name)
        return Members(Role.PLANNER, tuple(sorted(self._names)))

    def _went(self, name: str) -> None:
        if name in self._names:
            self._left[name] = time.monotonic()

    def _after_leaving(self) -> Members | None:
        if self._left and not self._session.info.routers_zid():  # it is we who are cut off
            self._left = dict.fromkeys(self._left, time.monotonic())
        gone = {name for name, since in self._left.items() if time.monotonic() - since >= LEFT_S}
        if not gone:
            return None
        self._names -= gone
        self._left = {name: since for name, since in self._left.items() if name not in gone}
        return Members(Role.PLANNER, tuple(sorted(self._names)))

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


def _reason(error: zenoh.ZError) -> str:
    """The first line of Zenoh's error, without the places in its sources."""
    return str(error).partition(" at /")[0].strip()


def _parameters(text: str) -> dict[str, str]:
    pairs = (pair.partition("=") for pair in text.split(";") if pair)
    return {key: unquote(value) for key, _, value in pairs}


def _config(mode: str, **settings: object) -> zenoh.Config:
    """Configuration of a session: explicit endpoints only, no discovery, no shared memory."""
    config = zenoh.Config()
    fixed: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/unicast/open_timeout": 1000,  # ms; with the next, leaving takes half a second even if nobody answers
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,  # us
    }
    for key, value in {**fixed, **{key.replace("__", "/"): value for key, value in settings.items()}}.items():
        config.insert_json5(key, json.dumps(value))
    return config
