"""Every topic on one page. Keys are spelled nowhere else.

Within a run the processes of one build hear only each other. The key of all that they say begins with their build, so
that a planner of another one can neither own tracks nor give an answer whose bits differ. A client that begins a run or
asks for results need only speak the same protocol.
"""

import re
import zlib
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import (
    Checkpoint,
    Command,
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
from cogradar.shared.protocol.recovery import (
    Handover,
    History,
    NoPlans,
    NoWaveforms,
    ScanRecall,
    Snapshot,
    WaveformRecall,
)
from cogradar.shared.protocol.slots import ALL_SLOTS

PROTOCOL = 10  # of messages and keys; tests/shared/wire/test_contract.py says when it must be raised
_ROOT = f"cogradar/{PROTOCOL}"


class Role(StrEnum):
    """What a process is; `cogradar.services.topology` says how each is started."""

    OPERATOR = "operator"
    ROUTER = "router"
    EMULATOR = "emulator"
    PLANNER = "planner"
    ALLOCATOR = "allocator"
    RECORDER = "recorder"
    METRICS = "metrics"


FRONT_END = "frontend"  # has a certificate, and is no process of ours: it answers the emulator


class GivesWay(StrEnum):
    """Which message of a topic is dropped when no more of it may wait at a reader.

    None is lost for good: its sender redelivers it, or says something newer. Nor may the sender be made to wait, as it
    would be by a full queue of the transport: that stops all senders to the reader.
    """

    ARRIVING = "arriving"  # its sender redelivers in order
    OLDEST = "oldest"  # what is newer mostly stands for it; of another run, it is repeated or redelivered


def name_of(message: type[Message]) -> str:
    """Lower-case name of a message, used in envelopes, logs and the store."""
    return message.__name__.lower()


def schema_of(message: type[Message]) -> str:
    """Identifier of a message's schema; another version of the protocol has others."""
    return f"urn:cogradar:{PROTOCOL}:{name_of(message)}"


def encoding_of(message: type[Message]) -> str:
    """Zenoh's encoding of a message, for tools that read no MessagePack; no receiver looks at it."""
    return f"application/msgpack;schema={schema_of(message)}"


@dataclass(frozen=True)
class Delivery:
    """How a message gets to all its readers, as a document says it."""

    until: str  # its sender repeats it
    late: str = "It learns from the next checkpoint what it needs."  # process


KEPT = Delivery(
    "Its sender keeps it until a checkpoint has a higher k, and sends it again when one has `resend`.",
    "It begins at the last checkpoint, and recalls what it lacks of the dwells before.",
)
UNTIL_CHECKPOINT = Delivery("Its sender repeats it until a checkpoint of the run arrives.")
UNTIL_ENDED = Delivery("Its sender repeats it until a checkpoint has `ended`.")
UNTIL_DECIDED = Delivery("Its sender repeats it, with the same id, until the journal says granted or refused.")
UNTIL_HELD = Delivery("Its sender says it after each checkpoint as long as it holds.")
UNTIL_ANSWERED = Delivery("Its sender repeats it at some later checkpoint until a history has what it lacks.")
NEWEST = Delivery(
    "The newest one stands for all before it. It is repeated each second in which no dwell is completed, each fourth"
    " second while other runs go on.",
    "The next one says all that it needs.",
)
ONCE = Delivery("It is sent once. A process that still lacks something recalls it.")


@dataclass(frozen=True)
class Topic:
    """One kind of message: its key, its one producer role, its readers, its redelivery, and what gives way at a slow
    reader.
    """

    end: str  # of its key, with {fields} of the message and the {slots} of a planner
    message: type[Message]
    producer: Role
    readers: tuple[Role, ...]
    delivery: Delivery = KEPT
    gives_way: GivesWay = GivesWay.ARRIVING

    @property
    def name(self) -> str:
        """Lower-case message name, used in envelopes, logs and the store."""
        return name_of(self.message)

    @property
    def schema(self) -> str:
        """Identifier of its messages' schema; another version of the protocol has others."""
        return schema_of(self.message)

    @property
    def encoding(self) -> str:
        """Zenoh's encoding of each of its samples, for tools that read no MessagePack; no receiver looks at it."""
        return encoding_of(self.message)

    @property
    def key(self) -> str:
        """Its key, with the {build} of a sender that takes part in runs, and what `end` has."""
        return f"{_ROOT}/" + ("" if self.producer is Role.OPERATOR else "{build}/") + self.end

    def pattern(self, build: str, to: str = "*", slots: str = "*") -> str:
        """Key expression that matches every run of the topic; of what is addressed, that `to` a process; of what
        planners say of tracks, planners with these slots.
        """
        known = {"{build}": build, "{to}": to, "{slots}": slots}
        return "/".join(known.get(chunk, "*") if chunk.startswith("{") else chunk for chunk in self.key.split("/"))

    def key_of(self, message: Message, build: str, slots: str = ALL_SLOTS) -> str:
        """Key this message is published on by a process of a build; by a planner, with its slots."""
        said = vars(message)  # to ask a model for what it lacks takes long
        return self.key.format(build=build, slots=slots, run=said["run"], to=said.get("to"))

    def slots_on(self, key: str) -> str:
        """Slots that a key of this topic names; all if it has no such part."""
        return key.rpartition("/")[2] if self.end.endswith("{slots}") else ALL_SLOTS


_E, _P, _A, _R, _M = Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.RECORDER, Role.METRICS

# Keys are never declared: the transport would keep each of them for ever (docs/adr/0013-plain-publishers.md).
TOPICS = (
    Topic("run/{run}/start", RunStart, Role.OPERATOR, (_R,), UNTIL_CHECKPOINT),
    Topic("run/{run}/cancel", RunCancel, Role.OPERATOR, (_R,), UNTIL_ENDED),
    Topic("run/{run}/command", Command, Role.OPERATOR, (_R,), UNTIL_DECIDED),
    Topic("run/{run}/checkpoint", Checkpoint, _R, (_P, _A, _R, _M, Role.OPERATOR), NEWEST, GivesWay.OLDEST),
    Topic("run/{run}/checkpoint/emulator", EmulatorCheckpoint, _R, (_E,), NEWEST, GivesWay.OLDEST),
    Topic("run/{run}/scan", Scan, _E, (_P, _A, _R)),
    Topic("run/{run}/truth", Truth, _E, (_R,)),
    Topic("run/{run}/plan/{slots}", Plan, _P, (_A, _R)),
    Topic("run/{run}/waveform", Waveform, _A, (_E, _R), gives_way=GivesWay.OLDEST),
    Topic("run/{run}/handover/{slots}", Handover, _P, (_P,), UNTIL_HELD),
    Topic("run/{run}/snapshot/{slots}", Snapshot, _P, (_R,), ONCE),
    Topic("run/{run}/end", RunEnd, _E, (_R,), UNTIL_ENDED),
    Topic("run/{run}/noplans/{slots}", NoPlans, _P, (_P, _R), UNTIL_HELD),
    Topic("run/{run}/nowaveforms", NoWaveforms, _A, (_R,), UNTIL_HELD),
    Topic("run/{run}/recall/scan/{slots}", ScanRecall, _P, (_R,), UNTIL_ANSWERED),
    Topic("run/{run}/recall/waveform", WaveformRecall, _E, (_R,), UNTIL_ANSWERED),
    Topic("run/{run}/history/{to}", History, _R, (_E, _P, _A), ONCE),
)

BY_NAME = {topic.name: topic for topic in TOPICS}
BY_MESSAGE = {topic.message: topic for topic in TOPICS}

PARTS_OF_KEYS = {
    "build": "digest of the sender's program and of what its machine computes: a radar's processes have one",
    "run": "name of the run",
    "slots": "FIRST-LAST of 16 slots of tracks that the planner is for; 0-15: all",
    "to": "name of the planner that is answered, or emulator, or allocator",
    "protocol": "version of messages and keys",
    "role": "of the process",
    "name": "of the process, or of the front end",
    "moment": "when the process began, nanoseconds since 1970, and eight random hexadecimal digits",
    "shard": "0 to 15, CRC-32 of the run's name modulo 16; or any-KIND: the process is there, with a front end of KIND",
    "metric": "what is asked for, such as runs; its parameters follow the key, NAME=VALUE;NAME=VALUE",
}


@dataclass(frozen=True)
class Queryable:
    """What processes answer when they are asked: the key of the questions, the encoding of the answers."""

    key: str
    answerers: tuple[str, ...]  # roles, and others that have certificates
    encoding: str
    meaning: str


@dataclass(frozen=True)
class Exchange(Queryable):
    """A question of the emulator to a front end in a process of its own, and the answer, as messages."""

    question: type[Message]
    answer: type[Message]
    has_data: bool = False  # the answer may be the attachment of Y, which then is the payload

    @classmethod
    def of(cls, end: str, question: type[Message], answer: type[Message], *, has_data: bool = False) -> Self:
        """The exchange whose key has this end."""
        meaning = f"a front end in any language: {question.__name__} in, {answer.__name__} out"
        key = f"{_ROOT}/front-end/{{name}}/{end}"
        return cls(key, (FRONT_END,), encoding_of(answer), meaning, question, answer, has_data)

    def key_of(self, name: str) -> str:
        """Key of a front end's queryable."""
        return self.key.format(name=name)


FRONT_END_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,47}"
OPENING = Exchange.of("opening", Opening, Hello)
DWELL = Exchange.of("dwell", Transmit, Received, has_data=True)
EXCHANGES = (OPENING, DWELL)

