import pytest

from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Membership, Rewind, Tick
from cogradar.shared.protocol.messages import Message, Plan, Scan
from cogradar.shared.protocol.recovery import History, ScanRecall
from cogradar.shared.wire.codec import encode
from tests.services.loop import checkpoint, plans, play, scans, smoke_begin, smoke_start

TWO = ("a", "b")  # of these names each owns one of the two tracks of run "r"


@pytest.fixture(scope="module")
def said() -> list[Message]:
    return play(smoke_start(dwells=5))


def _feed(core: PlannerCore, heard: list[Scan]) -> list[Plan]:
    return [plan for scan in heard for plan in core.handle(scan) if isinstance(plan, Plan)]


def _bytes(said: list[Plan]) -> list[bytes]:
    return sorted(encode(plan) for plan in said)


def _of(said: list[Message], targets: tuple[int, ...], first_k: int = 0) -> list[bytes]:
    return _bytes([plan for plan in plans(said) if plan.target in targets and plan.k >= first_k])


def test_one_plan_per_track_and_scan(said: list[Message]) -> None:
    expected = plans(said)
    assert [(plan.k, plan.target) for plan in expected] == [(scan.k, m) for scan in scans(said) for m in (0, 1)]
    acquiring = [plan for plan in expected if plan.status == "searching"]
    assert all(plan.bins.size == 0 for plan in acquiring)
    tracking = [plan for plan in expected if plan.status == "tracking"]
    assert all(0 <= plan.bins[0] < 16 and plan.range_km > 0 for plan in tracking)
    assert len(tracking) >= 2 * 6  # t = 0 .. 5


def test_workers_share_the_tracks(said: list[Message]) -> None:
    together: list[Plan] = []
    for name in TWO:
        core = PlannerCore(name)
        core.handle(Membership("planner", TWO))
        core.handle(smoke_begin(dwells=5))
        mine = _feed(core, scans(said))
        assert len({plan.target for plan in mine}) == 1
        together += mine
    assert _bytes(together) == _of(said, (0, 1))


def test_scans_out_of_order_or_twice_give_the_same_plans(said: list[Message]) -> None:
    core, heard = PlannerCore("p"), scans(said)
    core.handle(smoke_begin(dwells=5))
    swapped = [heard[0], heard[0], heard[2], heard[1], *heard[3:], heard[-1]]
    assert _bytes(_feed(core, swapped)) == _of(said, (0, 1))


def test_tracks_that_were_predicted_give_the_same_plans(said: list[Message]) -> None:
    core, mine = PlannerCore("p"), list[Plan]()
    core.handle(smoke_begin(dwells=5))
    for scan in scans(said):
        mine += _feed(core, [scan])
        tracks = 2 if mine[-1].status == "tracking" else 0
        assert [core.prepare() for _ in range(3)] == [i < tracks for i in range(3)]
    assert _bytes(mine) == _of(said, (0, 1))


def test_scans_heard_before_their_run_is_known_are_kept(said: list[Message]) -> None:
    core = PlannerCore("p")
    assert _feed(core, scans(said)) == []
    answers = [plan for plan in core.handle(smoke_begin(dwells=5)) if isinstance(plan, Plan)]
    assert _bytes(answers) == _of(said, (0, 1))


def test_a_new_owner_rebuilds_the_track_from_the_scans_it_kept(said: list[Message]) -> None:
    """Taking a track over in mid-run gives byte for byte what the former owner would have said since the checkpoint."""
    heard, start = scans(said), smoke_start(dwells=5)
    core = PlannerCore("a")
    core.handle(Membership("planner", TWO))
    core.handle(checkpoint(start))
    mine = {plan.target for plan in _feed(core, heard[:-2])}
    (theirs,) = {0, 1} - mine
    stored = heard[-4].k
    core.handle(checkpoint(start, stored))
    taken_over = [plan for plan in core.handle(Membership("planner", ("a",))) if isinstance(plan, Plan)]
    assert {plan.k for plan in taken_over} == {stored, stored + 1}
    rest = _feed(core, heard[-2:])
    assert _bytes([*taken_over, *rest]) == sorted([*_of(said, (theirs,), stored), *_of(said, tuple(mine), heard[-2].k)])


