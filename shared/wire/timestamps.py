"""When a process heard and said its newest messages, and how long they were: what a dwell's latency is split by.

Times are seconds of the machine's monotonic clock, the same for all its processes; they never reach a core.
"""

import json
import time
from collections import deque
from typing import NamedTuple

from shared.protocol.messages import Message
from shared.protocol.topics import BY_MESSAGE

KEPT = 20_000  # newest messages heard, and said; about 12 MB


class Heard(NamedTuple):
    """A message that came. Between `taken` and `done` it was decoded, handled, and answered."""

    topic: str
    run: str
    k: int
    item: int
    arrived: float  # handed over by the transport
    taken: float  # out of the queue
    done: float  # the process was free again


class Said(NamedTuple):
    """A message that went."""

    topic: str
    run: str
    k: int
    item: int
    begun: float  # handed over by the core, to be encoded and sent
    n_byte: int


class Timing(NamedTuple):
    """What a process says of one run."""

    cpu_s: float  # that the process has taken so far, with the transport's threads
    heard: list[Heard]
    said: list[Said]

    @classmethod
    def read(cls, document: bytes) -> "Timing":
        """From JSON, as `Stamps.of` writes it."""
        found = json.loads(document)
        return cls(found["cpu_s"], [Heard(*note) for note in found["heard"]], [Said(*note) for note in found["said"]])


class Stamps:
    """The newest messages of one process."""

    def __init__(self) -> None:
        self.heard: deque[Heard] = deque(maxlen=KEPT)
        self.said: deque[Said] = deque(maxlen=KEPT)
        self._handled: tuple[Message, float, float] | None = None  # what is being handled

    def hear(self, message: Message, arrived: float, taken: float) -> None:
        """Note a valid message that came and is handled now."""
        self._handled = (message, arrived, taken)

    def rest(self) -> None:
        """Note that the process is free again."""
        if self._handled is not None:
            message, arrived, taken = self._handled
            self.heard.append(Heard(*_name(message), arrived, taken, time.monotonic()))
            self._handled = None

    def say(self, message: Message, begun: float, n_byte: int) -> None:
        """Note a message that went."""
        self.said.append(Said(*_name(message), begun, n_byte))

    def of(self, run: str) -> bytes:
        """All that is kept of a run, and the CPU time that the process has taken so far, as JSON."""
        heard = [note for note in self.heard if note.run == run]
        said = [note for note in self.said if note.run == run]
        return json.dumps({"cpu_s": time.process_time(), "heard": heard, "said": said}).encode()


def _name(message: Message) -> tuple[str, str, int, int]:
    return BY_MESSAGE[type(message)].name, message.run, getattr(message, "k", 0), getattr(message, "target", 0)
