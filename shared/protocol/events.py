"""What a core is handed: a message, or what its runner tells it."""

from dataclasses import dataclass

from cogradar.shared.protocol.messages import Message


@dataclass(frozen=True)
class Membership:
    """Which processes of a role are alive; from liveliness tokens, never on the wire."""

    role: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class Shards:
    """Which shards of the runs this process serves from now on; from liveliness tokens, never on the wire."""

    held: frozenset[int]


@dataclass(frozen=True)
class Tick:
    """A moment has passed; from the runner's clock, never on the wire."""

    now_s: float  # of a clock that never goes back
    drained: bool = True  # no message has waited at some time since the last one: silence is the others' silence


@dataclass(frozen=True)
class Rewind:
    """What is known of a run is made of more than its journal has, which is an older one: forget it.

    The run begins anew with the checkpoint that comes next. From the epochs of what was heard, never on the wire.
    """

    run: str


Event = Message | Membership | Rewind | Shards | Tick
