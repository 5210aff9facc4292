"""What is said: every topic on one page. Keys are spelled nowhere else."""

from dataclasses import dataclass
from enum import StrEnum

from shared.messages import Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform


class Role(StrEnum):
    """Who speaks; `services.topology` says how each is started."""

    OPERATOR = "operator"
    ROUTER = "router"
    EMULATOR = "emulator"
    PLANNER = "planner"
    ALLOCATOR = "allocator"
    METRICS = "metrics"


class Delivery(StrEnum):
    """How hard the transport tries."""

    LOOP = "loop"  # blocks, is cached and recovered: the loop stands still without it
    OBSERVE = "observe"  # may be dropped towards a slow reader


@dataclass(frozen=True)
class Topic:
    """One kind of message: its key, its one producer role, its readers."""

    key: str  # {field} is filled from the message
    message: type[Message]
    producer: Role
    readers: tuple[Role, ...]
    delivery: Delivery = Delivery.LOOP

    @property
    def name(self) -> str:
        """Lower-case message name, used in envelopes, logs and the store."""
        return self.message.__name__.lower()

    @property
    def pattern(self) -> str:
        """Key expression that matches every run and index of the topic."""
        return "/".join("*" if chunk.startswith("{") else chunk for chunk in self.key.split("/"))

    def key_of(self, message: Message) -> str:
        """Key this message is published on."""
        return self.key.format(**{name: getattr(message, name) for name in ("run", "target") if hasattr(message, name)})


_E, _P, _A, _M = Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.METRICS

TOPICS = (
    Topic("cogradar/run/{run}/start", RunStart, Role.OPERATOR, (_E, _P, _A, _M)),
    Topic("cogradar/run/{run}/scan", Scan, _E, (_P, _M)),
    Topic("cogradar/run/{run}/truth", Truth, _E, (_M,)),
    Topic("cogradar/run/{run}/plan/{target}", Plan, _P, (_A, _M)),
    Topic("cogradar/run/{run}/waveform", Waveform, _A, (_E, _M)),
    Topic("cogradar/run/{run}/end", RunEnd, _E, (_P, _A, _M, Role.OPERATOR)),
)

BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}

ALIVE = "cogradar/alive/{role}/{name}"  # liveliness token of a process
QUERY = "cogradar/query/{metric}"  # queryable of the metrics service


def topics_read_by(role: Role) -> tuple[Topic, ...]:
    """Topics this role subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)
