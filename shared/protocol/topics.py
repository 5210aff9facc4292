"""What is said: every topic on one page. Keys are spelled nowhere else."""

from dataclasses import dataclass
from enum import StrEnum

from shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    History,
    Message,
    Plan,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    ScanRecall,
    Snapshot,
    Truth,
    Waveform,
    WaveformRecall,
)

CACHE_SAMPLES = 512  # messages of each key that a publisher keeps, for readers that come late or missed some


class Role(StrEnum):
    """Who speaks; `services.topology` says how each is started."""

    OPERATOR = "operator"
    ROUTER = "router"
    EMULATOR = "emulator"
    PLANNER = "planner"
    ALLOCATOR = "allocator"
    METRICS = "metrics"


@dataclass(frozen=True)
class Topic:
    """One kind of message: its key, its one producer role, its readers."""

    key: str  # {lane} is the sender's choice, one for all that it says of a run; other {fields} are the message's
    message: type[Message]
    producer: Role
    readers: tuple[Role, ...]
    history: int = CACHE_SAMPLES  # newest messages of each key that a reader gets that comes late

    @property
    def name(self) -> str:
        """Lower-case message name, used in envelopes, logs and the store."""
        return self.message.__name__.lower()

    @property
    def pattern(self) -> str:
        """Key expression that matches every lane and index of the topic."""
        return "/".join("*" if chunk.startswith("{") else chunk for chunk in self.key.split("/"))

    def key_of(self, message: Message, lane: int | str = 0) -> str:
        """Key this message is published on."""
        fields = {name: getattr(message, name) for name in ("target", "topic") if hasattr(message, name)}
        return self.key.format(lane=lane, **fields)

    def may_carry(self, key: str, message: Message) -> bool:
        """Whether the message may come on this key, whatever its lane."""
        return key == self.key_of(message, lane=key.split("/", 3)[2] if key.count("/") > 2 else "")


_E, _P, _A, _M = Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.METRICS

# No key names a run: the transport never frees a key that was once declared, and keeps some kilobytes of it at both
# ends and in the router. Lanes are few, and a run takes one that another run has left (docs/adr/0012-lanes.md).
TOPICS = (
    Topic("cogradar/lane/{lane}/start", RunStart, Role.OPERATOR, (_M,), history=1),
    Topic("cogradar/lane/{lane}/cancel", RunCancel, Role.OPERATOR, (_M,), history=1),
    Topic("cogradar/lane/{lane}/checkpoint", Checkpoint, _M, (_P, _A), history=1),
    Topic("cogradar/lane/{lane}/checkpoint/emulator", EmulatorCheckpoint, _M, (_E,), history=1),
    Topic("cogradar/lane/{lane}/scan", Scan, _E, (_P, _M)),
    Topic("cogradar/lane/{lane}/truth", Truth, _E, (_M,)),
    Topic("cogradar/lane/{lane}/plan/{target}", Plan, _P, (_A, _M)),
    Topic("cogradar/lane/{lane}/waveform", Waveform, _A, (_E, _M)),
    Topic("cogradar/lane/{lane}/snapshot", Snapshot, _P, (_M,), history=1),
    Topic("cogradar/lane/{lane}/end", RunEnd, _E, (_M,)),
    Topic("cogradar/lane/{lane}/recall/scan", ScanRecall, _P, (_M,), history=1),
    Topic("cogradar/lane/{lane}/recall/waveform", WaveformRecall, _E, (_M,), history=1),
    Topic("cogradar/lane/{lane}/history/{topic}", History, _M, (_E, _P), history=1),
)

BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}

ALIVE = "cogradar/alive/{role}/{name}"  # liveliness token of a process
QUERY = "cogradar/query/{metric}"  # queryable of the metrics service
TIMING = "cogradar/timing/{role}/{name}"  # queryable of every process: when it heard and said what


def topics_read_by(role: Role) -> tuple[Topic, ...]:
    """Topics this role subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)
