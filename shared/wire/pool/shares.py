"""Which shards one process of a pool serves: decided from the tokens that it sees, and those that it shows.

A process that sees no claim to a shard shows one, waits until others must have seen it, and serves the shard
from then on. Of two claims the one with the lower moment stays. A process keeps a shard that it serves. If it has more
than its part, and another process less, it gives up those in which no run goes on.
"""

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from cogradar.shared.protocol.topics import ALL_SHARDS, N_SHARD
from cogradar.shared.wire.pool.live_names import LEASE_S, LEAVE_AFTER_S, RETURN_S

SETTLE_S = 0.1  # until a token that is shown at another router is seen, too
YIELD_S = 0.5  # for which an earlier claim must be there: a process that wakes takes its claims back within this time
UNTAKEN_S = LEASE_S  # after which a shard is taken by any process: the one whose turn it is hangs,
SUSPENDED_S = 60.0  # ... and for so long no shard is left to it
LATEST_NS = 8_999_999_999_999_999_999  # since 1970, of a moment that is heeded
Key = TypeVar("Key")


@dataclass
class _Seen:
    """A token of another process."""

    since_s: float
    absent_s: float = math.inf  # since when it is not there
    back_s: float = -math.inf  # when it was there again


class Change(NamedTuple):
    """Which claims are to be shown now, and which no more."""

    shown: frozenset[int]
    withdrawn: frozenset[int]


