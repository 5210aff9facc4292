"""Messages that come before their run is known: no two publishers are in step."""

import logging
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from pydantic import BaseModel

from cogradar.services.delivery.invariant import require
from cogradar.shared.protocol.messages import Message, Refused
from cogradar.shared.wire.codec import BadMessage, decode
from cogradar.shared.wire.runner import Flush

# What is kept, over all runs; what is dropped beyond it is redelivered or recalled.
MAX_PENDING, MAX_BYTES = 1000, 16 << 20
OVERHEAD_BYTES = 1000  # of a message, beside its arrays
log = logging.getLogger(__name__)


class Pending:
    """A bounded buffer; the oldest go first when it is full."""

    def __init__(self) -> None:
        self._messages: deque[tuple[Message, int]] = deque()  # each with its size
        self._n_byte = 0

    def add(self, message: Message) -> None:
        """Keep a message of a run that is not known yet."""
        self._messages.append((message, n_byte := _size(message)))
        self._n_byte += n_byte
        while len(self._messages) > MAX_PENDING or self._n_byte > MAX_BYTES:
            self._n_byte -= self._messages.popleft()[1]

    def forget(self, run: str) -> None:
        """Drop what is kept of a run."""
        self._messages = deque(kept for kept in self._messages if kept[0].run != run)
        self._n_byte = sum(n_byte for _, n_byte in self._messages)

    def validate(self) -> None:
        """What is kept is bounded, and counted right. Raises BrokenInvariant."""
        n, n_byte = len(self._messages), sum(n_byte for _, n_byte in self._messages)
        require(n <= MAX_PENDING and n_byte <= MAX_BYTES, f"{n} messages of {n_byte} bytes are pending")
        require(n_byte == self._n_byte, f"{n_byte} bytes are pending, {self._n_byte} are counted")

    def replay(self, run: str, handle: Callable[[Message], Iterable[Message | Flush]]) -> list[Message]:
        """Hand over what was kept of a run; a message that is refused must not take the others with it."""
        mine = [message for message, _ in self._messages if message.run == run]
        self.forget(run)
        answers: list[Message] = []
        for message in mine:
            try:
                answers += [answer for answer in handle(message) if isinstance(answer, Message)]
            except Refused as refusal:
                log.warning("dropping a pending message of %s: %s", run, refusal)
        return answers


def decoded(payload: bytes) -> Message:
    """A message of a History; raises Refused if it is none."""
    try:
        return decode(payload)
    except BadMessage as error:
        raise Refused(f"history: {error}") from None


def _size(message: Message) -> int:
    """About how much memory a message takes."""
    return OVERHEAD_BYTES + _arrays(message)


def _arrays(model: BaseModel) -> int:
    """Bytes of the arrays of a message, and of what it has within."""
    values = [getattr(model, name) for name in type(model).model_fields]
    own = sum(value.nbytes for value in values if isinstance(value, np.ndarray))
    return own + sum(_arrays(value) for value in values if isinstance(value, BaseModel))
