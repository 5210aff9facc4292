"""Tracks that change hands: nobody waits for the new owner, and the old one stops when that one plans."""

import re
from collections.abc import Iterable

import pytest

from cogradar.services.planner.core import GRACE_S, SUSPENDED_S, PlannerCore
from cogradar.services.planner.held_tracks import batches
from cogradar.services.planner.ownership import owners
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan
from cogradar.shared.protocol.recovery import Handover, NoPlans, ScanRecall, Snapshot
from cogradar.shared.wire.codec import encode
from tests.services.loop import checkpoint, play, scans, smoke_begin, smoke_start

BOTH = Membership("planner", ("a", "b"))  # of run "r", each owns one of the two tracks
START = smoke_start(dwells=8)


@pytest.fixture(scope="module")
def heard() -> list[Scan]:
    """The scans of a run."""
    return scans(play(START))


def _after(core: PlannerCore, events: Iterable[Event]) -> list[Message]:
    return [answer for event in events for answer in core.handle(event) if isinstance(answer, Message)]


def _planned(answers: Iterable[Message]) -> set[int]:
    return {answer.target for answer in answers if isinstance(answer, Plan) and answer.status == "tracking"}


def _tracked(answers: Iterable[Message], track: int) -> list[bytes]:
    plans = [answer for answer in answers if isinstance(answer, Plan) and answer.status == "tracking"]
    return [encode(plan) for plan in plans if plan.target == track]


def _handovers(answers: Iterable[Message]) -> list[Handover]:
    return [answer for answer in answers if isinstance(answer, Handover)]


def _overdue(targets: list[int]) -> Checkpoint:
    return checkpoint(START, 0, 0).model_copy(update={"overdue": targets})


def test_plans_go_out_in_batches_of_half_of_those_to_come() -> None:
    assert list(batches(())) == []
    assert [len(batch) for batch in batches(range(30))] == [15, 8, 4, 2, 1]
    assert [m for batch in batches(range(30)) for m in batch] == list(range(30))


def test_the_old_owner_plans_until_the_new_one_says_that_it_does(heard: list[Scan]) -> None:
    old, new = PlannerCore("a"), PlannerCore("b")
    first, later = heard[:-2], heard[-2:]
    assert _planned(_after(old, [smoke_begin(dwells=8), *first])) == {0, 1}
    old.handle(BOTH)
    assert _planned(_after(old, later[:1])) == {0, 1}
    assert _after(old, [checkpoint(START, 0, 0)]) == []  # a snapshot of what is not in the journal may not be sent
    snapshot, offer = _after(
        old, [checkpoint(START, later[0].k + 1, 8)]
    )  # from which the new owner has little to replay
    assert isinstance(snapshot, Snapshot)
    assert isinstance(offer, Handover)
    assert (offer.planner, offer.taken, offer.targets) == ("a", False, [snapshot.target])

    assert _handovers(_after(new, [BOTH, smoke_begin(dwells=8), offer])) == []  # it has no scan yet
    assert _handovers(_after(new, [*first[:-1], offer])) == []  # it is behind
    assert _planned(_after(new, [*first, *later[:1]])) == set()  # that was planned
    (answer,) = _handovers(_after(new, [offer]))
    assert (answer.planner, answer.targets, answer.taken) == ("b", offer.targets, True)

    old.handle(answer.model_copy(update={"k": 0}))  # to somebody who is far behind
    old.handle(answer)
    assert _planned(_after(old, later[1:])) == {0, 1} - set(offer.targets)
    assert _planned(_after(new, later[1:])) == set(offer.targets)
    assert _handovers(_after(old, [checkpoint(START, 0, 0)])) == []


