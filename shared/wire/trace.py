"""The digest of a run: equal digests mean that the same scans, plans and waveforms were sent, byte for byte."""

import hashlib
from collections.abc import Iterable

from shared.messages import Message, Plan, Scan, Waveform
from shared.topics import BY_MESSAGE
from shared.wire.codec import encode

DIGESTED = tuple(BY_MESSAGE[message].name for message in (Plan, Scan, Waveform))  # topics a digest covers


def digest(messages: Iterable[Message]) -> str:
    """SHA-256 over the messages in the order given, without the run's name, so that repeated runs compare."""
    total = hashlib.sha256()
    for message in messages:
        total.update(encode(message.model_copy(update={"run": "-"})))
    return total.hexdigest()
