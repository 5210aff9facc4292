"""What a process sent and the recorder has not acknowledged yet: it is sent again when the recorder asks for it."""

from collections.abc import Sequence

from services.delivery.invariant import require
from shared.protocol.messages import Checkpoint, Message

MAX_DWELLS = 512  # kept; more than a run in lockstep may be ahead of the journal


class ResendBuffer:
    """Messages of one run by dwell, from when they are sent until a checkpoint acknowledges them."""

    def __init__(self, k: int) -> None:
        self.k = k  # acknowledged up to, not including, this dwell
        self._sent: dict[int, list[Message]] = {}

    def add(self, k: int, messages: Sequence[Message]) -> Sequence[Message]:
        """Keep what is sent of dwell k."""
        self._sent.setdefault(k, []).extend(messages)
        if len(self._sent) > MAX_DWELLS:
            del self._sent[min(self._sent)]
        return messages

    def acknowledge(self, checkpoint: Checkpoint) -> list[Message]:
        """Drop what is acknowledged; what is left, in the order of the dwells, if the recorder wants it again."""
        self.k = checkpoint.k
        self._sent = {dwell: messages for dwell, messages in self._sent.items() if dwell >= self.k}
        return [message for dwell in sorted(self._sent) for message in self._sent[dwell]] if checkpoint.resend else []

    def validate(self) -> None:
        """What is kept is bounded. Raises BrokenInvariant."""
        require(len(self._sent) <= MAX_DWELLS, "more dwells are kept than may be")

    def is_rewound_by(self, checkpoint: Checkpoint) -> bool:
        """Whether the journal has lost dwells that it had acknowledged, so that the run must begin anew from there.

        In real time no dwell can be repeated: such a run goes on where it is.
        """
        return checkpoint.k < self.k and not checkpoint.rate_hz
