"""A fusion node of a few lines: it accepts the radar that connects, sends it tasks, and waits for what it says."""

import socket
import time
from typing import Any

from tests.services.feed.test_sapient import ACCEPTED, framed, messages

WITHIN_S = 60.0
TASK = f"01J{22 * '0'}{{}}"
START, STOP, PAUSE = 1, 2, 3


class Fusion:
    """Its end of one connection."""

    def __init__(self, server: socket.socket) -> None:
        self._other, _ = server.accept()
        self._other.settimeout(WITHIN_S)
        self._heard = b""
        self.until("registration")

    def close(self) -> None:
        self._other.close()

    def send(self, data: bytes = ACCEPTED) -> None:
        self._other.sendall(data)

    def task(self, number: int, control: int = START, **content: Any) -> None:
        self.send(framed(task={"task_id": TASK.format(number), "control": control, **content}))

    def until(self, name: str, **fields: Any) -> Any:
        """The content of the next message of this kind with these fields."""
        until_s = time.monotonic() + WITHIN_S
        while time.monotonic() < until_s:
            while len(self._heard) < 4 or len(self._heard) < (n := 4 + int.from_bytes(self._heard[:4], "little")):
                data = self._other.recv(1 << 16)
                assert data
                self._heard += data
            (message,) = messages(self._heard[:n])
            self._heard = self._heard[n:]
            found = getattr(message, name)
            if found is not None and all(getattr(found, field) == value for field, value in fields.items()):
                return found
        raise AssertionError(name)
