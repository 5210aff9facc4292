"""The tokens of a pool's processes: those that this process shows, and those that it sees of the others."""

import logging
import re
import threading
import time
import uuid
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from functools import partial
from typing import NamedTuple, Self

import zenoh

from cogradar.shared.protocol.topics import ALL_SHARDS, PROTOCOL, SHARE, Role, run_on, shard_of
from cogradar.shared.wire.membership import LEASE_S
from cogradar.shared.wire.pool.shares import SETTLE_S, Shares, later_than

PAUSE_S = 0.5 * LEASE_S  # after which a process that did nothing, and did not compute, looks whether it was missed
WAKE_S = 0.2  # for threads of the transport to see that their link was closed
LOOK_S = 0.1  # between two decisions
ASK_S = 1.0  # for an answer about tokens
AGAIN_S = 2.0  # between two looks at all tokens: word of one that is gone may have been lost, or come too early
_PRESENT = "any-"  # begins the part of a key that is no shard
_NUMBERS = {str(shard): shard for shard in ALL_SHARDS}
_MOMENT = re.compile("0[0-8][0-9]{18}-[0-9a-f]{8}")  # until 2255, `LATEST_NS`
log = logging.getLogger(__name__)


def _uptime_s() -> float:
    """A clock that goes on while the machine is suspended, as the leases of the others do."""
    clock_gettime, clock = getattr(time, "clock_gettime", None), getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock_gettime is None or clock is None else float(clock_gettime(clock))


def _moment() -> str:
    return f"{time.time_ns():020d}-{uuid.uuid4().hex[:8]}"


class _Token(NamedTuple):
    shard: str
    moment: str
    name: str

    @classmethod
    def of(cls, key: object) -> Self:
        return cls(*str(key).split("/")[-3:])

    @property
    def number(self) -> int | None:
        """Its shard; None: it says that a process is there, or what no program says."""
        return _NUMBERS.get(self.shard)

    @property
    def is_one(self) -> bool:
        """Whether it is what a program shows."""
        is_shard = self.number is not None or self.shard.startswith(_PRESENT)
        return is_shard and _MOMENT.fullmatch(self.moment) is not None


