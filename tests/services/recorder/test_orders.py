"""Commands at the recorder: what is granted, from when on, what is refused, and what its checkpoints say of it."""

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import pytest

from cogradar.services.delivery import pacing
from cogradar.services.delivery.order_book import URGENT_COMMANDS
from cogradar.services.errors import NoRoom
from cogradar.services.recorder import core
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import (
    Checkpoint,
    Command,
    Message,
    Plan,
    Refused,
    RunStart,
    Scan,
    Truth,
    Waveform,
    roster_of,
)
from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Order,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
)
from cogradar.shared.protocol.words.orders import parsed
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.loop import play, smoke_start
from tests.skies import sky_start

pytestmark = pytest.mark.usefixtures("either_store")

AHEAD, DWELLS = 3, 400
HALF = PowerLimit(share=0.5)
ORTHOGONAL = Setting(key="strategy", value="orthogonal")
PRIORITY = Priority(track=0, weight=2.0)
BLANK = SectorSearch(from_deg=-90, to_deg=0, search="blank")


@pytest.fixture(scope="module")
def smoke() -> list[Message]:
    return play(smoke_start(dwells=8))


@pytest.fixture(scope="module")
def sky() -> list[Message]:
    return play(sky_start("radar.search.beams=4", dwells=30))


@pytest.fixture(autouse=True)
def _soon(smoke: list[Message], sky: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    """After these runs were played. The journal must keep up, or what is farther ahead of it is refused."""
    assert smoke
    assert sky
    monkeypatch.setattr(pacing, "MAX_AHEAD_DWELLS", AHEAD)
    monkeypatch.setattr(core, "CHECKPOINT_DWELLS", 1)


def _command(n: int, action: Action, at: int = 0) -> Command:
    return Command(run="r", id=f"{n:032x}", by="commander.me", action=action, at=at)


def _orders(answers: Sequence[Message]) -> list[Order]:
    """Those of the last checkpoint; the emulator's says the same."""
    said = [answer.orders for answer in answers if isinstance(answer, Checkpoint)]
    assert said[-1] == said[-2]
    return said[-1]


def _rows(journal: Journal, *columns: str) -> list[tuple[Any, ...]]:
    return [tuple(row[column] for column in columns) for row in journal.read("SELECT * FROM command ORDER BY n")]


def _begun(start: RunStart) -> tuple[Journal, RecorderCore]:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(start)
    return journal, core


def test_a_command_becomes_an_order_from_the_first_dwell_that_no_process_can_have_come_to() -> None:
    journal, core = _begun(smoke_start(dwells=DWELLS))
    answers = core.handle(_command(7, HALF))
    assert _orders(answers) == [Order(n=1, k=AHEAD + 1, action=HALF)]
    assert not journal.has_uncommitted
    assert _rows(journal, "id", "asker", "k", "reason", "over_k") == [
        (f"{7:032x}", "commander.me", AHEAD + 1, "", None)
    ]
    assert core.handle(_command(7, HALF)) == ()  # sent again
    assert _orders(core.handle(_command(8, EndRun(), at=300)))[1] == Order(n=2, k=300, action=EndRun())


def test_in_real_time_it_takes_effect_half_a_second_after_the_newest_dwell(smoke: list[Message]) -> None:
    start = smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0})
    journal, core = _begun(start)
    for message in smoke:
        if isinstance(message, Scan) and message.k < 5:
            core.handle(message)
    far = next(message for message in smoke if isinstance(message, Waveform)).model_copy(update={"k": 300})
    core.handle(far)  # a fault of its sender: no reason to wait
    assert _orders(core.handle(_command(1, HALF)))[0].k == 4 + 1 + 5
    core.handle(_command(2, Pause(), at=4))
    assert _rows(journal, "reason")[1] == ("dwell 4 has passed: the newest one is 4",)
    assert _orders(core.handle(_command(3, Pause(), at=5)))[1].k == 4 + 1 + 5  # to come, though nothing can shape it


