"""One process's part in a pool: what it does with the tokens that it shows and sees, and whether it was away.

The tokens and the clocks are handed in (`tokens`: over Zenoh; a simulation has others).
"""

import logging
import math
import re
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple, Protocol, Self

from cogradar.shared.protocol.topics import ALL_SHARDS, run_on, shard_of
from cogradar.shared.wire.pool.live_names import LEASE_S
from cogradar.shared.wire.pool.shares import SETTLE_S, Shares, later_than

PAUSE_S = 0.5 * LEASE_S  # after which a process that did nothing, and did not compute, looks whether it was missed
WAKE_S = 0.2  # for threads of the transport to see that their link was closed
LOOK_S = 0.1  # between two decisions
ASK_S = 1.0  # for an answer about tokens
LATE_S = 3 * SETTLE_S  # from a look at tokens until the own one is seen: after that others may have looked in vain
MORE_LOOKS = 4  # at tokens, if own ones are not among them
_PRESENT = "any-"  # begins the part of a key that is no shard
_NUMBERS = {str(shard): shard for shard in ALL_SHARDS}
_MOMENT = re.compile("0[0-8][0-9]{18}-[0-9a-f]{8}")  # until 2255, `LATEST_NS`
log = logging.getLogger(__name__)


class Token(NamedTuple):
    """What a process shows: that it is there, or that it claims a shard."""

    shard: str
    moment: str
    name: str

    @classmethod
    def of(cls, key: object) -> Self:
        """The token on a key."""
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


class Tokens(Protocol):
    """The tokens of all processes of a pool as one of them sees them, and its clocks.

    arrived : what was seen: a token, and whether it is there or gone
    answers : to the last question for all tokens: when it was asked, and what was there
    n_lost  : links to routers that were lost
    """

    arrived: deque[tuple[Token, bool]]
    answers: deque[tuple[float, set[Token]]]
    n_lost: int

    def now_s(self) -> float:
        """A clock that goes on while the machine is suspended, as the leases of the others do."""

    def cpu_s(self) -> float:
        """Time that this thread has computed."""

    def moment(self) -> str:
        """The time of day, and what makes it unique."""

    def wait(self, seconds: float) -> None:
        """Let threads of the transport go on."""

    def watch(self) -> None:
        """From now on let tokens arrive, and ask for all of them now and then."""

    def there(self) -> set[Token]:
        """Ask for all tokens now."""

    def routers(self) -> frozenset[str]:
        """The routers that this process is connected with."""

    def show(self, shard: str, moment: str) -> Callable[[], None]:
        """Show a token of this process; the answer withdraws it."""

    def close(self) -> None:
        """Watch no more."""