def test_who_joins_asks_for_the_past_when_it_is_offered_or_wanted() -> None:
    begun, offer = checkpoint(START, 4, 8), Handover(run="r", planner="a", k=4, targets=[0, 1], taken=False)
    real_time = begun.model_copy(update={"rate_hz": 10.0})
    (mine,) = [m for m in (0, 1) if owners("r", 2, ("a", "b"))[m] == "b"]

    def asked(*events: Event) -> list[bool]:
        """After each event: whether something was asked for."""
        core = PlannerCore("b")
        return [any(isinstance(answer, ScanRecall) for answer in core.handle(event)) for event in (BOTH, *events)]

    assert asked(begun, offer) == [False, False, True]
    foreign = offer.model_copy(update={"targets": [1 - mine]})
    assert asked(begun, foreign, offer) == [False, False, False, True]  # no more than is offered
    assert asked(begun, begun, begun, begun) == [False, False, False, False, True]  # nobody offers it
    assert asked(real_time, real_time) == [False, False, True]  # sooner: nobody waits for these plans
    assert asked(begun, checkpoint(START, 4, 8, resend=True)) == [False, False, True]  # the run waits
    core = PlannerCore("b")
    assert any(isinstance(answer, ScanRecall) for answer in core.handle(begun))  # there is nobody else


def test_plans_that_the_old_owner_took_with_it_are_made_again(heard: list[Scan]) -> None:
    new = PlannerCore("b")
    (mine,) = {0, 1} - _planned(_after(PlannerCore("a"), [BOTH, smoke_begin(dwells=8), *heard]))
    offer = Handover(run="r", planner="a", k=heard[-1].k, targets=[mine], taken=False)
    assert _planned(_after(new, [BOTH, smoke_begin(dwells=8), offer, *heard])) == set()
    asked = [checkpoint(START, 0, 0, resend=True)] * 4
    again = _after(new, [Membership("planner", ("b",)), *asked, *heard[-1:]])
    whole = _after(PlannerCore("c"), [smoke_begin(dwells=8), *heard])
    assert _tracked(again, mine) == _tracked(whole, mine) != []


def test_plans_are_made_again_at_the_third_request_and_a_repeated_checkpoint_drops_no_track(heard: list[Scan]) -> None:
    """In the second case the old owner is there, and the run waits for somebody else: the new one keeps what it has."""
    (mine,) = {0, 1} - _planned(_after(PlannerCore("a"), [BOTH, smoke_begin(dwells=8), *heard]))
    offer = Handover(run="r", planner="a", k=heard[-1].k, targets=[mine], taken=False)
    request = checkpoint(START, 0, 0, resend=True)

    waiting = PlannerCore("b")
    _after(waiting, [BOTH, smoke_begin(dwells=8), offer, *heard])
    assert [_planned(_after(waiting, [request])) for _ in range(4)] == [set(), set(), {mine}, set()]

    new = PlannerCore("b")
    _after(new, [BOTH, smoke_begin(dwells=8), *[request] * 3, offer, *heard])
    assert _planned(_after(new, [checkpoint(START, 0, 0)])) == set()
    assert [said.taken for said in _handovers(_after(new, [offer]))] == [True]


def test_what_a_worker_says_itself_and_what_it_does_not_own_changes_nothing(heard: list[Scan]) -> None:
    core = PlannerCore("a")
    _after(core, [smoke_begin(dwells=8), *heard[:-1]])
    assert _after(core, [Handover(run="r", planner="a", k=3, targets=[0, 1], taken=True)]) == []
    assert _after(core, [Handover(run="other", planner="b", k=3, targets=[0, 1], taken=True)]) == []
    assert _after(core, [Handover(run="r", planner="b", k=3, targets=[0, 1], taken=True)]) == []
    assert _planned(_after(core, heard[-1:])) == {0, 1}


def test_a_worker_that_brings_no_plans_loses_its_tracks(heard: list[Scan], caplog: pytest.LogCaptureFixture) -> None:
    core = PlannerCore("a")
    (mine,) = _planned(_after(core, [BOTH, smoke_begin(dwells=8), *heard[:-1]]))
    assert _planned(_after(core, [_overdue([1 - mine])])) == {1 - mine}  # of all dwells that are not acknowledged
    assert "r: b: no plans; others take their tracks" in caplog.text
    assert core.measures() == {"tracks_owned": 2}
    _after(core, [Tick(1.0), Tick(SUSPENDED_S - 0.1)])
    assert core.measures() == {"tracks_owned": 2}
    _after(core, [Tick(SUSPENDED_S)])
    assert core.measures() == {"tracks_owned": 1}
    assert _planned(_after(core, heard[-1:])) == {0, 1}  # until the other one takes it