def test_in_lockstep_too_a_dwell_that_has_passed_is_refused(smoke: list[Message]) -> None:
    journal, core = _begun(smoke_start(dwells=DWELLS))
    for message in smoke:
        if isinstance(message, Scan | Plan | Truth | Waveform) and message.k < 5:
            core.handle(message)
    for n, at in enumerate((1, 4, 5, 0), 1):
        core.handle(_command(n, HALF, at))
    passed = [f"dwell {at} has passed: the newest one is 4" for at in (1, 4)]
    assert [reason for (reason,) in _rows(journal, "reason")] == [*passed, "", ""]


def test_in_real_time_a_command_acts_in_the_next_dwell_of_an_acquisition(smoke: list[Message]) -> None:
    """There may never be a later one: what is not measured, as in a pause, is no dwell."""
    _, core = _begun(smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0}))
    assert _orders(core.handle(_command(1, Pause())))[0].k == 0
    core.handle(next(one for one in smoke if isinstance(one, Scan)))
    assert [one.k for one in _orders(core.handle(_command(2, Resume())))] == [0, 1]


def test_in_real_time_no_pause_of_an_acquisition_counts_dwells(smoke: list[Message]) -> None:
    """None would come: it would never end. Later ones do, and those in lockstep."""
    timed = smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0})
    for start, at, is_refused in ((timed, 0, True), (timed, 50, False), (smoke_start(dwells=DWELLS), 0, False)):
        journal, core = _begun(start)
        core.handle(_command(1, Pause(dwells=9), at=at))
        ((k, reason),) = _rows(journal, "k", "reason")
        assert (k is None, "pause without a number" in reason) == (is_refused, is_refused)
    journal, core = _begun(timed)
    for message in smoke:
        if isinstance(message, Scan):
            core.handle(message)
    core.handle(_command(1, Pause(dwells=9)))
    assert _rows(journal, "reason") == [("",)]


def test_orders_outlive_the_recorder_and_a_full_disk() -> None:
    journal, core = _begun(smoke_start(dwells=DWELLS))
    core.handle(_command(1, HALF))
    resumed = RecorderCore(journal, resume=True)
    assert _orders(resumed.handle(_command(2, EndRun(), at=200))) == [
        Order(n=1, k=AHEAD + 1, action=HALF),
        Order(n=2, k=200, action=EndRun()),
    ]
    assert [one.n for one in _orders(Recorder(journal, resume=True)._held())] == [1, 2]


def test_what_is_over_is_said_no_more(sky: list[Message], caplog: pytest.LogCaptureFixture) -> None:
    """Of two limits the newer one stays; a track that is gone needs no order. What is left ends with the run."""
    journal, core = _begun(sky_start("radar.search.beams=4", dwells=30))
    given: list[Action] = [
        HALF,
        PowerLimit(share=0.7),
        DropTrack(track=2000),
        Look(bearing_deg=10, dwells=2, share=0.1),
    ]
    for n, action in enumerate(given, 1):
        core.handle(_command(n, action, at=4 + n))
    answers = [answer for message in sky for answer in core.handle(message)]
    first = next(a for a in answers if isinstance(a, Checkpoint) and a.k >= 10)
    assert [order.n for order in first.orders] == [2]
    assert [over_k is not None for (over_k,) in _rows(journal, "over_k")] == [True, False, True, True]
    assert "r ends, and with it its orders: power 0.7; " in caplog.text


def test_an_order_to_drop_a_track_is_over_after_its_dwell_though_the_track_begins_later(sky: list[Message]) -> None:
    roster = roster_of(next(one for one in sky if isinstance(one, Scan) and one.k == 15))
    later = int(roster.ids[roster.born_k >= 5][0])
    _, core = _begun(sky_start("radar.search.beams=4", dwells=30))
    core.handle(_command(1, DropTrack(track=later), at=6))
    answers = [answer for message in sky for answer in core.handle(message)]
    assert [order.n for order in next(a for a in answers if isinstance(a, Checkpoint) and a.k >= 10).orders] == []


