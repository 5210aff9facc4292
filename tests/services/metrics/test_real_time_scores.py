"""Planner and metrics of a run in real time: only the newest scan is planned for, what was late is counted."""

import numpy as np
import pytest

from services.allocator.core import AllocatorCore
from services.metrics.scores import PATIENCE_S as SCORING_PATIENCE_S
from services.metrics.scores import ScoredRun
from services.planner.core import PlannerCore
from services.planner.run import PATIENCE_S
from services.recorder.core import RecorderCore
from services.recorder.journal import Journal
from shared.protocol.messages import (
    Checkpoint,
    Message,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    ScanRecall,
    Tick,
    Truth,
    Waveform,
)
from shared.scenario.radar_config import Strategy
from shared.wire.codec import encode
from shared.wire.runner import TICK_S
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
def said() -> list[Message]:
    return play(smoke_start(dwells=6))


def _planner(clock: Clock) -> PlannerCore:
    core = PlannerCore("p", clock)
    assert core.handle(checkpoint(_start())) == []
    core.handle(Tick(0.0))
    return core


def _caught_up(core: PlannerCore) -> list[Plan]:
    deferred = [core.has_deferred]
    found = [m for m in core.handle(Tick(0.0)) if isinstance(m, Plan)]
    assert [*deferred, core.has_deferred] == [True, False]
    return found


def test_scans_that_piled_up_are_all_observed_but_only_the_newest_is_planned_for(said: list[Message]) -> None:
    """With time enough the plans are those of a run without a clock, byte for byte."""
    core, heard = _planner(Clock()), scans(said)
    assert all(core.handle(scan) == () for scan in heard)
    found = _caught_up(core)
    expected = [plan for plan in plans(said) if plan.k == heard[-1].k]
    assert [encode(plan) for plan in found] == [encode(plan) for plan in expected]
    assert {plan.n_sim for plan in found} == {SMOKE.radar.planner.n_sim}


def test_each_scan_that_comes_alone_is_planned_for(said: list[Message]) -> None:
    core, found = _planner(Clock()), list[Plan]()
    for scan in scans(said):
        core.handle(scan)
        found += _caught_up(core)
    assert [encode(plan) for plan in found] == [encode(plan) for plan in plans(said)]


def test_a_search_ends_at_its_deadline_and_says_how_far_it_came(said: list[Message]) -> None:
    core = _planner(Clock(step_s=10.0 * PERIOD_S))
    for scan in scans(said):
        core.handle(scan)
    found = _caught_up(core)
    assert [plan.target for plan in found] == [0, 1]
    assert all(0 < plan.n_sim < SMOKE.radar.planner.n_sim for plan in found)


def test_a_scan_that_never_comes_is_asked_for_and_then_passed_over(said: list[Message]) -> None:
    core, heard = _planner(Clock()), scans(said)
    gap = next(i for i, scan in enumerate(heard) if scan.t == 2)
    for scan in [*heard[:gap], *heard[gap + 1 :]]:
        core.handle(scan)
    (question,) = core.handle(Tick(0.0))
    assert (type(question).__name__, getattr(question, "k", None)) == ("ScanRecall", heard[gap].k)
    last = heard[-1]
    later = [
        last.model_copy(update={"k": last.k + i, "t": last.t + i}) for i in range(1, round(PATIENCE_S * RATE_HZ) + 2)
    ]
    for scan in later:
        core.handle(scan)
    assert [(plan.k, plan.target) for plan in _caught_up(core)] == [(later[-1].k, 0), (later[-1].k, 1)]


# Metrics.


def _scored(said: list[Message], lacking: tuple[type[Message], ...] = ()) -> tuple[RecorderCore, Journal]:
    store = Journal(":memory:")
    core = RecorderCore(store)
    core.handle(_start())
    for message in said:
        if not isinstance(message, (RunStart, Checkpoint, *lacking)):
            core.handle(message)
    return core, store


def _without(said: list[Message], *gone: tuple[type[Message], int]) -> list[Message]:
    return [m for m in said if (type(m), getattr(m, "t" if isinstance(m, Scan | Truth) else "k", -1)) not in gone]


def _pass_time(core: RecorderCore) -> None:
    for _ in range(round(SCORING_PATIENCE_S / TICK_S)):
        core.handle(Tick(0.0))


