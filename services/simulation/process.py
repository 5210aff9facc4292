"""One process in simulated time: its core, what waits for it, its clock, and what keeps it from going on."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from cogradar.services.delivery.invariant import Checked
from cogradar.services.simulation.schedule import Fault
from cogradar.shared.protocol.events import Membership, Shards, Tick
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.epochs import Epochs, Stamp
from cogradar.shared.wire.pool.members import Pool
from cogradar.shared.wire.runner import TICK_S, Core, Deferring, Preparing, Timed

ROUNDING_S = 1e-9  # so much later a timer goes off, or its time would not quite have come
SPIN = 10_000  # events at one moment: the process would never come to rest


@dataclass
class Clock:
    """What a process reads as time."""

    base_s: float = 0.0
    since_s: float = 0.0  # of simulated time
    pace: float = 1.0

    def read(self, now_s: float) -> float:
        """Its time now."""
        return self.base_s + (now_s - self.since_s) * self.pace

    def when(self, reading_s: float, now_s: float) -> float:
        """When it will read so, in simulated time: now, if it does already."""
        return max(now_s, self.since_s + (reading_s - self.base_s) / self.pace + ROUNDING_S)

    def set(self, now_s: float, *, pace: float, ahead_s: float = 0.0) -> None:
        """From now on it goes at another pace; before that it leaps ahead."""
        self.base_s, self.since_s, self.pace = self.read(now_s) + ahead_s, now_s, pace


class Arrived(NamedTuple):
    """What was sent, with its stamp."""

    payload: bytes
    stamp: Stamp | None


@dataclass(eq=False)
class Process:
    """A core and its surroundings."""

    name: str  # as the others know it
    role: Role
    core: Core
    clock: Clock
    inbox: deque[Arrived | Membership | Shards] = field(default_factory=deque)
    epochs: Epochs = field(default_factory=Epochs)
    halted: set[Fault] = field(default_factory=set)  # what keeps it from going on
    behind: set[Fault] = field(default_factory=set)  # what lets it always have something to read
    drained: bool = False  # there was a moment since its last tick in which it had not
    is_dead_to_others: bool = False  # its token is gone
    is_left: bool = False  # another one has its role
    pool: Pool | None = None  # its part in the pool of its role, if there are pools
    holds: frozenset[int] = frozenset()  # the shards that its core knows to be served here
    busy_until_s: float = 0.0
    tick_s: float = 0.0  # its next tick, by its own clock
    timer_s: float | None = None  # when it will be looked after, in simulated time
    told: tuple[str, ...] = ()  # planners that it knows of

    def __post_init__(self) -> None:
        """Ask once what a core can do: to ask a protocol takes longer than an event."""
        self.timed = self.core if isinstance(self.core, Timed) else None
        self.deferring = self.core if isinstance(self.core, Deferring) else None
        self.preparing = self.core if isinstance(self.core, Preparing) else None
        self.checked = self.core if isinstance(self.core, Checked) else None

    def is_free(self, now_s: float) -> bool:
        """Whether it can handle an event."""
        return not self.halted and now_s >= self.busy_until_s

    def wake_s(self) -> float:
        """When it must get a tick, by its own clock."""
        due = self.timed.wake_s if self.timed is not None else None
        return self.tick_s if due is None else min(self.tick_s, due)

    def wants_tick(self, reading_s: float) -> bool:
        """Whether it gets a tick before the next message, as `cogradar.shared.wire.runner.serve` has it."""
        has_deferred = self.deferring is not None and self.deferring.has_deferred
        self.drained = self.drained or not (self.inbox or self.behind)
        return reading_s >= self.wake_s() or (has_deferred and not (self.inbox or self.behind))

    def tick(self, reading_s: float) -> Tick:
        """The tick that it gets."""
        tick, self.tick_s, self.drained = Tick(reading_s, self.drained), reading_s + TICK_S, False
        return tick