def test_a_priority_is_over_with_its_track_or_when_another_replaces_it(sky: list[Message]) -> None:
    """Track 1 is dropped; that of track 2001 never comes; of a known number none ends."""
    _, core = _begun(sky_start("radar.search.beams=4", dwells=30))
    given: list[tuple[Action, int]] = [(PRIORITY, 5), (DropTrack(track=0), 7), (Priority(track=2000, weight=2.0), 6)]
    for n, (action, at) in enumerate(given, 1):
        core.handle(_command(n, action, at))
    answers = [answer for message in sky for answer in core.handle(message)]
    there = roster_of(next(one for one in sky if isinstance(one, Scan) and one.k == 9)).ids
    left = [order.n for order in next(a for a in answers if isinstance(a, Checkpoint) and a.k >= 10).orders]
    assert left == ([1, 2] if 0 in there else [])
    run = RecordedRun(smoke_start(dwells=DWELLS))
    for n in (1, 2):
        _, replaced = run.grant(_command(n, PRIORITY.model_copy(update={"weight": float(n)})), n)
        assert [one.n for one in replaced] == [1][: n - 1]
    run.complete()
    assert run.orders.end(99, 98, {}) == []
    run.grant(_command(3, PRIORITY.model_copy(update={"weight": 1.0}), at=50), 3)
    assert run.orders.end(60, 59, {}) == [2, 3]


def _of_sky(sky: list[Message], *given: str) -> list[str]:
    """Why each of these commands was refused in a sky that is there up to a dwell in which it has two tracks."""
    run = RecordedRun(sky_start("radar.search.beams=4", dwells=DWELLS))
    for message in sky:
        if isinstance(message, Scan | Plan | Waveform | Truth) and message.k < 20:
            run.take(message)
    said = []
    for n, words in enumerate(given, 1):
        try:
            run.grant(_command(n, parsed(words.split())), n)
            said.append("")
        except Refused as refused:
            said.append(str(refused))
    return said


def test_an_accuracy_is_granted_where_the_power_keeps_it_and_else_refused_with_the_bound(sky: list[Message]) -> None:
    granted, refused, both, instead = _of_sky(
        sky, "accuracy 1 0.12", "accuracy 1 0.02", "accuracy 4 0.06", "accuracy 4 0.08"
    )
    assert granted == instead == ""
    bound = re.fullmatch(
        r"with (\d+)% of the power in each dwell, which is all that one track can have now, track 1 at \d+ km is known"
        r" to (0\.\d+) km across the line of sight; asked: 0.02 km",
        refused,
    )
    assert bound
    assert 45 <= int(bound[1]) <= 90  # half of what the search leaves, or more
    least = float(bound[2])
    assert _of_sky(sky, f"accuracy 1 {least + 0.001}", f"accuracy 1 {least - 0.001}")[0] == ""
    assert re.fullmatch(
        r"it takes \d+% of the power, beside the accuracies of tracks 1 \(\d+%\);"
        r" all together can have \d+%, this one \d+%",
        both,
    )
    assert _of_sky(sky, "power 0.2", "accuracy 1 0.12")[1] != ""
    assert _of_sky(sky, "accuracy 1 0.12", "accuracy 1 none", "accuracy 4 0.06") == ["", "", ""]


def test_no_drop_is_over_while_the_tracks_are_not_known() -> None:
    """In real time, with a recorder that has come back and has no scan of its first dwell."""
    start = sky_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0})
    run = RecordedRun(start, 50, 50, [Order(n=1, k=49, action=DropTrack(track=3))], resumed=True)
    run.complete()
    assert run.orders.end(run.k, run.known_k, run.born_ks) == []


def test_nothing_is_to_take_effect_after_the_end_and_what_was_is_replaced_by_it() -> None:
    journal, core = _begun(smoke_start(dwells=DWELLS))
    given: list[tuple[Action, int]] = [(HALF, 100), (HALF, 99), (EndRun(), 100), (HALF, 100), (EndRun(), 101)]
    for n, (action, at) in enumerate(given, 1):
        core.handle(_command(n, action, at))
    assert [(k, over_k) for k, over_k in _rows(journal, "k", "over_k")] == [
        *((100, 100), (99, None), (100, None), (None, None), (None, None))
    ]
    assert "it would take effect at dwell 100; the run ends with dwell 99" in _rows(journal, "reason")[3][0]
    assert [one.n for one in _orders(core.handle(_command(6, EndRun(), at=50)))] == [6]


