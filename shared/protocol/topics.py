"""Every topic on one page. Keys are spelled nowhere else."""

import re
from dataclasses import dataclass
from enum import StrEnum

from shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    Message,
    Plan,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from shared.protocol.recovery import History, ScanRecall, Snapshot, WaveformRecall


class Role(StrEnum):
    """What a process is; `services.topology` says how each is started."""

    OPERATOR = "operator"
    ROUTER = "router"
    EMULATOR = "emulator"
    PLANNER = "planner"
    ALLOCATOR = "allocator"
    RECORDER = "recorder"
    METRICS = "metrics"


@dataclass(frozen=True)
class Topic:
    """One kind of message: its key, its one producer role, its readers."""

    key: str  # with {fields} of the message
    message: type[Message]
    producer: Role
    readers: tuple[Role, ...]

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
        fields = {name: getattr(message, name) for name in ("run", "target", "topic") if hasattr(message, name)}
        return self.key.format(**fields)


_E, _P, _A, _R, _M = Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.RECORDER, Role.METRICS

# Keys are never declared: the transport would keep each of them for ever (docs/adr/0013-plain-publishers.md).
TOPICS = (
    Topic("cogradar/run/{run}/start", RunStart, Role.OPERATOR, (_R,)),
    Topic("cogradar/run/{run}/cancel", RunCancel, Role.OPERATOR, (_R,)),
    Topic("cogradar/run/{run}/checkpoint", Checkpoint, _R, (_P, _A, _M, Role.OPERATOR)),
    Topic("cogradar/run/{run}/checkpoint/emulator", EmulatorCheckpoint, _R, (_E,)),
    Topic("cogradar/run/{run}/scan", Scan, _E, (_P, _R)),
    Topic("cogradar/run/{run}/truth", Truth, _E, (_R,)),
    Topic("cogradar/run/{run}/plan/{target}", Plan, _P, (_A, _R)),
    Topic("cogradar/run/{run}/waveform", Waveform, _A, (_E, _R)),
    Topic("cogradar/run/{run}/snapshot", Snapshot, _P, (_R,)),
    Topic("cogradar/run/{run}/end", RunEnd, _E, (_R,)),
    Topic("cogradar/run/{run}/recall/scan", ScanRecall, _P, (_R,)),
    Topic("cogradar/run/{run}/recall/waveform", WaveformRecall, _E, (_R,)),
    Topic("cogradar/run/{run}/history/{topic}", History, _R, (_E, _P)),
)

BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}

ALIVE = "cogradar/alive/{role}/{name}"  # liveliness token of a process
QUERY = "cogradar/query/{metric}"  # queryable of the metrics service
TIMESTAMPS = "cogradar/timestamps/{role}/{name}"  # queryable of every process: when it received and sent what
EXPOSITION = "cogradar/exposition/{role}/{name}"  # queryable of every process: its metrics, as Prometheus reads them


def topics_read_by(role: Role) -> tuple[Topic, ...]:
    """Topics this role subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)


def topic_of(key: str) -> str:
    """Name of the topic that a key belongs to; "other" if to none."""
    for topic in TOPICS:
        pattern = "[^/]+".join(re.escape(part) for part in re.split(r"\{\w+\}", topic.key))
        if re.fullmatch(pattern, key):
            return topic.name
    return "other"
