"""Snapshots of tracks: when they are sent, which ones are kept, and that nobody replays what lies before them."""

import itertools
from collections import deque
from collections.abc import Collection, Iterable
from typing import Any

import numpy as np
import pytest

from cogradar.services.delivery.pacing import MAX_WAIT_S
from cogradar.services.planner import owned_track
from cogradar.services.planner import run as planned_run
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder import core as recorder
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Refused, RunEnd, Scan
from cogradar.shared.protocol.recovery import History, ScanRecall, Snapshot
from cogradar.shared.protocol.topics import Role, is_for
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.runner import Flush
from tests.services.loop import checkpoint, plans, scans, smoke_start
from tests.services.loop import play as play_cores

EVERY, DWELLS = 4, 40
RATE_HZ = 10.0
START = smoke_start(dwells=DWELLS)


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Snapshots and checkpoints so close that a short run has several."""
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", EVERY)
    monkeypatch.setattr(recorder, "CHECKPOINT_DWELLS", 2)


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play_cores(START)


def _last_k(sent: list[Message]) -> int:
    return max(scan.k for scan in scans(sent))


def _told(core: RecorderCore | PlannerCore, messages: Iterable[Event]) -> list[Message]:
    """All answers."""
    return [answer for message in messages for answer in core.handle(message) if isinstance(answer, Message)]


def _snapshots(messages: Iterable[Message | Flush]) -> list[Snapshot]:
    return [message for message in messages if isinstance(message, Snapshot)]


class Recorded:
    """A metrics service that received a run up to this dwell, and the snapshots that a planner sent all the while."""

    def __init__(self, sent: list[Message], until: int, lost: Collection[int] = ()) -> None:
        """Those of the tracks `lost` do not arrive."""
        self.store = Journal(":memory:")
        self.core, planner = RecorderCore(self.store), PlannerCore("before")
        self.snapshots: list[Snapshot] = []
        for message in sent:
            if getattr(message, "k", 0) > until or isinstance(message, Checkpoint | RunEnd):
                continue
            checkpoints = list(self.core.handle(message))
            taken = _told(planner, [*checkpoints, *([message] if isinstance(message, Scan) else [])])
            self.snapshots += [answer for answer in taken if isinstance(answer, Snapshot)]
            _told(self.core, [snapshot for snapshot in _snapshots(taken) if snapshot.target not in lost])

    def kept(self) -> list[dict[str, Any]]:
        return self.store.read("SELECT * FROM snapshot ORDER BY target")


def _converse(planner: PlannerCore, core: RecorderCore, first: Event) -> tuple[list[Plan], list[ScanRecall]]:
    """What a planner says and asks until metrics has told it all it wants to know."""
    answers, asked, planned = _told(planner, [first]), list[ScanRecall](), list[Plan]()
    while answers:
        planned += [answer for answer in answers if isinstance(answer, Plan)]
        questions = [answer for answer in answers if isinstance(answer, ScanRecall)]
        asked += questions
        answers = _told(planner, _told(core, questions))
    return planned, asked


def _bytes(messages: Iterable[Message]) -> list[bytes]:
    return sorted(encode(message) for message in messages)


def _planned(sent: list[Message], first_k: int, last_k: int = 10_000) -> list[bytes]:
    return _bytes(plan for plan in plans(sent) if first_k <= plan.k <= last_k)


# What is asked for.


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("again", [False, True])
def test_planners_that_ask_at_the_same_time_do_not_ask_for_each_others_answers(
    workers: int, again: bool, sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without snapshots the history comes in rounds, each to the one who asked."""
    monkeypatch.setattr("cogradar.services.recorder.recall.MAX_HISTORY", 4)
    k = 36
    before = Recorded(sent, k, lost=(0, 1))
    names = tuple(f"p{i}" for i in range(workers))
    planners = [PlannerCore(name) for name in names]
    waiting: deque[ScanRecall] = deque()
    events: list[Event] = [Membership("planner", names), *[checkpoint(START, k, k)] * (2 if again else 1)]
    for event in events:
        for planner in planners:
            waiting += [answer for answer in _told(planner, [event]) if isinstance(answer, ScanRecall)]
    asked = 0
    while waiting:
        asked += 1
        answers = before.core.handle(waiting.popleft())
        for name, planner in zip(names, planners, strict=True):
            mine = [answer for answer in answers if is_for(answer, Role.PLANNER, name)]
            waiting += [answer for answer in _told(planner, mine) if isinstance(answer, ScanRecall)]
        assert asked <= (workers + again * workers) * (k / 4 + 2)