def test_orders_that_wait_lock_out_neither_a_sector_nor_a_limit_nor_the_end() -> None:
    journal, core = _begun(sky_start(dwells=DWELLS))
    for n in range(1, 65):
        core.handle(_command(n, PowerLimit(share=n / 100), at=300 - n))
    last = max(n for n, k in _rows(journal, "n", "k") if k is not None)
    assert 32 <= last < 64
    for n in range(65, 85):  # the newest of a dwell counts
        assert HALF in [one.action for one in _orders(core.handle(_command(n, HALF)))]
        assert BLANK in [one.action for one in _orders(core.handle(_command(n + 100, BLANK)))]
    said = _orders(core.handle(_command(200, EndRun(), at=390)))
    assert said[-1].action == EndRun()
    assert len(said) == last + 3


def test_a_pause_and_its_end_find_room_where_no_limit_does() -> None:
    limits = [Order(n=n, k=5 + n, action=HALF) for n in range(1, 64)]
    run = RecordedRun(smoke_start(dwells=DWELLS), orders=limits)
    with pytest.raises(Refused, match="63 orders are in force or pending"):
        run.grant(_command(70, HALF), 70)
    paused, _ = run.grant(_command(71, Pause()), 71)
    assert run.grant(_command(72, Resume()), 72)[1] == [paused]  # of the same dwell


def test_with_old_dwells_go_the_orders_that_shape_no_other_but_no_number_comes_twice() -> None:
    journal, core = _begun(sky_start(dwells=DWELLS))
    look = Look(bearing_deg=10, dwells=9, share=0.1)
    given: list[Action] = [HALF, DropTrack(track=9), look, HALF, look]
    for n, action in enumerate(given, 1):
        core.handle(_command(n, action, at=0 if n == 2 else 5))
    for n, over_k in ((1, 30), (3, 14), (5, 14)):
        journal.end_order("r", n, over_k)
    journal.cut("r", 20)
    assert [n for (n,) in _rows(journal, "n")] == [1, 4, 5]  # 2 was refused
    assert _orders(core.handle(_command(6, HALF)))[-1].n == 6
    journal.cut("r", 40)
    assert [n for (n,) in _rows(journal, "n")] == [4, 6]


