"""What a process sent and the recorder has not acknowledged yet: it is sent again when the recorder asks for it."""

from collections.abc import Sequence

from cogradar.services.delivery.invariant import require
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan, Truth, Waveform

MAX_DWELLS = 512  # kept; more than a run in lockstep may be ahead of the journal


def _is_lacking(message: Message, tracks: Sequence[int]) -> bool:
    """Whether plans of some tracks, or the waveform, may be lacking because somebody else lacks this message."""
    return isinstance(message, Scan | Truth | Waveform) or (isinstance(message, Plan) and message.target in tracks)


class ResendBuffer:
    """Messages of one run by dwell, from when they are sent until a checkpoint acknowledges them."""

    def __init__(self, k: int) -> None:
        self.k = k  # acknowledged up to, not including, this dwell
        self._sent: dict[int, list[Message]] = {}
        self._asked: Checkpoint | None = None
        self._has_waited = False  # ... while there was something to handle first,
        self._is_asked_again = False  # ... and then again

    def add(self, k: int, messages: Sequence[Message]) -> Sequence[Message]:
        """Keep what is sent of dwell k."""
        self._sent.setdefault(k, []).extend(messages)
        if len(self._sent) > MAX_DWELLS:
            del self._sent[min(self._sent)]
        return messages

    def acknowledge(self, checkpoint: Checkpoint) -> None:
        """Drop what is acknowledged, and note what the recorder wants again."""
        if checkpoint.resend:
            is_same = self._asked is not None and self._asked.k == checkpoint.k
            self._is_asked_again = is_same and self._has_waited
            self._has_waited = is_same and self._has_waited
            self._asked = checkpoint
        elif checkpoint.k > self.k:
            self._asked = None
        self.k = checkpoint.k
        self._sent = {dwell: messages for dwell, messages in self._sent.items() if dwell >= self.k}

    @property
    def is_asked(self) -> bool:
        """Whether the recorder wants something again."""
        return self._asked is not None

    def again(self, *, drained: bool) -> list[Message]:
        """What the recorder wants again and has not acknowledged since, in the order of the dwells.

        Nothing before all is handled that waited when it asked: a process that is behind has only just sent it. That is
        so if no message has waited since (`drained`), or if it asks again after a tick: its inbox is long, but what it
        has sent since does not help.
        """
        if self._asked is None:
            return []
        if not (drained or self._is_asked_again):
            self._has_waited = True
            return []
        asked, self._asked = self._asked, None
        left = [message for dwell in sorted(self._sent) for message in self._sent[dwell]]
        return left if asked.lacking is None else [one for one in left if _is_lacking(one, asked.lacking)]

    def validate(self) -> None:
        """What is kept is bounded. Raises BrokenInvariant."""
        require(len(self._sent) <= MAX_DWELLS, "more dwells are kept than may be")
