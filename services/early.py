"""Messages that come before their run is known: two publishers are never in step."""

import logging
from collections import deque
from collections.abc import Callable, Iterable

from shared.messages import Message, Refused
from shared.wire.codec import BadMessage, decode

MAX_EARLY = 1000  # messages kept, over all runs; what is lost beyond them is said again or recalled
log = logging.getLogger(__name__)


class Early:
    """A bounded buffer; the oldest go first when it is full."""

    def __init__(self) -> None:
        self._kept: deque[Message] = deque(maxlen=MAX_EARLY)

    def keep(self, message: Message) -> None:
        """Keep a message of a run that is not known yet."""
        self._kept.append(message)

    def forget(self, run: str) -> None:
        """Drop what is kept of a run."""
        self._kept = deque((message for message in self._kept if message.run != run), maxlen=MAX_EARLY)

    def replay(self, run: str, handle: Callable[[Message], Iterable[Message | None]]) -> list[Message]:
        """Hand over what was kept of a run; a message that is refused must not take the others with it."""
        mine = [message for message in self._kept if message.run == run]
        self.forget(run)
        answers: list[Message] = []
        for message in mine:
            try:
                answers += [said for said in handle(message) if said is not None]
            except Refused as refusal:
                log.warning("dropping an early message of %s: %s", run, refusal)
        return answers


def decoded(payload: bytes) -> Message:
    """A message of a History; raises Refused if it is none."""
    try:
        return decode(payload)
    except BadMessage as error:
        raise Refused(f"history: {error}") from None