@pytest.mark.parametrize("name", ["a@0-7", "b@0-7"])
def test_if_none_of_those_that_may_plan_brings_plans_the_tracks_stay_where_they_are(
    name: str, heard: list[Scan]
) -> None:
    names = ("a@0-7", "b@0-7", "c@8-15")
    core = PlannerCore(name)
    _after(core, [Membership("planner", names), smoke_begin(dwells=8), *heard[:-1]])
    before = core.measures()
    assert before["tracks_owned"] == owners("r", 2, names).count(name)
    for now_s, tracks in ((10.0, [0]), (20.0, [1]), (30.0, [0, 1])):
        _after(core, [Tick(now_s), _overdue(tracks)])
    assert core.measures() == before


def test_a_new_owner_is_not_suspended_for_the_one_before_it(heard: list[Scan]) -> None:
    core = PlannerCore("a")
    (mine,) = _planned(_after(core, [Tick(5.0), BOTH, smoke_begin(dwells=8), *heard[:-1]]))
    _after(core, [Tick(10.0), _overdue([1 - mine])])
    assert core.measures() == {"tracks_owned": 2}
    for now_s, n_owned in (
        (10.0, 2),
        (10.0 + GRACE_S - 0.1, 2),
        (10.0 + GRACE_S, 1),
    ):  # all are late: none is suspended
        _after(core, [Tick(now_s), _overdue([0, 1])])
        assert core.measures() == {"tracks_owned": n_owned}


def test_who_alone_may_plan_for_a_track_is_not_suspended_for_another(heard: list[Scan]) -> None:
    core = PlannerCore("c")
    _after(core, [Membership("planner", ("b@0-0", "c")), smoke_begin(dwells=8), *heard[:-1]])
    _after(core, [_overdue([0, 1])])
    assert core.measures()["tracks_owned"] in {1, 2}


def test_if_nobody_brings_plans_the_tracks_stay_where_they_are(heard: list[Scan]) -> None:
    core = PlannerCore("a")
    _after(core, [BOTH, smoke_begin(dwells=8), *heard[:-1]])
    _after(core, [_overdue([0, 1])])
    assert core.measures() == {"tracks_owned": 1}


@pytest.mark.parametrize("n_name", [1, 20, 200])
def test_names_without_a_process_keep_a_run_waiting_for_four_requests_at_most(
    n_name: int, heard: list[Scan], caplog: pytest.LogCaptureFixture
) -> None:
    core = PlannerCore("a")
    nobody = [f"n{i}" for i in range(n_name)]
    _after(core, [Membership("planner", ("a", *nobody)), smoke_begin(dwells=8), *heard[:-1]])
    said = list[str]()
    for i in range(4):
        answers = _after(core, [Tick(10.0 + (GRACE_S + 1.0) * i), _overdue([0, 1])])
        planned = _planned(answers)
        said += _late(answers)
    assert _planned(_after(core, heard[-1:])) | planned == {0, 1}
    counts = [len(set(text.partition(":")[0].partition(" and ")[0].split(", "))) + _more(text) for text in said]
    assert counts == sorted(counts)  # all requests together
    assert min(n_name, 2) <= counts[-1] <= n_name
    assert said[-1] in caplog.text
    assert _late(_after(core, [checkpoint(START, 0, 0)])) == said[-1:]  # as long as it holds
    assert _late(_after(core, [Tick(10.0 + SUSPENDED_S + 20.0), checkpoint(START, 0, 0)])) == []


def _late(answers: Iterable[Message]) -> list[str]:
    return [answer.reason for answer in answers if isinstance(answer, NoPlans) and answer.late]


def _more(text: str) -> int:
    return int((re.findall(r" and (\d+) more:", text) or ["0"])[0])


def test_a_planner_that_names_late_ones_keeps_its_tracks(heard: list[Scan]) -> None:
    core = PlannerCore("a")
    (mine,) = _planned(_after(core, [BOTH, smoke_begin(dwells=8), *heard[:-1]]))
    said = NoPlans(run="r", process="b", reason="c: no plans; others take their tracks", ends=False, late=True)
    assert _planned(_after(core, [said, heard[-1]])) == {mine}
    assert _planned(_after(core, [said.model_copy(update={"late": False})])) == {1 - mine}
