"""A pool over real tokens: who is there, who is gone, and who was away."""

import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from threading import Barrier

import pytest

from cogradar.shared.protocol.topics import ALL_SHARDS, Role, shard_of
from cogradar.shared.wire.pool import members
from cogradar.shared.wire.pool.members import Pool, Token
from cogradar.shared.wire.pool.shares import SETTLE_S
from cogradar.shared.wire.pool.tokens import ZenohTokens
from cogradar.shared.wire.session import open_session

WITHIN_S = 10.0

pytestmark = pytest.mark.zenoh


class _Process:
    def __init__(self, router: str, name: str, kind: str = "", build: str = "1f3a") -> None:
        self.session = open_session([router], WITHIN_S, lambda: None)
        self.busy: Collection[int] = ()
        self.tokens = ZenohTokens(self.session, Role.EMULATOR, name, build)
        self.pool = Pool(self.tokens, lambda: self.busy, kind=kind)


@pytest.fixture
def start(router: str) -> Iterator[Callable[..., _Process]]:
    with ExitStack() as stack:

        def begin(*args: str) -> _Process:
            process = _Process(router, *args)
            stack.callback(process.session.close)
            process.pool.join(lambda: None)
            return process

        yield begin


def _until(processes: Collection[_Process], holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + WITHIN_S
    while not holds():
        assert time.monotonic() < until_s, [sorted(one.pool.held) for one in processes]
        for process in processes:
            process.pool.news()
        time.sleep(0.01)


def _share(processes: Collection[_Process], *parts: int) -> None:
    def is_shared() -> bool:
        held = [one.pool.held for one in processes]
        is_whole = frozenset().union(*held) == ALL_SHARDS and sum(map(len, held)) == len(ALL_SHARDS)
        return is_whole and [len(one) for one in held] == list(parts)

    _until(processes, is_shared)


def test_shards_are_shared_and_taken_over(start: Callable[..., _Process]) -> None:
    first = start("a")
    assert first.pool.held == ALL_SHARDS
    assert first.pool.news() == ALL_SHARDS
    assert first.pool.news() is None
    other_build = start("x", "", "2e4b")
    assert other_build.pool.held == ALL_SHARDS
    second = start("a")  # a name is no identity
    _share([first, second], 8, 8)
    assert first.pool.serves("cogradar/10/1f3a/run/r/scan") is (shard_of("r") in first.pool.held)
    first.session.close()  # as when it is killed
    _share([second], 16)


def test_word_of_one_that_is_gone_may_be_lost(
    start: Callable[..., _Process],
) -> None:
    first, second = start("a"), start("b")
    _share([first, second], 8, 8)
    assert second.tokens._watch is not None
    second.tokens._watch.undeclare()  # so it hears of no token any more
    first.session.close()
    _share([second], 16)


def test_another_kind_is_named(start: Callable[..., _Process]) -> None:
    started = [start(*one) for one in (("a",), ("b", "zenoh:roof"), ("c", "zenoh:roof", "2e4b"))]
    assert [one.pool.others() for one in started] == [["b"], ["a"], []]  # a token lives as long as its pool is kept


def test_an_answer_that_was_cut_off_is_asked_for_again(
    start: Callable[..., _Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A router that is slow, or frozen: own tokens are in the answer all the same."""
    first, second = start("a", "", "5f7a"), start("b", "zenoh:roof", "5f7a")
    there, asked = second.tokens.there, list[float]()

    def cut_off() -> set[Token]:
        if threading.current_thread() is not threading.main_thread():  # it looks again now and then
            return there()
        asked.append(time.monotonic())
        if len(asked) > 1:
            return there()
        time.sleep(members.ASK_S)
        return {token for token in there() if token.name == "b"}

    monkeypatch.setattr(second.tokens, "there", cut_off)
    assert second.pool.others() == ["a"]
    assert first.pool.others() == ["b"]
    assert (
        1 < len(asked) <= 1 + members.MORE_LOOKS
    )  # beside other work an answer may lack own tokens, too, and is asked for once more


def test_of_kinds_that_start_at_once_the_later_one_sees_the_other_when_they_have_joined(router: str) -> None:
    one, other = _Process(router, "a"), _Process(router, "b", "zenoh:roof")
    assert one.pool.others() == other.pool.others() == []
    for process in (one, other):
        process.pool._show(process.pool._kind)
    until_s = time.monotonic() + WITHIN_S  # as a rule as soon as each serves; beside other tests it may take longer
    while (one.pool.others(), other.pool.others()) != (["b"], ["a"]):
        assert time.monotonic() < until_s
        time.sleep(SETTLE_S)
    assert (one.pool.others(is_shown=True), other.pool.others(is_shown=True)) == ([], ["a"])
    for process in (one, other):
        process.session.close()


@pytest.mark.parametrize("is_at_show", [False, True])
def test_one_that_was_delayed_before_it_was_seen_leaves_the_other_its_pool(
    router: str, monkeypatch: pytest.MonkeyPatch, *, is_at_show: bool
) -> None:
    """The other one looked, joined and looked again meanwhile, and saw nothing: it will not look any more."""
    late, other = (_Process(router, *one, "3d5c") for one in (("a", ""), ("b", "zenoh:roof")))
    show, said = late.tokens.show, list[list[str]]()

    def join_other() -> None:
        other.pool.join(lambda: None)
        said.append(other.pool.others(is_shown=True))

    def delayed(shard: str, moment: str) -> Callable[[], None]:
        if not said:
            join_other()
        return show(shard, moment)

    if is_at_show:
        monkeypatch.setattr(late.tokens, "show", delayed)
    else:
        join_other()

    def go_on() -> None:
        other.pool.news()

    late.pool.join(go_on)
    assert (said, late.pool.others(is_shown=True)) == ([[]], ["b"])
    for process in (late, other):
        process.session.close()


def test_of_two_kinds_that_were_both_delayed_one_stays(router: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each looked before the other one was seen, and each was seen late: each left to the other what neither had."""
    both = [_Process(router, *one, "4a6b") for one in (("a", ""), ("b", "zenoh:roof"))]
    looked, joined = Barrier(2), Barrier(2)

    def join(process: _Process) -> list[str]:
        show, now_s, ahead_s = process.tokens.show, process.tokens.now_s, [0.0]

        def delayed(shard: str, moment: str) -> Callable[[], None]:
            if not ahead_s[0]:
                looked.wait(WITHIN_S)
                ahead_s[0] = 10.0
            return show(shard, moment)

        monkeypatch.setattr(process.tokens, "show", delayed)
        monkeypatch.setattr(process.tokens, "now_s", lambda: now_s() + ahead_s[0])
        process.pool.join(lambda: None)
        joined.wait(WITHIN_S)
        return process.pool.others(is_shown=True)

    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(join, both))
    assert sorted(found) in ([[], ["a"]], [[], ["b"]])
    for process in both:
        process.session.close()


@pytest.mark.parametrize("sees", ["no own token", "own tokens and others", "own tokens alone"])
def test_one_that_was_frozen_serves_nothing_when_it_goes_on(
    sees: str, start: Callable[..., _Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The router drops its tokens when its lease is over; a link that comes back shows them again.

    An answer about tokens may lack others beside work. It has no token at all often then, so one is awaited here.
    """
    first, second = start("a"), start("b")
    _share([first, second], 8, 8)
    shown = list(first.pool._shown)
    first.pool._withdraw(shown)
    _share([second], 16)
    if sees == "no own token":
        first.pool._shown = dict.fromkeys(shown, lambda: None)
    else:
        for shard in shown:
            first.pool._show(shard)
    own_alone = sees == "own tokens alone"
    real = first.tokens.there
    monkeypatch.setattr(first.tokens, "there", lambda: {one for one in real() if not own_alone or one.name == "a"})
    until_s = time.monotonic() + WITHIN_S
    while len({token for token, _ in list(first.tokens.arrived) if token.name == "b"}) < 8:
        assert time.monotonic() < until_s
        time.sleep(0.01)
    monkeypatch.setattr(members, "PAUSE_S", 0.0)
    time.sleep(0.05)  # it is frozen, while this thread computes nothing
    assert first.pool.has_paused()
    assert first.pool.news() == frozenset()


def test_what_was_told_before_takes_nothing_from_an_answer(
    start: Callable[..., _Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another one's claim was withdrawn, is shown again, and word of that is on its way: the answer has it."""
    first = start("a")
    _share([first], 16)
    rival, real = Token("3", first.tokens.moment(), "b"), first.tokens.there
    monkeypatch.setattr(first.tokens, "there", lambda: {*real(), rival})
    monkeypatch.setattr(first.tokens, "arrived", deque([(rival, True), (rival, False)]))
    monkeypatch.setattr(members, "PAUSE_S", 0.0)
    time.sleep(0.05)
    assert first.pool.has_paused()


def test_one_that_was_only_busy_keeps_what_it_serves(
    start: Callable[..., _Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = start("a"), start("b")
    _share([first, second], 8, 8)
    monkeypatch.setattr(members, "PAUSE_S", 0.0)
    assert not first.pool.has_paused()
    assert len(first.pool.held) == 8


def test_what_no_program_shows_is_not_heeded(start: Callable[..., _Process]) -> None:
    """A number of thousands of digits is an error to whatever reads it; nothing may be later than all that comes."""
    for shard, moment in (
        ("1" * 5000, "01795786253003373525-dc646a39"),
        ("16", "01795786253003373525-dc646a39"),
        ("3", "9" * 5000 + "-dc646a39"),
        ("3", "99999999999999999999-dc646a39"),
        ("3", "x"),
    ):
        assert not members.Token.of(f"cogradar/share/9/b/emulator/{shard}/{moment}/a").is_one
    process = start("a")
    key = process.tokens._key(shard="3", moment="9" * 5000, name="b")
    process.session.liveliness().declare_token(key)
    other = start("b")
    _share([process, other], 8, 8)


@pytest.mark.parametrize(
    ("gaps", "paused"),
    [
        (((5.0, 4.5), (0.2, 0.0), (5.0, 3.5)), [False, False, True]),
        (((5.0, 5.0), (4.0, 0.0)), [False, True]),  # what was computed before a look hides no freeze after it
    ],
)
def test_computing_is_no_pause(
    gaps: tuple[tuple[float, float], ...],
    paused: list[bool],
    start: Callable[..., _Process],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    process, clocks = start("a"), {"up": 1e6, "cpu": 0.0}
    monkeypatch.setattr(process.tokens, "now_s", lambda: clocks["up"])
    monkeypatch.setattr(process.tokens, "cpu_s", lambda: clocks["cpu"])
    monkeypatch.setattr(process.pool, "_is_missed", lambda: True)
    process.pool._looked_s, process.pool._cpu_s = clocks["up"], clocks["cpu"]
    found = []
    for up, cpu in gaps:
        clocks["up"], clocks["cpu"] = clocks["up"] + up, clocks["cpu"] + cpu
        found.append(process.pool.has_paused())
    assert found == paused


def test_an_answer_without_own_tokens_is_asked_for_again(
    start: Callable[..., _Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    process = start("a")
    _share([process], 16)
    real, empty = process.tokens.there, [set[Token]()] * 2
    monkeypatch.setattr(process.tokens, "there", lambda: empty.pop() if empty else real())
    assert not process.pool._is_missed()
    assert len(process.pool.held) == 16
