"""How a process reaches the others: the protocol, and the local queue for cores that share one process."""

import logging
from collections import Counter, deque
from typing import Protocol

from shared.protocol.events import Event, Membership
from shared.protocol.messages import Message
from shared.protocol.topics import BY_MESSAGE, Role, is_for, topic_of, topics_read_by
from shared.wire.codec import BadMessage, decode, encode, split

log = logging.getLogger(__name__)


class Bus(Protocol):
    """One process's connection. Everything arrives in one queue, read by the one thread that owns the core."""

    def publish(self, *messages: Message) -> None:
        """Send messages on their topics, in order; those of one topic may travel together."""

    def receive(self, timeout_s: float) -> Event | None:
        """Next event, or None if there is none in time. Bad messages are dropped, counted, and logged once a key."""

    def refuse(self, message: Message, reason: str) -> None:
        """Drop a message that the core refuses, like a bad one."""

    def close(self) -> None:
        """Leave, within two seconds."""


LOCAL = "local"  # build of the cores that share one process
MAX_BAD_KEYS = 100  # counted apart; a faulty sender may use ever new keys
OTHER_KEYS = "other keys"


class Inbox:
    """Decodes what arrives; drops, counts and logs what is no valid message."""

    def __init__(self, build: str | None = None) -> None:
        """`build` of the senders; None: of any, for who only watches."""
        self._build = build
        self.bad: Counter[str] = Counter()  # per key; of the keys beyond the first hundred together
        self.bad_of_topic: Counter[str] = Counter()

    def open(self, key: str, payload: bytes) -> list[Message]:
        """Messages of a payload that came on `key`: none if it is bad, several if they travelled together."""
        try:
            messages = [decode(one) for one in split(payload)]
        except BadMessage as error:
            self.drop(key, str(error))
            return []
        # A lot is on the key of its first message.
        kinds = {(type(message), message.run) for message in messages}
        if len(kinds) > 1 or not self._is_key_of(messages[0], key):
            self.drop(key, "the message belongs on another key")
            return []
        return messages

    def _is_key_of(self, message: Message, key: str) -> bool:
        build = next(iter(key.split("/")[2:]), "") if self._build is None else self._build
        return key == BY_MESSAGE[type(message)].key_of(message, build)

    def drop(self, key: str, reason: str) -> None:
        """Count a message that is dropped; the first on a key is logged."""
        self.bad_of_topic[topic_of(key)] += 1
        if key not in self.bad and len(self.bad) >= MAX_BAD_KEYS:
            key = OTHER_KEYS
        self.bad[key] += 1
        if self.bad[key] == 1:
            log.warning("dropping bad messages on %s, the first: %s", key, reason)


class LocalBus:
    """Endpoint of a LocalNetwork."""

    def __init__(self, network: "LocalNetwork", role: Role, name: str) -> None:
        self.role, self.name = role, name
        self.queue: deque[tuple[str, bytes] | Membership] = deque()
        self.reads = {topic.message for topic in topics_read_by(role)}
        self.inbox = Inbox(LOCAL)
        self._network = network

    def publish(self, *messages: Message) -> None:
        """Put the encoded messages into every reader's queue."""
        for message in messages:
            self._network.deliver(message)

    def receive(self, timeout_s: float) -> Event | None:  # noqa: ARG002 - nothing can arrive while we wait
        """Next event, or None if the queue is empty."""
        while self.queue:
            item = self.queue.popleft()
            if isinstance(item, Membership):
                return item
            for message in self.inbox.open(*item):  # one at most: there are no lots here
                return message
        return None

    def refuse(self, message: Message, reason: str) -> None:
        """Count and log a message that the core refuses."""
        self.inbox.drop(BY_MESSAGE[type(message)].key_of(message, LOCAL), f"{message.run}: {reason}")

    def close(self) -> None:
        """Leave the network."""
        self._network.endpoints.remove(self)


class LocalNetwork:
    """Endpoints in one process. Messages are encoded and decoded as on the wire, and arrive in the order sent."""

    def __init__(self) -> None:
        self.endpoints: list[LocalBus] = []

    def endpoint(self, role: Role, name: str) -> LocalBus:
        """A new endpoint; planners are told of all planners."""
        bus = LocalBus(self, role, name)
        self.endpoints.append(bus)
        if role is Role.PLANNER:
            planners = [other for other in self.endpoints if other.role is role]
            for other in planners:
                other.queue.append(Membership(role, tuple(sorted(planner.name for planner in planners))))
        return bus

    def deliver(self, message: Message) -> None:
        """Queue a message at everybody who reads its topic."""
        item = (BY_MESSAGE[type(message)].key_of(message, LOCAL), encode(message))
        for bus in self.endpoints:
            if type(message) in bus.reads and is_for(message, bus.role, bus.name):
                bus.queue.append(item)
