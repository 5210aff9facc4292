"""The digest of a run: equal digests mean that the same scans, plans and waveforms were sent, byte for byte."""

import hashlib

from cogradar.shared.protocol.messages import Plan, Scan, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.wire.codec import renamed

DIGESTED = tuple(BY_MESSAGE[message].name for message in (Plan, Scan, Waveform))  # topics a digest covers


class Digest:
    """SHA-256 over the messages of a run in the order given, without the run's name, so that repeated runs compare."""

    def __init__(self, run: str) -> None:
        self._run = run
        self._hash = hashlib.sha256()

    def add(self, payload: bytes) -> None:
        """Continue with one message of the run, as it was encoded."""
        self._hash.update(renamed(payload, self._run, "-"))

    def hexdigest(self) -> str:
        """Over all messages up to now."""
        return self._hash.hexdigest()
