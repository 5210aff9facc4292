"""What the processes of a system report of a run's messages, as `cogradar.shared.wire.timestamps` keeps it."""

import json
from typing import NamedTuple
from urllib.parse import quote

import zenoh

from cogradar.shared.protocol.topics import TIMESTAMPS
from cogradar.shared.wire.session import Session
from cogradar.shared.wire.timestamps import Received, Sent


class RunTimestamps(NamedTuple):
    """What one process reports of one run."""

    cpu_s: float  # that the process has used so far, with the transport's threads
    received: list[Received]
    sent: list[Sent]

    @classmethod
    def read(cls, document: bytes) -> "RunTimestamps":
        """From JSON, as `Timestamps.of` writes it."""
        found = json.loads(document)
        received, sent = (Received(*row) for row in found["received"]), (Sent(*row) for row in found["sent"])
        return cls(found["cpu_s"], list(received), list(sent))


def ask_timestamps(session: Session, run: str, timeout_s: float) -> dict[str, RunTimestamps]:
    """What every process reports of a run's messages and of its own CPU time, by the process's name."""
    selector = zenoh.Selector(TIMESTAMPS.format(role="*", name="*"), f"run={quote(run)}")
    found: dict[str, RunTimestamps] = {}
    for reply in session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout_s):
        if reply.ok is not None:
            found[str(reply.ok.key_expr).rsplit("/", 1)[-1]] = RunTimestamps.read(reply.ok.payload.to_bytes())
    return found
