"""The one main loop: receive, handle, publish, until stopped."""

import threading
import time
from collections.abc import Iterable, Mapping
from typing import Protocol, runtime_checkable

from shared.protocol.messages import Event, Message, Refused, Tick
from shared.wire.bus import Bus

TICK_S = 0.25  # between the ticks that a core gets, and how soon a stop is noticed


class Core(Protocol):
    """What a role decides: message in, messages out. No clock, socket, thread, file or global random state."""

    def handle(self, event: Event) -> Iterable[Message | None]:
        """Messages to say in answer to an event. None among them: those so far go out before the next is made.

        Raises Refused, unchanged and before the first, for a message that makes no sense.
        """


@runtime_checkable
class Timed(Protocol):
    """A core that must act at certain times, as the cores of a run in real time do."""

    @property
    def wake_s(self) -> float:
        """When it wants a tick, by the clock of the ticks; 0: as soon as nothing else waits; infinity: whenever."""


@runtime_checkable
class Preparing(Protocol):
    """A core that can make use of the time in which nobody waits for it."""

    def prepare(self) -> bool:
        """Do a little, at most a few ms, of what the next event will need; false if there is nothing left to do.

        What it answers must not depend on whether, or how far, it could prepare.
        """


@runtime_checkable
class Closing(Protocol):
    """A core that holds something to be put away at the end."""

    def close(self) -> None:
        """Put it away."""


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
    """Let a core handle an event, and say what it answers."""
    said: list[Message] = []
    try:
        for message in core.handle(event):
            if message is not None:
                said.append(message)
            else:
                bus.publish(*said)
                said.clear()
        bus.publish(*said)
    except Refused as refusal:
        if not isinstance(event, Message):
            raise
        bus.refuse(event, str(refusal))


def serve(core: Core, bus: Bus, stop: threading.Event) -> None:
    """Serve until `stop` is set. An error in a core is a bug and ends the process."""
    tick = time.monotonic() + TICK_S
    timed = core if isinstance(core, Timed) else None
    prepare = core.prepare if isinstance(core, Preparing) else None
    is_prepared = False
    while not stop.is_set():
        wake = min(tick, timed.wake_s) if timed is not None else tick
        busy = step(core, bus, max(0.0, wake - time.monotonic()) if is_prepared else 0.0)
        if busy:
            is_prepared = False
        elif not is_prepared:
            is_prepared = prepare is None or not prepare()
        now = time.monotonic()
        if now >= tick or (now >= wake and (wake > 0.0 or not busy)):  # 0: when nothing else waits
            handle(core, bus, Tick(now))
            tick, is_prepared = now + TICK_S, False