def _scored_until(store: Journal) -> int:
    (row,) = store.read("SELECT MAX(t) AS t FROM score")
    return int(row["t"])


def test_a_dwell_is_scored_without_the_plan_that_does_not_come() -> None:
    """It waits while something may come; after the end it waits for so many ticks, then the run is over."""
    said = play(smoke_start(dwells=6))
    k = next(scan.k for scan in scans(said) if scan.t == 3)
    core, store = _scored(_without(said, (Plan, k)))
    assert store.read("SELECT MAX(t) AS t FROM score") == [{"t": 2}]
    heard = [m for _ in range(20) for m in core.handle(Tick(0.0))]
    assert store.read("SELECT COUNT(*) AS n, MAX(t) AS t FROM score") == [{"n": 12, "t": 6}]
    assert isinstance(heard[-1], Checkpoint)
    assert heard[-1].ended
    (run,) = store.read("SELECT status FROM run")
    assert run["status"] == "complete"


def test_dwells_go_on_being_scored_some_time_after_newer_ones_have_come() -> None:
    said = play(smoke_start(dwells=40))
    k = next(scan.k for scan in scans(said) if scan.t == 3)
    core, store = _scored(_without(said, (Plan, k), (Scan, 40)), lacking=(RunEnd,))
    assert _scored_until(store) == 2
    _pass_time(core)
    core.handle(next(scan for scan in scans(said) if scan.t == 40))
    assert store.read("SELECT COUNT(*) AS n, MAX(t) AS t FROM score") == [{"n": 80, "t": 40}]


def test_what_comes_topic_by_topic_is_all_scored() -> None:
    """As to a metrics service that was away for a while: many scans before the first of the truths."""
    said = play(smoke_start(dwells=40))
    topics = (Scan, Waveform, Plan, Truth)
    _, store = _scored([message for topic in topics for message in said if isinstance(message, topic)])
    assert store.read("SELECT COUNT(*) AS n, MAX(t) AS t FROM score") == [{"n": 80, "t": 40}]


def test_a_metrics_service_that_comes_back_asks_once_for_what_it_missed() -> None:
    """Its readers' caches may not have reached it; in real time it would not ask otherwise."""
    said = play(smoke_start(dwells=40))
    _, store = _scored([m for m in said if getattr(m, "k", 0) <= 10], lacking=(RunEnd,))
    core = RecorderCore(store, resume=True)
    asked = [[m.k for m in core.handle(Tick(0.0)) if isinstance(m, Checkpoint)] for _ in range(7)]
    repeated = [ks for ks in asked if len(ks) == 2]
    assert repeated == [[11, 11]]


def test_a_dwell_without_a_scan_has_no_score_but_its_time_passes() -> None:
    said = play(smoke_start(dwells=40))
    core, store = _scored(_without(said, (Scan, 3), (Scan, 40)), lacking=(RunEnd,))
    _pass_time(core)
    core.handle(next(scan for scan in scans(said) if scan.t == 40))
    assert [row["t"] for row in store.read("SELECT DISTINCT t FROM score ORDER BY t")] == [1, 2, *range(4, 41)]
    resumed = RecorderCore(store, resume=True)
    (answer,) = resumed.handle(next(m for m in said if isinstance(m, RunEnd)))
    assert isinstance(answer, Checkpoint)
    assert (answer.ended, answer.t) == (True, 40)


def test_late_plans_and_stale_waveforms_are_columns_of_the_score() -> None:
    said = play(smoke_start(dwells=6))
    changed: list[Message] = []
    first = next(scan.k for scan in scans(said) if scan.t == 1)
    for message in said:
        if isinstance(message, Waveform) and message.k == first:
            changed.append(message.model_copy(update={"late": np.array([0, 1], np.int32)}))  # radiated at t = 2, 3
        elif isinstance(message, Truth) and message.t == 3:
            changed.append(message.model_copy(update={"waveform_k": first}))
        else:
            changed.append(message)
    _, store = _scored(changed)
    rows = store.read("SELECT t, track, late, stale FROM score ORDER BY t, track")
    assert [(row["t"], row["track"]) for row in rows if row["late"]] == [(2, 1), (3, 1)]
    assert [(row["t"], row["track"]) for row in rows if row["stale"]] == [(3, 0), (3, 1)]


