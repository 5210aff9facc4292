"""Which process serves which shard: one serves each, and keeps it; the processes see each other late."""

import heapq
import itertools
import math
from collections.abc import Callable, Collection, Iterator
from functools import partial

import numpy as np
import pytest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.topics import ALL_SHARDS, N_SHARD, run_on, shard_of
from cogradar.shared.wire.pool.live_names import LEAVE_AFTER_S, RETURN_S
from cogradar.shared.wire.pool.shares import LATEST_NS, SETTLE_S, SUSPENDED_S, UNTAKEN_S, YIELD_S, Shares, later_than

LOOK_S = 0.1


class _Member:
    """A process, and what keeps it from going on."""

    def __init__(self, shares: Shares) -> None:
        self.shares = shares
        self.shown: set[int | None] = {None}
        self.busy: Collection[int] = ()
        self.hangs = self.is_cut = False


class _World:
    """Processes of a pool, and tokens that take their time."""

    def __init__(self, latency_s: Callable[[], float] = lambda: 0.001) -> None:
        self.now_s, self.members = 0.0, dict[str, _Member]()
        self._last = dict[tuple[str, str], float]()
        self._latency_s, self._due, self._n = (
            latency_s,
            list[tuple[float, int, Callable[[], None]]](),
            itertools.count(),
        )

    def start(self, moment: str, *, is_spread: bool = True) -> Shares:
        member = _Member(Shares(moment, is_spread=is_spread))
        for other, there in self.members.items():
            for shard in there.shown if not there.is_cut else ():
                member.shares.see(shard, other, self.now_s, is_there=True)
        self.members[moment] = member
        self._say(moment, None, is_there=True)
        self._look(moment)
        return member.shares

    def end(self, moment: str) -> None:
        for shard in self.members[moment].shown:
            self._say(moment, shard, is_there=False)
        del self.members[moment]

    def cut(self, moments: Collection[str], *, is_cut: bool) -> None:
        """Processes lose their router, or have it again: tokens go and come both ways."""
        for moment in moments:
            self.members[moment].is_cut = is_cut
        for moment, other in itertools.permutations(self.members, 2):
            if moment in moments or other in moments:
                is_seen = not (self.members[moment].is_cut or self.members[other].is_cut)
                for shard in self.members[moment].shown:
                    self._tell(other, shard, moment, is_there=is_seen)

    def run(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self._due and self._due[0][0] <= until_s:
            self.now_s, _, do = heapq.heappop(self._due)
            do()
        self.now_s = until_s

    def held(self) -> dict[str, int]:
        """How many shards each serves; together all, and none twice."""
        parts = [member.shares.held for member in self.members.values()]
        assert frozenset().union(*parts) == ALL_SHARDS
        assert sum(map(len, parts)) == N_SHARD
        return {moment: len(member.shares.held) for moment, member in self.members.items()}

    def _at(self, at_s: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._due, (at_s, next(self._n), do))

    def _look(self, moment: str) -> None:
        if moment not in self.members:
            return
        member = self.members[moment]
        if not member.hangs:
            change = member.shares.decide(self.now_s, member.busy, lambda: not member.is_cut)
            member.shown = member.shown - change.withdrawn | change.shown
            for shard in change.shown | change.withdrawn:
                self._say(moment, shard, is_there=shard in change.shown)
        self._at(self.now_s + LOOK_S, partial(self._look, moment))

    def _say(self, moment: str, shard: int | None, *, is_there: bool) -> None:
        for other in self.members:
            if other != moment and not (self.members[moment].is_cut or self.members[other].is_cut):
                self._tell(other, shard, moment, is_there=is_there)

    def _tell(self, other: str, shard: int | None, moment: str, *, is_there: bool) -> None:
        shares, link = self.members[other].shares, (moment, other)
        self._last[link] = max(self.now_s + self._latency_s(), self._last.get(link, 0.0))  # a link keeps the order
        self._at(self._last[link], lambda: shares.see(shard, moment, self.now_s, is_there=is_there))


def _pair() -> _World:
    world = _World()
    world.start("1")
    world.start("2")
    world.run(2.0)
    assert world.held() == {"1": 8, "2": 8}
    return world


def test_a_run_has_a_shard_and_shards_have_about_as_many_runs() -> None:
    shards = [shard_of(f"run-{i}") for i in range(1600)]
    assert (shard_of("run-0"), shard_of("run-1")) == (5, 3)  # of all programs, whatever their language
    assert all(60 < shards.count(shard) < 140 for shard in ALL_SHARDS)
    assert run_on("cogradar/10/1f3a/run/a/checkpoint/emulator") == "a"
    assert run_on("cogradar/10/query/runs") == ""


def test_one_serves_all_as_soon_as_others_would_be_seen() -> None:
    world = _World()
    alone = world.start("1")
    assert not alone.held
    assert not alone.is_settled
    world.run(SETTLE_S + LOOK_S)
    assert alone.held == ALL_SHARDS
    assert alone.is_settled


def test_who_comes_gets_shards_without_runs_and_who_goes_leaves_its_own() -> None:
    world = _World()
    world.start("1")
    world.run(1.0)
    first = world.members["1"]
    first.busy = {0, 1, 2}
    for moment in "23":
        world.start(moment)
        world.run(1.0)
    assert world.held() == {"1": 6, "2": 5, "3": 5}
    assert first.shares.held >= {0, 1, 2}
    world.end("2")
    world.run(LEAVE_AFTER_S + 3 * SETTLE_S)
    assert world.held() == {"1": 8, "3": 8}


def test_runs_that_go_on_stay_where_they_are() -> None:
    world = _World()
    world.start("1")
    world.run(1.0)
    world.members["1"].busy = ALL_SHARDS
    world.start("2")
    world.run(5.0)
    assert world.held() == {"1": 16, "2": 0}
    world.members["1"].busy = {3}
    world.run(1.0)
    assert world.held() == {"1": 8, "2": 8}


def test_a_receiver_is_led_by_the_earliest_and_the_others_stand_by() -> None:
    world = _World()
    for moment in "123":
        world.start(moment, is_spread=False)
    world.run(2.0)
    assert world.held() == {"1": 16, "2": 0, "3": 0}
    world.end("1")
    world.run(1.0)
    assert world.held() == {"2": 16, "3": 0}


def test_the_lowest_of_several_claims_stays_though_they_see_each_other_late() -> None:
    world = _World(lambda: 0.8 * YIELD_S)  # much longer than a claim waits
    for moment in "312":
        world.start(moment)
    world.run(10.0)
    assert sorted(world.held().values()) == [5, 5, 6]


def test_a_hung_process_gets_nothing_and_is_left_alone_for_a_while() -> None:
    world = _World()
    world.start("1")
    world.run(1.0)
    world.start("2")
    world.members["2"].hangs = True
    world.run(UNTAKEN_S + 1.0)
    assert world.held() == {"1": 16, "2": 0}
    world.run(10.0)
    assert world.held() == {"1": 16, "2": 0}
    world.members["2"].hangs = False
    world.run(SUSPENDED_S)
    assert world.held() == {"1": 8, "2": 8}


def test_a_router_that_is_started_again_moves_nothing() -> None:
    world = _pair()
    before = {moment: member.shares.held for moment, member in world.members.items()}
    world.cut("12", is_cut=True)
    world.run(4.0)
    world.cut("1", is_cut=False)
    world.run(0.9 * RETURN_S)
    assert {moment: member.shares.held for moment, member in world.members.items()} == before
    world.cut("2", is_cut=False)
    world.run(2.0)
    assert {moment: member.shares.held for moment, member in world.members.items()} == before


def test_of_two_that_were_apart_one_has_each_shard_again() -> None:
    """The one that was cut off may have transmitted meanwhile: it goes on, and the other one lets go."""
    world = _pair()
    world.cut("1", is_cut=True)
    world.run(RETURN_S + 2.0)
    assert world.members["2"].shares.held == ALL_SHARDS
    world.cut("1", is_cut=False)
    world.run(2.0)
    assert world.held() == {"1": 8, "2": 8}


def test_one_that_was_away_begins_anew() -> None:
    world = _pair()
    world.cut("1", is_cut=True)
    world.members["1"].hangs = True
    world.run(5.0)
    world.cut("1", is_cut=False)  # its tokens are there again before it does anything
    world.run(0.1)
    assert world.members["2"].shares.held == ALL_SHARDS
    world.end("1")
    world.run(0.8 * YIELD_S)  # they count as there for a while, and nothing is left to them
    assert world.members["2"].shares.held == ALL_SHARDS
    world.start("3")
    world.run(2.0)
    assert world.held() == {"2": 8, "3": 8}


def test_its_former_tokens_are_of_no_other_process() -> None:
    shares = Shares("1", is_spread=True)
    shares.decide(0.0, (), lambda: True)
    shares.lapse("2")
    shares.see(None, "1", 0.0, is_there=True)
    shares.see(3, "1", 0.0, is_there=True)
    assert shares.decide(0.0, (), lambda: True).shown == ALL_SHARDS


def test_without_a_router_and_until_others_are_back_nothing_is_taken() -> None:
    shares = Shares("1", is_spread=True)
    shares.decide(0.0, (), lambda: True)
    shares.lapse("2")
    assert not shares.decide(1.0, (), lambda: False, has_router=False).shown
    assert not shares.is_settled
    assert not shares.decide(1.0 + 0.9 * RETURN_S, (), lambda: True).shown
    shares.see(3, "0", 2.0, is_there=True)
    change = shares.decide(1.1 + RETURN_S, (), lambda: True)
    assert change.shown == ALL_SHARDS - {3}
    assert not shares.held


def test_a_moment_is_later_than_all_that_are_seen() -> None:
    assert later_than([], "00000000000000000007-aa") == "00000000000000000007-aa"
    assert later_than(["00000000000000000009-bb", "00000000000000000003-cc"], "00000000000000000007-aa") == (
        "00000000000000000010-aa"
    )
    latest = f"{LATEST_NS:020d}"  # what is later still is not heeded
    assert later_than([f"{latest}-bb"], "00000000000000000007-aa") == f"{latest}-aa"


@pytest.mark.parametrize("seed", range(20))
def test_whatever_happens_each_shard_is_served_by_one_in_the_end(seed: int) -> None:
    """However late tokens come, and whoever hangs, is cut off, comes or goes meanwhile."""
    rng = generator(seed, Purpose.FAULT, 0, 0)
    slow_s = float(rng.choice([0.01, 0.08, 1.0]))
    world = _World(lambda: float(rng.random()) * slow_s)
    moments = (f"{int(n):03d}-{i}" for i, n in enumerate(rng.integers(1000, size=999)))
    world.start(next(moments))
    for _ in range(30):
        _happen(world, moments, rng)
        world.run(float(rng.exponential(0.5)))
    for member in world.members.values():
        member.hangs, member.busy = False, ()
    world.cut(list(world.members), is_cut=False)
    world.run(SUSPENDED_S + 20.0)
    n = len(world.members)
    assert {math.floor(N_SHARD / n), math.ceil(N_SHARD / n)} >= set(world.held().values())


def _happen(world: _World, moments: Iterator[str], rng: np.random.Generator) -> None:
    there = list(world.members)
    who = there[rng.integers(len(there))]
    match int(rng.integers(5)):
        case 0 if len(there) < 6:
            world.start(next(moments))
        case 1 if len(there) > 1:
            world.end(who)
        case 2:
            world.members[who].hangs = not world.members[who].hangs
        case 3:
            world.members[who].busy = set(rng.integers(N_SHARD, size=int(rng.integers(12))).tolist())
        case 4:
            world.cut([who], is_cut=not world.members[who].is_cut)
        case _:
            pass


def test_an_answer_is_older_than_what_was_seen_after_it_was_asked_for() -> None:
    """Tokens that it lacks are gone, and those that it has are there, unless word of them came since."""
    shares = Shares("0" * 20 + "-1", is_spread=True)
    for moment in ("old", "new"):
        shares.see(None, moment, 1.0 if moment == "old" else 3.0, is_there=True)
    shares.see(7, "old", 1.0, is_there=True)
    shares.see(7, "old", 3.0, is_there=False)
    shares.see_all({(7, "old"), (None, "other")}, 3.1, asked_s=2.0)
    assert shares._members["old"].absent_s == 3.1
    assert shares._members["new"].absent_s == math.inf
    assert shares._members["other"].absent_s == math.inf
    assert shares._claims[7, "old"].absent_s == 3.0
    shares.see_all({(7, "old")}, 5.0, asked_s=4.0)
    assert shares._claims[7, "old"].absent_s == math.inf


def test_what_was_served_stays_as_it_was_said() -> None:
    """A core is told of what has changed: a set that grows in place would never seem to."""
    shares = Shares("a", is_spread=True)
    shares.decide(0.0, (), lambda: True)
    before = shares.held
    shares.decide(SETTLE_S, (), lambda: True)
    assert (before, shares.held) == (frozenset(), ALL_SHARDS)