ALIVE = "cogradar/alive/{protocol}/{build}/{role}/{name}"  # liveliness token of a process
# Liveliness token of a process that wants to be the only one of its role, or where there may be several of its name: of
# several the lowest moment, in text, stays.
CLAIM = "cogradar/claim/{protocol}/{role}/{moment}/{name}"
# Liveliness tokens of a process of a pool: one for each shard that it claims, and one that says that it is there.
SHARE = "cogradar/share/{protocol}/{build}/{role}/{shard}/{moment}/{name}"
QUERY = f"{_ROOT}/query/{{metric}}"
TIMESTAMPS = f"{_ROOT}/timestamps/{{role}}/{{name}}"
EXPOSITION = f"{_ROOT}/exposition/{{role}}/{{name}}"
LINK = f"{_ROOT}/link/{{role}}/{{name}}"

QUERYABLES = (
    Queryable(QUERY, (_M,), "application/json", "what is known of runs"),
    Queryable(TIMESTAMPS, tuple(Role), "application/json", "when a process received and sent its newest messages"),
    Queryable(EXPOSITION, tuple(Role), "text/plain;version=0.0.4", "metrics of a process, as Prometheus reads them"),
    Queryable(
        LINK,
        (Role.ROUTER,),
        "text/plain",
        "whether it sees a process: seen or unseen, and its ID",
    ),
    *EXCHANGES,
)

KINDS = (*BY_MESSAGE, *(kind for one in EXCHANGES for kind in (one.question, one.answer)))  # of messages


def topics_read_by(role: Role) -> tuple[Topic, ...]:
    """Topics this role subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)


N_SHARD = 16  # over which the processes of a pool share the runs
ALL_SHARDS = frozenset(range(N_SHARD))


def shard_of(run: str) -> int:
    """The shard of a run: the CRC-32 of its name modulo 16."""
    return zlib.crc32(run.encode()) % N_SHARD


def run_on(key: str) -> str:
    """The run that a key of a radar's process names; "": none."""
    chunks = key.split("/")
    return chunks[4] if len(chunks) > 4 and chunks[3] == "run" else ""


def is_for(message: Message, role: Role, name: str) -> bool:
    """Whether a process that reads a message's topic receives it."""
    to = vars(message).get("to")
    return to is None or to == (name if role is Role.PLANNER else role)


def topic_of(key: str) -> str:
    """Name of the topic that a key belongs to; "other" if to none."""
    for topic in TOPICS:
        pattern = "[^/]+".join(re.escape(part) for part in re.split(r"\{\w+\}", topic.key))
        if re.fullmatch(pattern, key):
            return topic.name
    return "other"
