"""Questions to a front end in a process of its own, over Zenoh, and the answers that come in time."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from queue import Empty
from typing import Any, Generic, TypeVar

import zenoh

from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.topics import DWELL, OPENING, Exchange, encoding_of
from cogradar.shared.scenario.faults import printable
from cogradar.shared.wire.bus import Arrivals
from cogradar.shared.wire.codec import BadMessage, decode_answer, encode
from cogradar.shared.wire.session import open_session

MAX_DATA = 1 << 28  # bytes of Y: 512 x 512 channels of 128 range cells
MAX_REPLIES = 100  # that are heard to one question
ASK_AGAIN_S = 0.01  # where there was no front end
LONGEST_FAULT = 200
_TIMEOUT = b"Timeout"  # Zenoh's own answer in place of one that is not there
Kind = TypeVar("Kind", bound=Message)


@dataclass(frozen=True)
class Reply(Generic[Kind]):
    """One answer: a message, or what is wrong with it."""

    message: Kind | None
    data: bytes | None = None  # Y, if it came beside the message
    fault: str = ""  # why there is no message
    refuses: bool = False  # the front end itself says the fault


class Line:
    """A session of its own, to the front end of one name. All that answer there are heard."""

    def __init__(self, name: str, endpoints: Sequence[str], within_s: float) -> None:
        """Raises ConnectionError if there is no connection in time."""
        self._name = name
        self._session = open_session(endpoints, within_s, check=lambda: None, shares_memory=True)
        self._arrived: Arrivals[tuple[int, zenoh.Reply | None]] = Arrivals()
        self._asked = 0

    def open(self, opening: Opening, within_s: float) -> Iterator[Reply[Hello]]:
        """What front ends are there."""
        for reply in self._ask(OPENING, opening, within_s):
            yield _opened(reply, Hello)

    def transmit(self, dwell: Transmit, within_s: float) -> Iterator[Reply[Received]]:
        """What was measured, as it comes; among it what came too late for the dwells before."""
        for reply in self._ask(DWELL, dwell, within_s):
            yield _opened(reply, Received)

    def close(self) -> None:
        """Ask no more."""
        self._session.close()

    def _ask(self, exchange: Exchange, question: Message, within_s: float) -> Iterator[zenoh.Reply]:
        """Replies to a question, and late ones to those before. Where nothing answers it is asked again."""
        deadline, payload, replied = time.monotonic() + within_s, encode(question), False
        while not replied and (left := deadline - time.monotonic()) > 0.0:
            self._get(exchange, payload, left)
            try:
                while (left := deadline - time.monotonic()) > 0.0:
                    number, reply = self._arrived.get(left)
                    if (number, reply) == (self._asked, None):
                        break
                    if reply is not None and not _is_silence(reply):
                        replied = replied or number == self._asked
                        yield reply
            except Empty:
                return
            if not replied:
                time.sleep(max(0.0, min(ASK_AGAIN_S, deadline - time.monotonic())))

    def _get(self, exchange: Exchange, payload: bytes, within_s: float) -> None:
        self._asked += 1
        number, heard = self._asked, count()

        def on_reply(reply: zenoh.Reply) -> None:
            if next(heard) < MAX_REPLIES:
                self._arrived.put((number, reply))

        handler: Any = zenoh.handlers.Callback(
            on_reply,
            drop=lambda: self._arrived.put((number, None)),
            indirect=False,
        )
        self._session.get(
            exchange.key_of(self._name),
            handler=handler,
            target=zenoh.QueryTarget.ALL,  # two front ends of one name would else take turns
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=within_s,
            payload=payload,
            encoding=zenoh.Encoding(encoding_of(exchange.question)),
        )


def _is_silence(reply: zenoh.Reply) -> bool:
    return reply.err is not None and reply.err.payload.to_bytes() == _TIMEOUT


def _opened(reply: zenoh.Reply, kind: type[Kind]) -> Reply[Kind]:
    if reply.err is not None or reply.ok is None:
        said = b"" if reply.err is None else reply.err.payload.to_bytes()[:LONGEST_FAULT]
        return Reply(None, fault=printable(said.decode(errors="replace")) or "no reason", refuses=True)
    attached = reply.ok.attachment
    if len(reply.ok.payload) > MAX_DATA:
        return Reply(None, fault=f"{len(reply.ok.payload)} bytes, more than {MAX_DATA}")
    payload = reply.ok.payload.to_bytes()
    try:
        if attached is None:
            return Reply(decode_answer(payload, kind))
        return Reply(decode_answer(attached.to_bytes(), kind), data=payload)
    except BadMessage as error:
        return Reply(None, fault=str(error))
