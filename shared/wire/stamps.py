"""When a process heard and said its newest messages, and how long they were: what latency is split by.

Times are of the machine's monotonic clock, the same for all its processes; they never reach a core.
"""

import json
import time
from collections import deque
from typing import NamedTuple

from shared.messages import Message
from shared.topics import BY_MESSAGE

KEPT = 20_000  # newest messages heard, and said; a few MB


class Heard(NamedTuple):
    """A message that came, s."""

    topic: str
    run: str
    k: int
    item: int
    arrived: float  # handed over by the transport
    taken: float  # out of the queue, to be decoded and handled


class Said(NamedTuple):
    """A message that went, s."""

    topic: str
    run: str
    k: int
    item: int
    begun: float  # handed over by the core, to be encoded and sent
    n_byte: int


class Stamps:
    """The newest messages of one process."""

    def __init__(self) -> None:
        self.heard: deque[Heard] = deque(maxlen=KEPT)
        self.said: deque[Said] = deque(maxlen=KEPT)

    def hear(self, message: Message, arrived: float, taken: float) -> None:
        """Note a valid message that came."""
        self.heard.append(Heard(*_name(message), arrived, taken))

    def say(self, message: Message, begun: float, n_byte: int) -> None:
        """Note a message that went."""
        self.said.append(Said(*_name(message), begun, n_byte))

    def as_json(self) -> bytes:
        """All that is kept, and the CPU time that the process has taken so far."""
        return json.dumps(
            {"cpu_s": time.process_time(), "heard": list(self.heard), "said": list(self.said)}
        ).encode()


def _name(message: Message) -> tuple[str, str, int, int]:
    return BY_MESSAGE[type(message)].name, message.run, getattr(message, "k", 0), getattr(message, "target", 0)