# When they are sent.


def test_a_snapshot_waits_until_its_dwell_is_in_the_store(sent: list[Message]) -> None:
    """Whoever goes on from it will not plan its dwell again."""
    planner = PlannerCore("p")
    planner.handle(checkpoint(START))
    assert _snapshots(_told(planner, scans(sent)[: 2 * EVERY])) == []
    assert _snapshots(planner.handle(checkpoint(START, EVERY - 1))) == []
    taken = _snapshots(planner.handle(checkpoint(START, EVERY)))
    assert [(snapshot.k, snapshot.target) for snapshot in taken] == [(EVERY - 1, 0), (EVERY - 1, 1)]
    assert _snapshots(planner.handle(checkpoint(START, 2 * EVERY))) == []


def test_two_owners_say_the_same(sent: list[Message]) -> None:
    one, other = Recorded(sent, 20).snapshots, Recorded(sent, 20).snapshots
    assert one == other
    assert len(one) >= 6


# Which ones are kept.


def test_the_store_keeps_only_the_newest_of_each_track(sent: list[Message]) -> None:
    recorded = Recorded(sent, _last_k(sent), lost=(0, 1))
    received = recorded.snapshots
    assert len({snapshot.k for snapshot in received}) > 3
    for i in np.random.default_rng(1).permutation(2 * len(received)):  # repeated, and in any order
        assert recorded.core.handle(received[i // 2]) == ()
    newest = {snapshot.target: snapshot for snapshot in received}  # they were sent in order
    assert [(row["target"], row["payload"]) for row in recorded.kept()] == [(m + 1, encode(newest[m])) for m in (0, 1)]


def test_a_snapshot_ahead_of_the_store_is_refused(sent: list[Message]) -> None:
    newest = Recorded(sent, 20).snapshots[-1]
    behind = Recorded(sent, newest.k - 1)
    kept = behind.kept()
    with pytest.raises(Refused, match="snapshot of dwell"):
        behind.core.handle(newest)
    assert behind.kept() == kept


@pytest.mark.parametrize("changed", [{"target": 2}, {"belief": np.ones((9, 4)), "remembered": np.empty((0, 4))}])
def test_a_snapshot_of_another_scenario_is_refused(changed: dict[str, Any], sent: list[Message]) -> None:
    recorded, planner = Recorded(sent, 20, lost=(0, 1)), PlannerCore("p")
    planner.handle(checkpoint(START, 10, 5))
    bad = recorded.snapshots[0].model_copy(update=changed)
    with pytest.raises(Refused, match=r"snapshot of|track 2 in dwell"):
        recorded.core.handle(bad)
    with pytest.raises(Refused, match=r"snapshot of|track 2 in dwell"):
        planner.handle(History(run="r", to="p", topic="snapshot", k=bad.k, payloads=[encode(bad)]))
    assert recorded.kept() == []


def test_snapshots_of_a_run_that_is_over_or_unknown_are_dropped(sent: list[Message]) -> None:
    recorded = Recorded(sent, _last_k(sent))
    assert len(recorded.kept()) == 2
    assert isinstance(sent[-1], RunEnd)
    recorded.core.handle(sent[-1])
    assert recorded.kept() == []
    late = recorded.snapshots[-1]
    for snapshot in (late, late.model_copy(update={"run": "unknown"})):
        assert recorded.core.handle(snapshot) == ()
    recorded.core.handle(smoke_start(run="unknown"))
    assert recorded.kept() == []


def test_a_metrics_that_comes_back_has_them_and_one_that_gives_the_run_up_has_not(sent: list[Message]) -> None:
    recorded = Recorded(sent, 20)
    question = ScanRecall(run="r", k=0, targets=[0, 1], planner="new")
    assert RecorderCore(recorded.store, resume=True).handle(question) == recorded.core.handle(question)
    assert len(recorded.kept()) == 2
    RecorderCore(recorded.store)
    assert recorded.kept() == []


# Who goes on from them.


def test_a_planner_that_comes_back_asks_for_no_old_scans(sent: list[Message]) -> None:
    """Not even for those of the acquisition; what it plans is what was planned without a fault."""
    recorded, stored = Recorded(sent, 22), 22
    planned, asked = _converse(PlannerCore("new"), recorded.core, checkpoint(START, stored, 10))
    assert [type(message) for message in recorded.core.handle(asked[0])] == [History, History]
    assert {message.topic for message in _told(recorded.core, asked[:1]) if isinstance(message, History)} == {
        "snapshot"
    }
    (since,) = {row["k"] + 1 for row in recorded.kept()}
    assert since > EVERY
    assert asked == [ScanRecall(run="r", k=k, targets=[0, 1], planner="new") for k in (0, since)]
    assert _bytes(planned) == _planned(sent, stored, 22)


def test_a_planner_that_takes_a_track_over_needs_the_snapshot_only(sent: list[Message]) -> None:
    """The scans since are those that it kept for its own track."""
    recorded, stored, planner = Recorded(sent, 22), 22, PlannerCore("a")
    planner.handle(Membership("planner", ("a", "b")))
    mine, _ = _converse(planner, recorded.core, checkpoint(START, stored, 10, resend=True))
    assert len({plan.target for plan in mine}) == 1
    taken_over, asked = _converse(planner, recorded.core, Membership("planner", ("a",)))
    assert asked == [ScanRecall(run="r", k=0, targets=[1 - mine[0].target], planner="a")]
    assert _bytes([*mine, *taken_over]) == _planned(sent, stored, 22)
    later = [scan for scan in scans(sent) if scan.k > 22]
    assert _bytes(plan for plan in _told(planner, later) if isinstance(plan, Plan)) == _planned(sent, 23)


@pytest.mark.parametrize("lost", [(0, 1), (1,)])
def test_without_a_snapshot_the_whole_history_does(lost: tuple[int, ...], sent: list[Message]) -> None:
    recorded = Recorded(sent, 22, lost)
    planned, asked = _converse(PlannerCore("new"), recorded.core, checkpoint(START, 22, 10))
    assert asked[0] == ScanRecall(run="r", k=0, targets=[0, 1], planner="new")
    assert _bytes(planned) == _planned(sent, 22, 22)


@pytest.mark.parametrize("lost", ["snapshot", "scan"])
def test_an_answer_that_is_lost_is_asked_for_again(lost: str, sent: list[Message]) -> None:
    core, planner = Recorded(sent, 22).core, PlannerCore("new")
    questions = [m for m in planner.handle(checkpoint(START, 22, 10)) if isinstance(m, ScanRecall)]
    if lost == "scan":
        questions = [m for m in _told(planner, _told(core, questions)) if isinstance(m, ScanRecall)]
    assert len(questions) == 1
    waiting = checkpoint(START, 22, 10, resend=True)
    assert [m for m in planner.handle(waiting) if isinstance(m, ScanRecall)] == questions
    assert _converse(planner, core, waiting)[0] != []


def test_a_snapshot_that_is_older_than_the_track_changes_nothing(sent: list[Message]) -> None:
    core, planner = Recorded(sent, 22).core, PlannerCore("p")
    planner.handle(checkpoint(START))
    _told(planner, scans(sent)[:23])
    old = _told(core, [ScanRecall(run="r", k=0, targets=[0, 1], planner="p")])
    assert _told(planner, old) == []
    assert _bytes(p for p in _told(planner, scans(sent)[23:]) if isinstance(p, Plan)) == _planned(sent, 23)


# In real time.


def _took_over(sent: list[Message], until: int, monkeypatch: pytest.MonkeyPatch) -> tuple[PlannerCore, ScanRecall]:
    """A planner that has a track since this dwell, of which it knows the acquisition and the newest scans; it asks."""
    monkeypatch.setattr(planned_run, "KEPT_SCANS", 8)
    planner = PlannerCore("a", clock=lambda: 0.0)  # no search runs out of time
    planner.handle(Membership("planner", ("a", "b")))
    planner.handle(checkpoint(START.model_copy(update={"rate_hz": RATE_HZ})))
    for scan in scans(sent)[: until + 1]:
        _told(planner, [scan, Tick(0.0)])
    planner.handle(Membership("planner", ("a",)))
    (question,) = planner.handle(Tick(0.0))
    assert isinstance(question, ScanRecall)
    return planner, question


def test_in_real_time_a_track_that_is_taken_over_goes_on_from_its_snapshot(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    until, recorded = 30, Recorded(sent, 30)
    planner, question = _took_over(sent, until, monkeypatch)
    (plan,) = _told(planner, [*recorded.core.handle(question), Tick(0.0)])
    assert plan in [plan for plan in plans(sent) if (plan.k, plan.target) == (until, question.targets[0])]


def test_in_real_time_it_waits_for_a_second_and_then_goes_on_without_what_nobody_can_tell(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    until = 30
    planner, question = _took_over(sent, until, monkeypatch)
    planned: list[set[int]] = []
    for i in range(1, round(MAX_WAIT_S * RATE_HZ) + 2):
        answers = _told(planner, [scans(sent)[-1].model_copy(update={"k": until + i}), Tick(0.0)])
        planned.append({answer.target for answer in answers if isinstance(answer, Plan)})
    (target,) = question.targets
    assert planned == [{1 - target}] * (len(planned) - 1) + [{0, 1}]


def test_in_real_time_tracks_that_are_up_to_date_do_not_wait_for_one_that_is_rebuilt(
    sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All scans are here: it asks for the snapshot nevertheless, and meanwhile rebuilds a scan at a time."""
    until, clock = 30, itertools.count()
    planner = PlannerCore("a", clock=lambda: 10.0 * next(clock))  # time for one scan, between two looks at the clock
    planner.handle(Membership("planner", ("a", "b")))
    planner.handle(checkpoint(START.model_copy(update={"rate_hz": RATE_HZ})))
    for scan in scans(sent)[: until + 1]:
        _told(planner, [scan, Tick(0.0)])
    planner.handle(Membership("planner", ("a",)))
    (question,) = _told(planner, [Tick(0.0)])
    assert isinstance(question, ScanRecall)
    (target,) = question.targets
    ticks = 0
    planned = list[set[int]]()
    while not planned or target not in planned[-1]:
        answers = _told(planner, [scans(sent)[-1].model_copy(update={"k": until + 1 + len(planned)}), Tick(0.0)])
        planned.append({answer.target for answer in answers if isinstance(answer, Plan)})
        assert not any(isinstance(answer, ScanRecall) for answer in answers)
        for _ in range(3):
            assert planner.has_deferred or target in planned[-1]
            planned[-1] |= {one.target for one in _told(planner, [Tick(0.0)]) if isinstance(one, Plan)}
            ticks += 1
    assert all(1 - target in said for said in planned)
    assert ticks > 3
    answered, _ = _took_over(sent, until, monkeypatch)
    (plan,) = _told(answered, [*Recorded(sent, until).core.handle(question), Tick(0.0)])
    assert isinstance(plan, Plan)
    assert plan.target == target
