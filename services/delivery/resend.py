"""What a process said that is not in the store yet: it says it again when the store waits for it."""

from collections.abc import Sequence

from shared.protocol.messages import Message

MAX_DWELLS = 512  # kept; more than a run in lockstep may be ahead of the store


class Unstored:
    """Messages by dwell. A checkpoint is their acknowledgement; one that repeats itself says that something is lost."""

    def __init__(self, k: int) -> None:
        self.k = k  # dwells that are complete in the store
        self._said: dict[int, list[Message]] = {}

    def add(self, k: int, messages: Sequence[Message]) -> Sequence[Message]:
        """Keep what is said of dwell k."""
        self._said.setdefault(k, []).extend(messages)
        if len(self._said) > MAX_DWELLS:
            del self._said[min(self._said)]
        return messages

    def checkpoint(self, k: int) -> list[Message]:
        """Drop what is stored; what must be said again, in the order of the dwells."""
        repeated, self.k = k == self.k, k
        self._said = {dwell: messages for dwell, messages in self._said.items() if dwell >= k}
        return [message for dwell in sorted(self._said) for message in self._said[dwell]] if repeated else []