def test_dwells_before_the_first_tracking_waveform_are_acquisition() -> None:
    """Plans are there, their waveform is late: the clock stands still, nothing is scored, and it is counted as such."""
    said = play(smoke_start(dwells=3))
    switch = max(scan.k for scan in scans(said) if scan.t == 0)
    once_more: list[Message] = []
    for message in said:
        k = getattr(message, "k", 0)
        later = isinstance(message, Scan | Truth | Plan | Waveform | RunEnd) and k > switch
        once_more.append(message.model_copy(update={"k": k + 1}) if later else message)
    again = [m.model_copy(update={"k": switch + 1}) for m in said if getattr(m, "k", 0) == switch]
    _, store = _scored([*once_more, *[m for m in again if not isinstance(m, Checkpoint | RunStart)]])
    assert [row["t"] for row in store.read("SELECT DISTINCT t FROM score ORDER BY t")] == [1, 2, 3]
    assert store.read("SELECT acquisition_scans AS n FROM run") == [{"n": switch + 2}]


def test_a_run_that_goes_on_is_not_asked_to_repeat_itself() -> None:
    """In lockstep a silence means that something is lost; in real time scans come all the while."""
    run = ScoredRun(_start(dwells=20))
    for scan in scans(play(smoke_start(dwells=6))):
        run.tick()
        run.take(scan)
        assert run.quiet == 0
    for _ in range(3):
        run.tick()
    assert run.quiet == 3


def test_at_a_low_rate_a_dwell_waits_for_plans_as_long_as_their_searches_may_take() -> None:
    """Plans and waveforms are in time, 3.5 s after the scan in a period of 10 s: the scores are those of lockstep."""
    start, said = smoke_start(dwells=6), play(smoke_start(dwells=6))
    slow, prompt = Journal(":memory:"), Journal(":memory:")
    core, lockstep = RecorderCore(slow), RecorderCore(prompt)
    core.handle(start.model_copy(update={"rate_hz": 0.1}))
    for message in said:
        if not isinstance(message, Checkpoint):
            lockstep.handle(message)
    for k in range(max(scan.k for scan in scans(said)) + 1):
        of_dwell = [m for m in said if not isinstance(m, RunStart | Checkpoint | RunEnd) and getattr(m, "k", -1) == k]
        for kinds, ticks in (((Scan, Truth), 14), ((Plan, Waveform), 26)):
            for message in of_dwell:
                if isinstance(message, kinds):
                    core.handle(message)
            for _ in range(ticks):
                core.handle(Tick(0.0))
    columns = "SELECT t, target, bin, x_hat, y_hat FROM score ORDER BY t, target"
    assert slow.read(columns)[: 2 * 5] == prompt.read(columns)[: 2 * 5]
    assert len(slow.read(columns)) >= 2 * 5


@pytest.mark.parametrize("strategy", list(Strategy))
def test_every_strategy_begins_a_run_in_real_time(strategy: Strategy) -> None:
    start = _start().model_copy(update={"strategy": strategy})
    assert AllocatorCore().handle(checkpoint(start)) == []
    assert PlannerCore("p").handle(checkpoint(start)) == []


def test_a_scan_of_a_dwell_that_a_run_cannot_have_is_refused() -> None:
    """Metrics would score all dwells before it as missing, and a planner coast over them."""
    said = play(smoke_start(dwells=6))
    core, planner = RecorderCore(Journal(":memory:")), _planner(Clock())
    core.handle(_start())
    far = scans(said)[-1].model_copy(update={"k": SMOKE.radar.acquisition.max_scans + 7})
    for reader in (core, planner):
        with pytest.raises(Refused, match=f"dwell {far.k} of a run that ends by {far.k - 1}"):
            reader.handle(far)


def test_a_dwell_that_never_happened_does_not_keep_a_later_one_from_being_asked_for() -> None:
    core, heard, asked = _planner(Clock()), scans(play(smoke_start(dwells=30))), list[int]()
    never, lost = (next(scan.k for scan in heard if scan.t == t) for t in (5, 20))
    for scan in heard:
        if scan.k not in {never, lost}:
            core.handle(scan)
            asked += [m.k for m in core.handle(Tick(0.0)) if isinstance(m, ScanRecall)]
    assert asked == [never, lost]
