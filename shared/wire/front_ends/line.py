"""Questions to a front end in a process of its own, over Zenoh, and the answers that come in time."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
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

MAX_DATA = 1 << 28  # bytes of Y, and of all that waits: 512 x 512 channels of 128 range cells
MAX_REPLIES = 100  # that are heard to one question
AGAIN_S, GROWTH = 0.01, 4.0  # where nothing answered: until it is asked again, and how much later each time
OPEN_AGAIN_S = 0.5  # ... at the most at an opening, which radiates nothing
SLICE_S = 0.1  # after which it is looked whether the process is to end
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
    replier: str = ""  # its session: two front ends may have drawn the same incarnation


@dataclass(frozen=True)
class _TooMuch:
    """In place of a reply for which there was no room."""

    n_byte: int


class Line:
    """A session of its own, to the front end of one name. All that answer there are heard."""

    def __init__(self, name: str, endpoints: Sequence[str], within_s: float, check: Callable[[], None]) -> None:
        """`check` is called while anything is waited for, and may raise to give up.

        Raises ConnectionError if there is no connection in time.
        """
        self._name, self._check = name, check
        self._session = open_session(endpoints, within_s, check=check, shares_memory=True)
        self._arrived: Arrivals[tuple[int, zenoh.Reply | _TooMuch | None]] = Arrivals()
        self._waiting = _Bytes(MAX_DATA)
        self._asked = 0

    def open(self, opening: Opening, within_s: float) -> Iterator[Reply[Hello]]:
        """What front ends are there."""
        for reply in self._ask(OPENING, lambda _left_s: opening, within_s):
            yield replace(_opened(reply, Hello), data=None)

    def transmit(self, dwell: Transmit, within_s: float) -> Iterator[Reply[Received]]:
        """What was measured, as it comes; among it what came too late for the dwells before."""
        for reply in self._ask(DWELL, lambda left_s: dwell.model_copy(update={"deadline_s": left_s}), within_s):
            yield _opened(reply, Received)

    def close(self) -> None:
        """Ask no more."""
        self._session.close()

    def _ask(
        self, exchange: Exchange, question: Callable[[float], Message], within_s: float
    ) -> Iterator[zenoh.Reply | _TooMuch]:
        """Replies to a question, and late ones to those before. Where nothing answers it is asked again.

        question : of the seconds that are left for the answer
        """
        deadline, pause_s, replied = time.monotonic() + within_s, AGAIN_S, False
        try:
            while (left := deadline - time.monotonic()) > 0.0:
                self._get(exchange, encode(question(left)), left)
                while (arrived := self._next(deadline)) != (self._asked, None):
                    number, reply = arrived
                    if reply is not None and not _is_silence(reply):
                        replied = replied or number == self._asked
                        yield reply
                if replied:
                    return
                # Nothing may be there, or it may have dropped the question, and then it may radiate each time: where
                # certificates rule, a router shows us no queryables.
                until, pause_s = time.monotonic() + pause_s, GROWTH * pause_s
                if exchange is OPENING:
                    pause_s = min(pause_s, OPEN_AGAIN_S)
                while (left := min(until, deadline) - time.monotonic()) > 0.0:
                    self._check()
                    time.sleep(min(left, SLICE_S))
        except Empty:
            return

    def _next(self, deadline: float) -> tuple[int, zenoh.Reply | _TooMuch | None]:
        """What came next, and to which question; None: no more to it. Raises Empty if there is nothing in time."""
        while (left := deadline - time.monotonic()) > 0.0:
            self._check()
            try:
                number, reply = self._arrived.get(min(left, SLICE_S))
            except Empty:
                continue
            if isinstance(reply, zenoh.Reply):
                self._waiting.free(_size(reply))
            return number, reply
        raise Empty

    def _get(self, exchange: Exchange, payload: bytes, within_s: float) -> None:
        self._asked += 1
        number, heard = self._asked, count()

        def on_reply(reply: zenoh.Reply) -> None:
            if next(heard) < MAX_REPLIES:
                n_byte = _size(reply)
                self._arrived.put((number, reply if self._waiting.take(n_byte) else _TooMuch(n_byte)))

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


class _Bytes:
    """How many bytes of replies wait; threads of the transport take, the asking one frees."""

    def __init__(self, most: int) -> None:
        self._left, self._lock = most, threading.Lock()

    def take(self, n: int) -> bool:
        """Whether so many more may wait."""
        with self._lock:
            has_room = n <= self._left
            self._left -= n if has_room else 0
            return has_room

    def free(self, n: int) -> None:
        """So many no longer wait."""
        with self._lock:
            self._left += n


def _size(reply: zenoh.Reply) -> int:
    """Bytes of a reply."""
    if reply.ok is None:
        return 0 if reply.err is None else len(reply.err.payload)
    attached = reply.ok.attachment
    return len(reply.ok.payload) + (0 if attached is None else len(attached))


def _is_silence(reply: zenoh.Reply | _TooMuch) -> bool:
    return isinstance(reply, zenoh.Reply) and reply.err is not None and reply.err.payload.to_bytes() == _TIMEOUT


def _opened(reply: zenoh.Reply | _TooMuch, kind: type[Kind]) -> Reply[Kind]:
    if isinstance(reply, _TooMuch):
        return Reply(None, fault=f"{reply.n_byte} bytes, more than {MAX_DATA} with what waits already")
    if reply.err is not None or reply.ok is None:
        said = b"" if reply.err is None else reply.err.payload.to_bytes()[:LONGEST_FAULT]
        return Reply(None, fault=printable(said.decode(errors="replace")) or "no reason", refuses=True)
    attached, payload = reply.ok.attachment, reply.ok.payload.to_bytes()
    replier = "" if reply.replier_id is None else str(reply.replier_id.zid)
    try:
        if attached is None:
            return Reply(decode_answer(payload, kind), replier=replier)
        return Reply(decode_answer(attached.to_bytes(), kind), data=payload, replier=replier)
    except BadMessage as error:
        return Reply(None, fault=str(error), replier=replier)