def test_a_worker_that_missed_the_beginning_asks_for_it(said: list[Message]) -> None:
    """It asks once, for the first scan it lacks, and goes on where the history ends; again after some checkpoints, or
    when the run waits.
    """
    heard, start = scans(said), smoke_start(dwells=5)
    stored = heard[-3].k
    core = PlannerCore("p")
    (question,) = core.handle(checkpoint(start, stored, 3))
    assert question == ScanRecall(run="r", k=0, targets=[0, 1], planner="p")
    assert list(core.handle(heard[-3])) == []
    plain, waiting = checkpoint(start, stored, 3), checkpoint(start, stored, 3, resend=True)
    assert [list(core.handle(one)) for one in (plain, plain, plain, waiting)] == [[], [], [question], [question]]
    first = History(run="r", to="p", topic="scan", k=0, payloads=[encode(scan) for scan in heard[:2]])
    assert list(core.handle(first)) == [ScanRecall(run="r", k=2, targets=[0, 1], planner="p")]
    rest = History(run="r", to="p", topic="scan", k=2, payloads=[encode(scan) for scan in heard[2:-3]])
    answers = [plan for plan in core.handle(rest) if isinstance(plan, Plan)]
    assert _bytes([*answers, *_feed(core, heard[-2:])]) == _of(said, (0, 1), stored)


def test_what_the_recorder_recalls_is_what_the_worker_asked_for(said: list[Message]) -> None:
    recorder = RecorderCore(Journal(":memory:"))
    for message in said:
        recorder.handle(message)
    (history,) = recorder.handle(ScanRecall(run="r", k=2, targets=[0], planner="p"))
    assert isinstance(history, History)
    assert history.payloads == [encode(scan) for scan in scans(said)[2:]]
    assert not recorder.handle(ScanRecall(run="r", k=10_000, targets=[0], planner="p"))


def test_what_is_not_acknowledged_is_resent_when_the_recorder_asks(said: list[Message]) -> None:
    heard, start = scans(said), smoke_start(dwells=5)
    core = PlannerCore("p")
    core.handle(checkpoint(start))
    _feed(core, heard)
    stored = heard[-2].k
    assert list(core.handle(checkpoint(start, stored))) == []
    assert list(core.handle(checkpoint(start, stored, resend=True))) == []
    assert core.has_deferred
    again = [plan for plan in core.handle(Tick(0.0)) if isinstance(plan, Plan)]
    assert _bytes(again) == _of(said, (0, 1), stored)


def test_a_run_that_ended_is_forgotten(said: list[Message]) -> None:
    core, start = PlannerCore("p"), smoke_start(dwells=5)
    core.handle(checkpoint(start))
    core.handle(checkpoint(start, 0, ended=True))
    assert _feed(core, scans(said)[:1]) == []


def test_after_a_rewind_the_planner_is_as_one_that_joins_late(said: list[Message]) -> None:
    """The journal lost its end: dwells are played again of which this worker had dropped all that it sent."""
    start, received = smoke_start(dwells=5), scans(said)
    lost, last = received[-4].k, received[-1].k
    planner, late = PlannerCore("p"), PlannerCore("p")
    planner.handle(checkpoint(start))
    _feed(planner, received)
    planner.handle(checkpoint(start, last))
    planner.handle(Rewind(start.run))
    request = list(planner.handle(checkpoint(start, lost, 2)))
    assert (
        request
        == list(late.handle(checkpoint(start, lost, 2)))
        == [ScanRecall(run="r", k=0, targets=[0, 1], planner="p")]
    )
    history = History(run="r", to="p", topic="scan", k=0, payloads=[encode(scan) for scan in received if scan.k < lost])
    for core in (planner, late):
        assert list(core.handle(history)) == []
    again = [scan for scan in received if scan.k >= lost]
    assert _bytes(_feed(planner, again)) == _bytes(_feed(late, again)) == _of(said, (0, 1), lost)