class Pool:
    """A process's part in a pool. What others show is noted by threads of the transport; all else is done by the
    thread that owns the core.
    """

    def __init__(
        self, tokens: Tokens, busy: Callable[[], Collection[int]], *, kind: str = "", is_spread: bool = True
    ) -> None:
        """See which processes are there. Nothing is shown yet.

        busy      : the shards in which runs go on here
        kind      : of the process: a pool is of one kind
        is_spread : whether shards are shared out, or one process has all
        """
        self._tokens, self._busy, self._kind = tokens, busy, f"{_PRESENT}{zlib.crc32(kind.encode()):08x}"
        self._shown: dict[str, Callable[[], None]] = {}  # own tokens by their shards; a call withdraws one
        self._told: frozenset[int] | None = None  # what the core knows
        self._due_s = self._looked_s = 0.0
        self._cpu_s = 0.0  # of this thread, when it looked last
        self._routers = tokens.routers()
        self._shown_s, self._is_late = -math.inf, False  # when it showed that it is there, and whether others missed it
        self._n_known = 0  # links to routers that were lost, when this process looked last
        there = tokens.there()  # asked first: an answer just after the subscription may be empty
        tokens.watch()
        tokens.wait(SETTLE_S)
        seen = {*there, *(token for token, is_there in list(tokens.arrived) if is_there)}
        moment = later_than((token.moment for token in seen), tokens.moment())
        self._shares = Shares(moment, is_spread=is_spread)
        self._shares.see_all({(token.number, token.moment) for token in there}, tokens.now_s())

    @property
    def held(self) -> frozenset[int]:
        """The shards that this process serves."""
        return self._shares.held

    def others(self, *, is_shown: bool = False) -> list[str]:
        """Names of processes of another kind that are there.

        is_shown : this process has joined, and asks for those only that began before it: of two that began at once the
                   earlier one stays. One that was delayed each time that it joined asks for all: they may not have
                   seen it
        """
        if is_shown:
            self._tokens.wait(max(self._shown_s + LATE_S + SETTLE_S - self._tokens.now_s(), 0.0))
        others = [token for token in self._all() if token.shard.startswith(_PRESENT) and token.shard != self._kind]
        is_heeded = not is_shown or self._is_late
        return sorted(token.name for token in others if is_heeded or token.moment < self._shares.moment)

    def begin(self) -> None:
        """Show that this process is there; it claims its part from now on."""
        self._show(self._kind)
        self._looked_s, self._cpu_s = self._tokens.now_s(), self._tokens.cpu_s()

    def join(self, check: Callable[[], None]) -> None:
        """Show that this process is there, and claim its part; over when it serves it. `check` may raise to give up.

        One that was delayed before it was seen takes its token back and joins anew, behind all that have come.
        """
        self._enter()
        for _ in range(MORE_LOOKS):
            if not self._is_late:
                break
            check()
            self._withdraw(list(self._shown))
            self._enter()
        while True:
            self._decide(self._tokens.now_s())
            if self._shares.is_settled:
                return
            check()
            self._tokens.wait(SETTLE_S / 2)

    def _enter(self) -> None:
        """Show that this process is there, with a moment that is later than all that it sees."""
        asked_s = self._tokens.now_s()
        seen = {token.moment for token in self._all()} | {token.moment for token, _ in list(self._tokens.arrived)}
        self._shares.lapse(later_than(seen, self._tokens.moment()))
        self.begin()
        self._tokens.wait(SETTLE_S)
        self._shown_s = self._tokens.now_s()
        self._is_late = self._shown_s > asked_s + LATE_S

    def news(self) -> frozenset[int] | None:
        """The shards that are served from now on, if the core does not know them yet."""
        self.has_paused()
        now_s = self._looked_s
        if now_s >= self._due_s or self._tokens.arrived:
            self._decide(now_s)
        return self._tell()

    def has_paused(self) -> bool:
        """Whether this process has done nothing for so long that it was missed, and serves nothing any more.

        Asked before anything is handled that has waited meanwhile, or is due: what others do now is not to be done
        twice.
        """
        now_s, is_missed = self._tokens.now_s(), False
        if (gap_s := now_s - self._looked_s) > PAUSE_S:
            is_missed = gap_s - (self._tokens.cpu_s() - self._cpu_s) > PAUSE_S and self._is_missed()
            now_s = self._tokens.now_s()  # to ask took its time, too
        self._looked_s, self._cpu_s, self._n_known = now_s, self._tokens.cpu_s(), self._tokens.n_lost
        return is_missed

    def serves(self, key: str) -> bool:
        """Whether a message on a key is of a run that is served here."""
        return shard_of(run_on(key)) in self._shares.held

    def close(self) -> None:
        """Leave it."""
        self._tokens.close()
        self._withdraw(list(self._shown))

    def _tell(self) -> frozenset[int] | None:
        if self._told == self._shares.held:
            return None
        self._told = self._shares.held
        return self._told

    def _is_missed(self) -> bool:
        """Whether its tokens are not what it showed, or others have claims to what it serves: it begins anew then.

        What is asked may be answered by what this session knows. So its threads get the time to learn what has
        happened: they have been frozen, too. Beside other work an answer may lack tokens that this session was told of
        before: they count, too.
        """
        self._tokens.wait(WAKE_S)
        there = self._all()
        own = {token.shard for token in there if token.moment == self._shares.moment}
        told = dict(list(self._tokens.arrived))  # of each what was told last
        there |= {token for token, is_there in told.items() if is_there}
        others = {(token.number, token.moment) for token in there if token.moment != self._shares.moment}
        is_seen = self._tokens.n_lost == self._n_known and own >= self._shown.keys()
        if is_seen and not any(shard in self.held for shard, _ in others):
            return False
        log.warning("this process was away, and others may serve its runs: it drops them, and joins again")
        self._withdraw(list(self._shown))
        self._shares.lapse(later_than((token.moment for token in there), self._tokens.moment()))
        self._shares.see_all(others, self._tokens.now_s())
        self._routers = frozenset()  # what is not seen now may still be coming back
        self._show(self._kind)
        return True

    def _all(self) -> set[Token]:
        """All tokens. Of a process that computes, an answer may come before the threads of its transport have had
        their turn, and is empty then: if it lacks own tokens, they are asked for again. So they are if it took as long
        as it may: it was cut off, and has perhaps no more than own ones, which no router is needed for.
        """
        for _ in range(1 + MORE_LOOKS):
            asked_s = self._tokens.now_s()
            there = self._tokens.there()
            own = {token.shard for token in there if token.moment == self._shares.moment}
            if own >= self._shown.keys() and self._tokens.now_s() < asked_s + ASK_S:
                break
            self._tokens.wait(LOOK_S)
        return there

    def _decide(self, now_s: float) -> None:
        self._due_s = now_s + LOOK_S
        while self._tokens.arrived:
            token, is_there = self._tokens.arrived.popleft()
            self._shares.see(token.number, token.moment, now_s, is_there=is_there)
        while self._tokens.answers:
            self._compare(*self._tokens.answers.popleft(), now_s)
        has_router = bool(self._tokens.routers())
        change = self._shares.decide(now_s, self._busy(), self._is_connected, has_router=has_router)
        self._withdraw(map(str, change.withdrawn))
        for shard in sorted(change.shown):
            self._show(str(shard))

    def _compare(self, asked_s: float, there: set[Token], now_s: float) -> None:
        """Heed an answer about all tokens, unless it lacks own ones: a router that knows these knows all."""
        own = {token.shard for token in there if token.moment == self._shares.moment}
        if own >= self._shown.keys():
            others = {(token.number, token.moment) for token in there if token.moment != self._shares.moment}
            self._shares.see_all(others, now_s, asked_s)

    def _is_connected(self) -> bool:
        """Whether there is a router, and the same one as before: a new one hides all tokens for a while."""
        before, self._routers = self._routers, self._tokens.routers()
        return bool(self._routers) and self._routers == before

    def _show(self, shard: str) -> None:
        self._shown[shard] = self._tokens.show(shard, self._shares.moment)

    def _withdraw(self, shards: Iterable[str]) -> None:
        for shard in shards:
            self._shown.pop(shard)()