@pytest.mark.parametrize(
    ("start", "given", "reason"),
    [
        (smoke_start(dwells=8), [HALF], "it would take effect at dwell 900; the run ends with dwell "),
        (smoke_start(dwells=DWELLS), [BLANK], "sector: only where the number of targets is unknown"),
        (smoke_start(dwells=DWELLS), [DropTrack(track=0)], "drop: only where the number of targets is unknown"),
        (sky_start(dwells=DWELLS, strategy=Strategy.ORTHOGONAL), [BLANK], "there are no beams to steer"),
        (sky_start("radar.search.pattern=isotropic", dwells=DWELLS), [BLANK], "there are no beams to steer"),
        (
            sky_start(dwells=DWELLS),
            [BLANK, SectorSearch(from_deg=0, to_deg=90, search="blank")],
            "every direction would be blanked",
        ),
        (sky_start(dwells=DWELLS), [BLANK, Look(bearing_deg=-20, dwells=9, share=0.1)], "this direction is blanked"),
        (
            sky_start(dwells=DWELLS),
            3 * [Look(bearing_deg=20, dwells=9, share=0.2)],
            "looks would take 0.60 of",
        ),
        (sky_start(dwells=DWELLS), [DropTrack(track=3)], "there is no track 4; those that are there: none"),
        (sky_start(dwells=DWELLS), [Setting(key="rule", value="mode")], "tracks have none with radar.planner.looks ="),
        (sky_start(dwells=DWELLS), [Setting(key="objective", value="max-min")], "no supported combination; nearest: "),
        (sky_start(dwells=DWELLS), [BLANK, ORTHOGONAL], "no beams to steer for `sector blank"),
        (sky_start(dwells=DWELLS), [ORTHOGONAL, BLANK], "no beams to steer for `sector blank"),
        (sky_start(dwells=DWELLS), [PRIORITY], "there is no track 1"),
        (sky_start(dwells=DWELLS), [Accuracy(track=0, km=0.1)], "there is no track 1"),
        (smoke_start(dwells=DWELLS), [Accuracy(track=0, km=0.1)], "beliefs are Gaussians (radar.belief.filter ="),
        (
            smoke_start(dwells=DWELLS),
            [Priority(track=9, weight=2.0)],
            "there is no track 10; those that are there: 1, 2",
        ),
        (smoke_start(Strategy.UNIFORM, dwells=DWELLS), [PRIORITY], 'strategy is "uniform", which knows no priorities'),
        (smoke_start(dwells=DWELLS), [ORTHOGONAL, PRIORITY], 'strategy is "orthogonal", which knows no priorities'),
        (smoke_start(dwells=DWELLS), [PRIORITY, ORTHOGONAL], 'strategy is "orthogonal", which knows no priorities'),
        (
            sky_start(dwells=DWELLS),
            49 * [Look(bearing_deg=20, dwells=9, share=0.01)],
            "48 orders are in force or pending; this one must be among the first 48",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_and_the_journal_says_why(
    start: RunStart, given: list[Action], reason: str
) -> None:
    journal, core = _begun(start)
    for n, action in enumerate(given, 1):
        answers = core.handle(_command(n, action, at=900 if start.dwells == 8 else 0))
    assert answers == []
    *granted, (k, said) = _rows(journal, "k", "reason")
    assert k is None
    assert reason in said
    assert {said for _, said in granted} <= {""}


def test_however_much_was_asked_of_a_run_it_can_be_paused_resumed_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of all its commands are kept for that; what is refused then is not written down."""
    monkeypatch.setattr("cogradar.services.recorder.core.MAX_COMMANDS", URGENT_COMMANDS + 3)
    journal, core = _begun(smoke_start(dwells=9000))
    asked: list[tuple[Action, int]] = [(ORTHOGONAL, 300), (DropTrack(track=0), 0)]  # the second is refused
    asked += [(ORTHOGONAL, 400), (EndRun(), 500), (Pause(), 0), (DropTrack(track=0), 0)]
    asked += [(action, 10_000_000) for action in (EndRun(), Pause(), HALF)]
    asked += [(action, 0) for _ in range(URGENT_COMMANDS) for action in (Pause(), Resume())]
    for n, (action, at) in enumerate([*asked, (EndRun(), 0)], 1):
        with suppress(Refused):
            core.handle(_command(n, action, at))
    kinds = [json.loads(action)["kind"] for (action,) in _rows(journal, "action")]
    assert kinds[:3] == ["set", "drop", "pause"]
    assert len(kinds) == URGENT_COMMANDS + 3
    assert kinds[-1] == "end"
    assert _rows(journal, "k")[-1][0] == AHEAD + 1


def test_what_accuracies_are_refused_by_is_loaded_once_beside_the_first_run_that_takes_them() -> None:
    begun = list[object]()
    recorder = Recorder(Journal(":memory:"), beside=begun.append)
    recorder.handle(smoke_start(dwells=9).model_copy(update={"run": "particles"}))
    recorder.handle(Tick(0.0))
    assert begun == []
    recorder.handle(sky_start(dwells=9))
    for at_s in (0.25, 0.5):
        recorder.handle(Tick(at_s))
    assert len(begun) == 1


def test_a_run_that_is_not_there_is_not_commanded_nor_one_without_room() -> None:
    journal, core = _begun(smoke_start())
    with pytest.raises(Refused, match="no such run goes on"):
        core.handle(_command(1, HALF).model_copy(update={"run": "other"}))
    recorder = Recorder(journal, resume=True)
    recorder._end(NoRoom("run.db: the disk is full"))
    with pytest.raises(Refused, match="disk is full; all runs are held"):
        recorder.handle(_command(1, HALF))
    recorder.handle(Tick(0.0))
