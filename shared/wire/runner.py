"""The one main loop: receive, handle, publish, until stopped."""

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Message, Refused
from cogradar.shared.wire.bus import Bus
from cogradar.shared.wire.meter import Meter

TICK_S = 0.25  # between the ticks that a core gets, and how soon a stop is noticed


@dataclass(frozen=True)
class Flush:
    """Among the answers of a core: send what came before it now."""


class Core(Protocol):
    """What a role decides: message in, messages out. No clock, socket, thread, file or global random state."""

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        """Messages to send in answer to an event; a Flush sends those before it, before the next one is computed.

        Raises Refused, unchanged and before the first, for a message that makes no sense.
        """


@runtime_checkable
class Timed(Protocol):
    """A core that must act at certain times, as the cores of a run in real time do."""

    @property
    def wake_s(self) -> float | None:
        """When it must get a tick, by the clock of the ticks; None: the regular ticks are enough."""


@runtime_checkable
class Deferring(Protocol):
    """A core that puts work off until no message waits for it."""

    @property
    def has_deferred(self) -> bool:
        """Whether it wants a tick as soon as no message waits."""


@runtime_checkable
class Preparing(Protocol):
    """A core that can make use of idle time."""

    def prepare(self) -> bool:
        """Do a little, at most a few ms, of what the next event will need; false if there is nothing left to do.

        What it answers must not depend on whether, or how far, it could prepare.
        """


@runtime_checkable
class Sharing(Protocol):
    """A core that is told which shards of the runs it serves, and drops all other runs."""

    @property
    def busy(self) -> frozenset[int]:
        """Shards with runs."""


@runtime_checkable
class Leading(Protocol):
    """A core that leads runs, by a journal that has one leader after the other."""

    @property
    def epoch(self) -> int:
        """Since when, by the journal; 0: it leads none."""

    def lead(self) -> Sequence[Message]:
        """What is said before anything is heard, so that what was made of another journal is told from the rest."""


@runtime_checkable
class Closing(Protocol):
    """A core that holds something to be put away at the end."""

    def close(self) -> None:
        """Put it away."""


@runtime_checkable
class Leaving(Protocol):
    """A core that has something to send before its process ends."""

    def leave(self) -> Iterable[Message]:
        """The last messages."""


@runtime_checkable
class Answering(Protocol):
    """A core that can also be asked."""

    def answer(self, metric: str, parameters: Mapping[str, str]) -> bytes:
        """Answer a query; raises ValueError, with a text for the asker, if it cannot be answered."""


def step(core: Core, bus: Bus, timeout_s: float) -> bool:
    """Let a core handle one event; false if none came in time."""
    event = bus.receive(timeout_s)
    if event is None:
        return False
    handle(core, bus, event)
    return True


def handle(core: Core, bus: Bus, event: Event) -> None:
    """Let a core handle an event, and send its answers."""
    answers: list[Message] = []
    try:
        for answer in core.handle(event):
            if isinstance(answer, Flush):
                bus.publish(*answers)
                answers.clear()
            else:
                answers.append(answer)
        bus.publish(*answers)
    except Refused as refusal:
        if not isinstance(event, Message):
            raise
        bus.refuse(event, str(refusal))


def serve(core: Core, bus: Bus, stop: threading.Event, meter: Meter, beat: Callable[[], None] = lambda: None) -> None:
    """Serve until `stop` is set, count what is handled, and `beat` at each tick.

    An error in a core is a bug and ends the process.
    """
    tick = time.monotonic() + TICK_S
    timed = core if isinstance(core, Timed) else None
    deferring = core if isinstance(core, Deferring) else None
    prepare = core.prepare if isinstance(core, Preparing) else None
    is_prepared, drained = False, False
    while not stop.is_set():
        due = timed.wake_s if timed is not None else None
        wake = tick if due is None else min(tick, due)
        has_deferred = deferring is not None and deferring.has_deferred
        event = bus.receive(max(0.0, wake - time.monotonic()) if is_prepared and not has_deferred else 0.0)
        if event is not None:
            _handle_counted(core, bus, event, meter)
            is_prepared = False
        else:
            drained = drained or bus.is_drained()
            is_prepared = is_prepared or prepare is None or not prepare()
        now = time.monotonic()
        if now >= wake or (has_deferred and event is None):
            if bus.has_paused():  # while it handled the event: what a tick makes due is others' by now
                continue
            _handle_counted(core, bus, Tick(now, drained), meter)
            beat()
            tick, is_prepared, drained = now + TICK_S, False, False
    if isinstance(core, Leaving):
        bus.publish(*core.leave())


def _handle_counted(core: Core, bus: Bus, event: Event, meter: Meter) -> None:
    meter.begin()
    handle(core, bus, event)
    meter.end(event)
