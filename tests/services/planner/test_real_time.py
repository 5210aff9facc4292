"""The planner of a run in real time: only the newest scan is planned for."""

import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery.pacing import MAX_WAIT_S
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, Refused, RunStart
from cogradar.shared.protocol.recovery import ScanRecall
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import encode
from tests.services.loop import SMOKE, checkpoint, plans, play, scans, smoke_start

RATE_HZ = 10.0
PERIOD_S = 1.0 / RATE_HZ


def _start(dwells: int = 6) -> RunStart:
    return smoke_start(dwells=dwells).model_copy(update={"rate_hz": RATE_HZ})


# The planner.


class Clock:
    """A clock that a search reads: each reading takes `step` seconds."""

    def __init__(self, step_s: float = 0.0) -> None:
        self.now_s, self.step_s = 0.0, step_s

    def __call__(self) -> float:
        self.now_s += self.step_s
        return self.now_s


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=6))


def _planner(clock: Clock) -> PlannerCore:
    core = PlannerCore("p", clock)
    assert core.handle(checkpoint(_start())) == []
    core.handle(Tick(0.0))
    return core


def _caught_up(core: PlannerCore) -> list[Plan]:
    found, n_tick = list[Plan](), 0
    while core.has_deferred:
        found += [m for m in core.handle(Tick(0.0)) if isinstance(m, Plan)]
        n_tick += 1
    assert n_tick
    return found


def test_scans_that_piled_up_are_all_observed_but_only_the_newest_is_planned_for(sent: list[Message]) -> None:
    """With time enough the plans are those of a run without a clock, byte for byte."""
    core, received = _planner(Clock()), scans(sent)
    assert all(core.handle(scan) == () for scan in received)
    found = _caught_up(core)
    expected = [plan for plan in plans(sent) if plan.k == received[-1].k]
    assert [encode(plan) for plan in found] == [encode(plan) for plan in expected]
    assert {plan.n_sim for plan in found} == {SMOKE.radar.planner.n_sim}


def test_each_scan_that_comes_alone_is_planned_for(sent: list[Message]) -> None:
    core, found = _planner(Clock()), list[Plan]()
    for scan in scans(sent):
        core.handle(scan)
        found += _caught_up(core)
    assert [encode(plan) for plan in found] == [encode(plan) for plan in plans(sent)]


def test_a_search_ends_at_its_deadline_and_says_how_far_it_came(sent: list[Message]) -> None:
    core = _planner(Clock(step_s=10.0 * PERIOD_S))
    for scan in scans(sent):
        core.handle(scan)
    found = _caught_up(core)
    assert [plan.target for plan in found] == [0, 1]
    assert all(0 < plan.n_sim < SMOKE.radar.planner.n_sim for plan in found)


def test_a_scan_that_never_comes_is_asked_for_and_then_passed_over(sent: list[Message]) -> None:
    core, received = _planner(Clock()), scans(sent)
    gap = next(i for i, scan in enumerate(received) if scan.t == 2)
    for scan in [*received[:gap], *received[gap + 1 :]]:
        core.handle(scan)
    (question,) = core.handle(Tick(0.0))
    assert (type(question).__name__, getattr(question, "k", None)) == ("ScanRecall", received[gap].k)
    last = received[-1]
    later = [
        last.model_copy(update={"k": last.k + i, "t": last.t + i}) for i in range(1, round(MAX_WAIT_S * RATE_HZ) + 2)
    ]
    for scan in later:
        core.handle(scan)
    assert [(plan.k, plan.target) for plan in _caught_up(core)] == [(later[-1].k, 0), (later[-1].k, 1)]


def test_a_dwell_that_never_happened_is_passed_over_at_once_and_plans_name_it(sent: list[Message]) -> None:
    core, received = _planner(Clock()), scans(sent)
    gap = next(i for i, scan in enumerate(received) if scan.t == 2)
    after = received[gap + 1].model_copy(update={"skipped": 1})
    for scan in received[:gap]:
        core.handle(scan)
    assert [plan.unseen for plan in _caught_up(core)] == [None, None]
    core.handle(after)
    assert [(plan.k, plan.unseen) for plan in _caught_up(core)] == [(after.k, [received[gap].k])] * 2


@pytest.mark.parametrize("strategy", list(Strategy))
def test_every_strategy_begins_a_run_in_real_time(strategy: Strategy) -> None:
    start = _start().model_copy(update={"strategy": strategy})
    assert AllocatorCore().handle(checkpoint(start)) == []
    assert PlannerCore("p").handle(checkpoint(start)) == []


def test_a_scan_of_a_dwell_that_a_run_cannot_have_is_refused() -> None:
    """A planner would coast over all dwells before it."""
    planner, far = _planner(Clock()), scans(play(smoke_start(dwells=6)))[-1]
    far = far.model_copy(update={"k": 2 * SMOKE.radar.acquisition.max_scans + 7})
    with pytest.raises(Refused, match=f"dwell {far.k} of a run that ends by {far.k - 1}"):
        planner.handle(far)


def test_a_dwell_that_never_happened_does_not_keep_a_later_one_from_being_asked_for() -> None:
    core, received, asked = _planner(Clock()), scans(play(smoke_start(dwells=30))), list[int]()
    never, lost = (next(scan.k for scan in received if scan.t == t) for t in (5, 20))
    for scan in received:
        if scan.k not in {never, lost}:
            core.handle(scan)
            asked += [m.k for m in core.handle(Tick(0.0)) if isinstance(m, ScanRecall)]
    assert asked == [never, lost]