class Shares:
    """One process's part of the shards; a process is told from others by its moment."""

    def __init__(self, moment: str, *, is_spread: bool) -> None:
        """It shows nothing yet. `is_spread` False: the earliest process has all shards, the others stand by."""
        self.moment, self._is_spread = moment, is_spread
        self._former = ""  # its moment before it lapsed, of tokens that may still seem to be there
        self.held: frozenset[int] = frozenset()  # shards that it serves
        self._shown: dict[int, float] = {}  # own claims, and since when
        self._members: dict[str, _Seen] = {}  # others
        self._claims: dict[tuple[int, str], _Seen] = {}  # of others
        self._free: dict[int, float] = {}  # shards without a claim, and since when
        self._suspended: dict[str, float] = {}  # processes that did not take what was theirs, and until when
        self._settled_s = -math.inf  # until then others may still be coming back to the router
        self._has_looked = False  # whether it could take what is free

    @property
    def is_settled(self) -> bool:
        """Whether it waits for nothing: no shard is free, it serves all that it claims, and others are there to see."""
        return not self._free and self._shown.keys() == self.held and self._has_looked

    def see(self, shard: int | None, moment: str, now_s: float, *, is_there: bool) -> None:
        """A token of another process is there, or gone; shard None: the one that says that the process is there."""
        if moment in {self.moment, self._former}:
            return
        if shard is None:
            _note(self._members, moment, now_s, is_there=is_there)
        else:
            _note(self._claims, (shard, moment), now_s, is_there=is_there)

    def see_all(self, tokens: Collection[tuple[int | None, str]], now_s: float, asked_s: float = math.inf) -> None:
        """These tokens were there, and no others, some time after `asked_s`; what was seen since then stays."""
        known: dict[tuple[int | None, str], _Seen] = {(None, one): seen for one, seen in self._members.items()}
        known.update((claim, seen) for claim, seen in self._claims.items())
        for (shard, moment), seen in known.items():
            if (shard, moment) not in tokens and max(seen.since_s, seen.back_s) < asked_s:
                self.see(shard, moment, now_s, is_there=False)
        for shard, moment in tokens:
            at = known.get((shard, moment))
            if at is None or not asked_s <= at.absent_s < math.inf:
                self.see(shard, moment, now_s, is_there=True)

    def lapse(self, moment: str) -> None:
        """The process was away, and others may serve its shards: it begins anew, as another one."""
        self._former, self.moment = self.moment, moment
        self.held, self._shown = frozenset(), {}

    def decide(
        self, now_s: float, busy: Collection[int], is_connected: Callable[[], bool], *, has_router: bool = True
    ) -> Change:
        """What to show from now on; `held` is what it serves from now on.

        busy         : shards in which runs go on here
        is_connected : whether this process has a router, and has had the same one since this was asked last
        has_router   : whether it has one now: without, and until others are back, it takes nothing on, for it does not
                       see their claims
        """
        self._expire(now_s, is_connected)
        self._suspended = {one: until_s for one, until_s in self._suspended.items() if now_s < until_s}
        before = frozenset(self._shown)
        self._yield(now_s)
        if not has_router:
            self._settled_s = now_s + RETURN_S
        sees_others = has_router and now_s >= self._settled_s
        if sees_others:
            self._serve(now_s)
        self._give_up(busy)
        if sees_others:
            self._take(now_s)
        self._has_looked = sees_others
        self.held = self.held.intersection(self._shown)  # a new one: what was told of before stays as it was
        return Change(frozenset(self._shown.keys() - before), before - self._shown.keys())

    def _expire(self, now_s: float, is_connected: Callable[[], bool]) -> None:
        absent = any(seen.absent_s < math.inf for tokens in (self._members, self._claims) for seen in tokens.values())
        if absent and not is_connected():
            self._settled_s = now_s + RETURN_S
        if absent:
            self._claims = {claim: seen for claim, seen in self._claims.items() if not self._is_left(claim, now_s)}
        if not absent or now_s < self._settled_s:
            return
        self._members = {one: seen for one, seen in self._members.items() if now_s < seen.absent_s + LEAVE_AFTER_S}
        self._claims = {one: seen for one, seen in self._claims.items() if now_s < seen.absent_s + LEAVE_AFTER_S}

    def _is_left(self, claim: tuple[int, str], now_s: float) -> bool:
        """Whether a process that is there has withdrawn a claim: all its tokens would have come back by now."""
        member = self._members.get(claim[1])
        if member is None or member.absent_s < math.inf:
            return False
        return now_s >= max(self._claims[claim].absent_s, member.back_s) + SETTLE_S

    def _yield(self, now_s: float) -> None:
        """Leave shards to earlier claims; those that it serves to one that stays."""
        earlier = dict[int, float]()
        for (shard, moment), seen in self._claims.items():
            if shard in self._shown and moment < self.moment and seen.absent_s == math.inf:
                earlier[shard] = min(seen.since_s, earlier.get(shard, math.inf))
        for shard, since_s in earlier.items():
            if shard not in self.held or now_s >= since_s + YIELD_S:
                del self._shown[shard]

    def _serve(self, now_s: float) -> None:
        """Serve what it has claimed for long enough, once later claims are gone, or for longer if they stay."""
        rivalled = {shard for shard, _ in self._claims}
        self.held |= {
            shard
            for shard, since_s in self._shown.items()
            if now_s >= since_s + (UNTAKEN_S if shard in rivalled else SETTLE_S)
        }

    def _parts(self) -> dict[str, int]:
        """How many shards each process should have: the earliest may have one more."""
        members = sorted({*(self._members.keys() - self._suspended.keys()), self.moment})
        if not self._is_spread:
            return dict.fromkeys(members, 0) | {members[0]: N_SHARD}
        least, more = divmod(N_SHARD, len(members))
        return {moment: least + (i < more) for i, moment in enumerate(members)}

    def _lacks(self) -> dict[str, int]:
        """How many shards each process has too few."""
        has = [moment for _, moment in self._claims] + [self.moment] * len(self._shown)
        return {moment: max(part - has.count(moment), 0) for moment, part in self._parts().items()}

    def _give_up(self, busy: Collection[int]) -> None:
        more = len(self._shown) - self._parts()[self.moment]
        wanted = sum(self._lacks().values())
        idle = [shard for shard in sorted(self._shown, reverse=True) if shard not in busy]
        for shard in idle[: max(min(more, wanted), 0)]:
            del self._shown[shard]

    def _take(self, now_s: float) -> None:
        """Claim the free shards whose turn it is to be served here, and any that has been free for long."""
        claimed = {shard for shard, _ in self._claims} | self._shown.keys()
        self._free = {shard: self._free.get(shard, now_s) for shard in sorted(ALL_SHARDS - claimed)}
        mine, lacks = set(), self._lacks()
        for shard, since_s in self._free.items():
            most = max(sorted(lacks), key=lambda moment: lacks[moment])
            if lacks[most] > 0 and most == self.moment:
                mine.add(shard)
            elif now_s >= since_s + UNTAKEN_S:
                mine.add(shard)
                self._suspended[most] = now_s + SUSPENDED_S
            lacks[most] -= lacks[most] > 0
        self._shown |= dict.fromkeys(mine, now_s)
        self._free = {shard: since_s for shard, since_s in self._free.items() if shard not in mine}


def _note(tokens: dict[Key, _Seen], key: Key, now_s: float, *, is_there: bool) -> None:
    if is_there and key not in tokens:
        tokens[key] = _Seen(now_s)
    elif is_there and tokens[key].absent_s < math.inf:
        tokens[key].absent_s, tokens[key].back_s = math.inf, now_s
    elif key in tokens and not is_there:
        tokens[key].absent_s = min(tokens[key].absent_s, now_s)


def later_than(moments: Iterable[str], moment: str) -> str:
    """A moment that is later than all of others, whatever their clocks say."""
    nanoseconds, _, random = moment.partition("-")
    newest = max((int(one.partition("-")[0]) for one in moments), default=0)
    return f"{min(max(int(nanoseconds), newest + 1), LATEST_NS):020d}-{random}"
