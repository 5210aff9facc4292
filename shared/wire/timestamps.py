"""When a process received and sent its newest messages, and how long they were: what a dwell's latency is split by.

Times are seconds of the machine's monotonic clock, the same for all its processes; they never reach a core.
"""

import json
import time
from collections import deque
from typing import NamedTuple

from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.topics import BY_MESSAGE

KEPT = 20_000  # newest messages received, and sent; about 12 MB


class Received(NamedTuple):
    """A message that came. Between `taken` and `done` it was decoded, handled, and answered."""

    topic: str
    run: str
    k: int
    item: int
    arrived: float  # handed over by the transport
    taken: float  # out of the queue
    done: float  # the process was free again


class Sent(NamedTuple):
    """A message that went out."""

    topic: str
    run: str
    k: int
    item: int
    begun: float  # handed over by the core, to be encoded and sent
    n_byte: int


class Timestamps:
    """The newest messages of one process."""

    def __init__(self) -> None:
        self.received: deque[Received] = deque(maxlen=KEPT)
        self.sent: deque[Sent] = deque(maxlen=KEPT)
        self._handled: tuple[Message, float, float] | None = None  # what is being handled

    def receive(self, message: Message, arrived: float, taken: float) -> None:
        """Note a valid message that came and is handled now."""
        self._handled = (message, arrived, taken)

    def finish(self) -> None:
        """Note that the process is free again."""
        if self._handled is not None:
            message, arrived, taken = self._handled
            self.received.append(Received(*_name(message), arrived, taken, time.monotonic()))
            self._handled = None

    def send(self, message: Message, begun: float, n_byte: int) -> None:
        """Note a message that went out."""
        self.sent.append(Sent(*_name(message), begun, n_byte))

    def of(self, run: str) -> bytes:
        """All that is kept of a run, and the CPU time that the process has used so far, as JSON."""
        received = [row for row in self.received if row.run == run]
        sent = [row for row in self.sent if row.run == run]
        return json.dumps({"cpu_s": time.process_time(), "received": received, "sent": sent}).encode()


def _name(message: Message) -> tuple[str, str, int, int]:
    return BY_MESSAGE[type(message)].name, message.run, getattr(message, "k", 0), getattr(message, "target", 0)
