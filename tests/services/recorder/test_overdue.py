"""Plans that are overdue in real time: each once, its new owner has time, and who is slow is not away."""

from itertools import pairwise

import pytest

from cogradar.services.delivery.pacing import RealTime
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.overdue import FIRST_S, MISSED, WITHIN_S, OverduePlans
from cogradar.services.recorder.recorded_run import OVERDUE_S, UNPLANNED
from cogradar.shared.protocol.events import Tick
from tests.services.births import HERE, THERE, plan, roster, scan, start_of, truth, waveform


def _dwells(plans: OverduePlans, first: int, last: int, planned: frozenset[int] = frozenset()) -> dict[int, set[int]]:
    """What is overdue when the scans of these dwells have come, of tracks 0 and 1; some are planned for after that."""
    found = {}
    for k in range(first, last):
        plans.hear_scan(k, frozenset({0, 1}))
        if overdue := plans.take():
            found[k] = overdue
        for m in planned:
            plans.hear_plan(k, m)
    return found


@pytest.mark.parametrize("rate_hz", [20.0, 4.0, 1.0, 0.1])
def test_a_track_that_is_no_longer_planned_for_is_overdue_once_and_then_half_as_soon(rate_hz: float) -> None:
    plans, within = OverduePlans(RealTime(1.0 / rate_hz)), max(MISSED, round(WITHIN_S * rate_hz))
    assert _dwells(plans, 0, 10, frozenset({0, 1})) == {}
    first = 9 + within + 1
    again = first + max(MISSED, round(2.0 * WITHIN_S * rate_hz)) + 1
    assert _dwells(plans, 10, again + 1, frozenset({1})) == {first: {0}, again: {0}}
    assert _dwells(plans, again + 1, again + 2, frozenset({0, 1})) == {}
    assert _dwells(plans, again + 2, again + within + 3, frozenset({1})) == {again + within + 2: {0}}


@pytest.mark.parametrize("rate_hz", [2.0, 1.0, 0.1])
def test_a_plan_that_is_lost_is_forgiven(rate_hz: float) -> None:
    plans = OverduePlans(RealTime(1.0 / rate_hz))
    for k in range(40):
        assert _dwells(plans, k, k + 1, frozenset({0, 1}) if k % 3 else frozenset({1})) == {}


def test_the_first_plan_may_take_longer_also_after_a_gap() -> None:
    plans, first = OverduePlans(RealTime(0.1)), round(10 * FIRST_S) + 1
    assert _dwells(plans, 0, first + 1) == {first: {0, 1}}
    assert _dwells(plans, first + 1, first + 40, frozenset({0, 1})) == {}
    assert _dwells(plans, first + 60, 2 * first + 61) == {2 * first + 60: {0, 1}}


def test_one_that_is_overdue_for_long_is_not_forgotten() -> None:
    found = _dwells(OverduePlans(RealTime(0.1)), 0, 600)
    assert max(after - before for before, after in pairwise(found)) == round(10 * FIRST_S) + 1


def test_a_plan_that_comes_late_is_one() -> None:
    plans, late = OverduePlans(RealTime(0.1)), 8
    for k in range(100):
        plans.hear_scan(k, frozenset({0}))
        if k >= late:
            plans.hear_plan(k - late, 0)
        assert plans.take() == set()


def test_a_track_that_has_ended_is_not_awaited() -> None:
    plans = OverduePlans(RealTime(0.1))
    assert _dwells(plans, 0, 5, frozenset({0, 1})) == {}
    for k in range(5, 60):
        plans.hear_scan(k, frozenset({1}))
        plans.hear_plan(k, 1)
        plans.hear_plan(k, 0)
        assert plans.take() == set()


def test_what_is_overdue_is_logged_once_while_it_changes(caplog: pytest.LogCaptureFixture) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.planners = ["planner-0"]
    core.handle(start_of(1000, rate_hz=4.0))
    states, reasons = {0: HERE, 1: THERE}, list[str]()
    for k in range(60):
        tracks = roster({} if k == 0 else states, confirmed=[] if k == 0 else [0, 1])
        said = [scan(k, tracks), truth(k, {0: HERE, 1: THERE}), waveform(k, roster(states))]
        said += [plan(k, 0, HERE)] if 0 < k < 4 or k % 20 == 19 else []
        for message in said:
            core.handle(message)
        core.handle(Tick(0.25 * k))
        ((reason,),) = journal.rows("SELECT reason FROM run")
        reasons += [reason] * (reason not in reasons[-1:])
    assert "no plans of track 2; planners present: planner-0" in reasons
    assert "no plans of track 1; planners present: planner-0" in reasons
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [f"r: {reasons[1]}"]


def test_before_its_first_plan_a_run_in_real_time_says_so_after_a_while_whoever_is_there() -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.planners = []
    core.handle(start_of(1000, rate_hz=4.0))
    states, said = {0: HERE, 1: THERE}, dict[str, int]()
    for k in range(100):
        tracks = roster({} if k == 0 else states, confirmed=[] if k == 0 else [0, 1])
        for message in (scan(k, tracks), truth(k, {0: HERE, 1: THERE}), waveform(k, roster(states))):
            core.handle(message)
        core.handle(Tick(0.25 * k))
        ((reason,),) = journal.rows("SELECT reason FROM run")
        said.setdefault(reason, k)
    late = "no plans of track 1, 2; planners present: none"
    assert list(said) == ["", late]
    assert UNPLANNED * OVERDUE_S <= 0.25 * said[late] <= UNPLANNED * OVERDUE_S + FIRST_S + 1.0
