"""The tokens of a pool's processes over Zenoh."""

import threading
import time
import uuid
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import zenoh

from cogradar.shared.protocol.topics import PROTOCOL, SHARE, Role
from cogradar.shared.wire.pool.members import ASK_S, Token
from cogradar.shared.wire.pool.shares import SETTLE_S

AGAIN_S = 2.0  # between two looks at all tokens: word of one that is gone may have been lost, or come too early


class ZenohTokens:
    """Liveliness tokens: `Tokens` of `members`. What arrives is noted by threads of the transport."""

    def __init__(self, session: zenoh.Session, role: Role, name: str, build: str) -> None:
        """The tokens of all processes of a role and build; `name` is this process."""
        self.arrived: deque[tuple[Token, bool]] = deque()
        self.answers: deque[tuple[float, set[Token]]] = deque(maxlen=1)
        self.n_lost = 0
        self._session, self._closed = session, threading.Event()
        self._key = partial(SHARE.format, protocol=PROTOCOL, build=build, role=role)
        self._name, self._pattern = name, self._key(shard="*", moment="*", name="*")
        self._link = session.info.declare_transport_events_listener(self._on_link, history=False)
        self._watch: zenoh.Subscriber[None] | None = None

    def now_s(self) -> float:
        """A clock that goes on while the machine is suspended, where the system has one."""
        clock_gettime, clock = getattr(time, "clock_gettime", None), getattr(time, "CLOCK_BOOTTIME", None)
        return time.monotonic() if clock_gettime is None or clock is None else float(clock_gettime(clock))

    def cpu_s(self) -> float:
        """Time that this thread has computed."""
        return time.thread_time()

    def moment(self) -> str:
        """The time of day, and what makes it unique."""
        return f"{time.time_ns():020d}-{uuid.uuid4().hex[:8]}"

    def wait(self, seconds: float) -> None:
        """Let threads of the transport go on."""
        time.sleep(seconds)

    def watch(self) -> None:
        """Let tokens arrive, and ask for all of them every AGAIN_S."""
        self._watch = self._session.liveliness().declare_subscriber(self._pattern, self._on_token, history=True)
        threading.Thread(target=self._look_again, name="tokens", daemon=True).start()

    def there(self) -> set[Token]:
        """Ask for all tokens now."""
        replies = self._session.liveliness().get(self._pattern, timeout=ASK_S)
        found = {Token.of(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return {token for token in found if token.is_one}

    def routers(self) -> frozenset[str]:
        """The routers that this process is connected with."""
        return frozenset(map(str, self._session.info.routers_zid()))

    def show(self, shard: str, moment: str) -> Callable[[], None]:
        """Show a token of this process; the answer withdraws it."""
        key = self._key(shard=shard, moment=moment, name=self._name)
        return self._session.liveliness().declare_token(key).undeclare

    def close(self) -> None:
        """Watch no more."""
        self._closed.set()
        if self._watch is not None:
            self._watch.undeclare()
        self._link.undeclare()

    def _look_again(self) -> None:
        while not self._closed.wait(AGAIN_S) and not self._session.is_closed():
            asked_s = self.now_s()
            with suppress(zenoh.ZError):  # the session is being closed
                there = self.there()
                if self.now_s() - asked_s < SETTLE_S:  # a late answer shows claims that are withdrawn and forgotten
                    self.answers.append((asked_s, there))

    def _on_link(self, event: zenoh.TransportEvent) -> None:
        self.n_lost += event.kind == zenoh.SampleKind.DELETE

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = Token.of(sample.key_expr)
        if token.is_one:
            self.arrived.append((token, sample.kind == zenoh.SampleKind.PUT))