class Pool:
    """A process's part in a pool. What others show is noted by threads of the transport; all else is done by the
    thread that owns the core.
    """

    def __init__(
        self,
        session: zenoh.Session,
        named: tuple[Role, str, str],
        busy: Callable[[], Collection[int]],
        *,
        kind: str = "",
        is_spread: bool = True,
    ) -> None:
        """See which processes are there. Nothing is shown yet.

        named     : role, name and build of the process
        busy      : the shards in which runs go on here
        kind      : of the process: a pool is of one kind
        is_spread : whether shards are shared out, or one process has all
        """
        self._session, self._busy, self._kind = session, busy, f"{_PRESENT}{zlib.crc32(kind.encode()):08x}"
        role, name, build = named
        self._key = partial(SHARE.format, protocol=PROTOCOL, build=build, role=role)
        self._name, self._pattern = name, self._key(shard="*", moment="*", name="*")
        self._arrived: deque[tuple[_Token, bool]] = deque()
        self._answers: deque[tuple[float, set[_Token]]] = deque(maxlen=1)  # when it was asked; what was there
        self._shown: dict[str, zenoh.LivelinessToken] = {}
        self._told: frozenset[int] | None = None  # what the core knows
        self._due_s = self._looked_s = 0.0
        self._cpu_s = 0.0  # of this thread, at the last decision
        self._routers = frozenset(map(str, session.info.routers_zid()))
        self._n_lost = self._n_known = 0  # links to routers that were lost; when this process looked last
        self._link = session.info.declare_transport_events_listener(self._on_link, history=False)
        there = self._there()  # asked first: an answer just after the subscription may be empty
        self._watch = session.liveliness().declare_subscriber(self._pattern, self._on_token, history=True)
        time.sleep(SETTLE_S)
        seen = {*there, *(token for token, is_there in list(self._arrived) if is_there)}
        moment = later_than((token.moment for token in seen), _moment())
        self._shares = Shares(moment, is_spread=is_spread)
        self._shares.see_all({(token.number, token.moment) for token in there}, _uptime_s())
        self._closed = threading.Event()
        threading.Thread(target=self._look_again, name="tokens", daemon=True).start()

    @property
    def held(self) -> frozenset[int]:
        """The shards that this process serves."""
        return self._shares.held

    def others(self) -> list[str]:
        """Names of processes of another kind that are there."""
        present = [token for token in self._there() if token.shard.startswith(_PRESENT)]
        return sorted(token.name for token in present if token.shard != self._kind)

    def join(self, check: Callable[[], None]) -> None:
        """Show that this process is there, and claim its part; over when it serves it. `check` may raise to give up."""
        self._show(self._kind)
        self._looked_s = _uptime_s()
        while True:
            self._decide(_uptime_s())
            if self._shares.is_settled:
                return
            check()
            time.sleep(SETTLE_S / 2)

    def news(self) -> frozenset[int] | None:
        """The shards that are served from now on, if the core does not know them yet."""
        self.has_paused()
        now_s = self._looked_s
        if now_s >= self._due_s or self._arrived:
            self._decide(now_s)
        return self._tell()

    def has_paused(self) -> bool:
        """Whether this process has done nothing for so long that it was missed, and serves nothing any more.

        Asked before anything is handled that has waited meanwhile, or is due: what others do now is not to be done
        twice.
        """
        now_s, is_missed = _uptime_s(), False
        if (gap_s := now_s - self._looked_s) > PAUSE_S:
            is_missed = gap_s - (time.thread_time() - self._cpu_s) > PAUSE_S and self._is_missed()
            now_s = _uptime_s()  # to ask took its time, too
        self._looked_s, self._n_known = now_s, self._n_lost
        return is_missed

    def serves(self, key: str) -> bool:
        """Whether a message on a key is of a run that is served here."""
        return shard_of(run_on(key)) in self._shares.held

    def close(self) -> None:
        """Leave it."""
        self._closed.set()
        self._watch.undeclare()
        self._link.undeclare()
        self._withdraw(list(self._shown))

    def _tell(self) -> frozenset[int] | None:
        if self._told == self._shares.held:
            return None
        self._told = self._shares.held
        return self._told

    def _is_missed(self) -> bool:
        """Whether its tokens are not what it showed, or others have claims to what it serves: it begins anew then.

        What is asked may be answered by what this session knows. So its threads get the time to learn what has
        happened: they have been frozen, too.
        """
        time.sleep(WAKE_S)
        there = self._there()
        own = {token.shard for token in there if token.moment == self._shares.moment}
        others = {(token.number, token.moment) for token in there if token.moment != self._shares.moment}
        is_seen = self._n_lost == self._n_known and own >= self._shown.keys()
        if is_seen and not any(shard in self.held for shard, _ in others):
            return False
        log.warning("%s was away, and others may serve its runs: it drops them, and joins again", self._name)
        self._withdraw(list(self._shown))
        self._shares.lapse(later_than((token.moment for token in there), _moment()))
        self._shares.see_all(others, _uptime_s())
        self._routers = frozenset()  # what is not seen now may still be coming back
        self._show(self._kind)
        return True

    def _decide(self, now_s: float) -> None:
        self._due_s, self._cpu_s = now_s + LOOK_S, time.thread_time()
        while self._arrived:
            token, is_there = self._arrived.popleft()
            self._shares.see(token.number, token.moment, now_s, is_there=is_there)
        while self._answers:
            self._compare(*self._answers.popleft(), now_s)
        change = self._shares.decide(now_s, self._busy(), self._is_connected)
        self._withdraw(map(str, change.withdrawn))
        for shard in sorted(change.shown):
            self._show(str(shard))

    def _compare(self, asked_s: float, there: set[_Token], now_s: float) -> None:
        """Heed an answer about all tokens, unless it lacks own ones: a router that knows these knows all."""
        own = {token.shard for token in there if token.moment == self._shares.moment}
        if own >= self._shown.keys():
            others = {(token.number, token.moment) for token in there if token.moment != self._shares.moment}
            self._shares.see_all(others, now_s, asked_s)

    def _look_again(self) -> None:
        with suppress(zenoh.ZError):  # the session is closed
            while not self._closed.wait(AGAIN_S) and not self._session.is_closed():
                asked_s = _uptime_s()
                self._answers.append((asked_s, self._there()))

    def _is_connected(self) -> bool:
        """Whether there is a router, and the same one as before: a new one hides all tokens for a while."""
        before, self._routers = self._routers, frozenset(map(str, self._session.info.routers_zid()))
        return bool(self._routers) and self._routers == before

    def _show(self, shard: str) -> None:
        key = self._key(shard=shard, moment=self._shares.moment, name=self._name)
        self._shown[shard] = self._session.liveliness().declare_token(key)

    def _withdraw(self, shards: Iterable[str]) -> None:
        for shard in shards:
            self._shown.pop(shard).undeclare()

    def _there(self) -> set[_Token]:
        replies = self._session.liveliness().get(self._pattern, timeout=ASK_S)
        found = {_Token.of(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return {token for token in found if token.is_one}

    def _on_link(self, event: zenoh.TransportEvent) -> None:
        self._n_lost += event.kind == zenoh.SampleKind.DELETE

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = _Token.of(sample.key_expr)
        if token.is_one:
            self._arrived.append((token, sample.kind == zenoh.SampleKind.PUT))
