"""Real time in simulated time: whoever dies, freezes or hangs, no track ends, and each is planned for again in time."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.services.analysis.replay import Replay, replay
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.delivery.pacing import COASTED_S
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store
from cogradar.services.planner.owned_track import OwnedTrack
from cogradar.services.planner.recall import RecallRequest
from cogradar.services.recorder.overdue import MISSED, WITHIN_S
from cogradar.services.simulation.cluster import Cluster
from cogradar.services.simulation.disk import Disk
from cogradar.services.simulation.process import Process
from cogradar.services.simulation.schedule import LEASE_S, Fault, Kind
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Truth, Waveform, roster_of
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import coast
from cogradar.shared.wire.pool.live_names import LEAVE_AFTER_S
from cogradar.shared.wire.session import LEASE_MS

NAMES = ("recorder-0", "emulator-0", "allocator-0", "planner-0", "planner-1")
UNKNOWN = ("radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2")
TRAFFIC = "deploy/scenarios/traffic.toml"
RATE_HZ, AT_S, SECONDS = 5.0, 5.0, 10.0
COASTED = 15  # dwells after the last plan that are looked at
UNLIKELY = 18.5  # chi square of four: one of a thousand is farther
TICKS_S = 0.75  # until the recorder looks, and its checkpoint comes


@dataclass
class Heard(Cluster):
    """A cluster that notes when tracks are planned for, and which are there."""

    plans: dict[int, list[tuple[float, str, Plan]]] = field(default_factory=lambda: defaultdict(list))
    truths: dict[int, NDArray[np.float64]] = field(default_factory=dict)  # (M, 4), by dwell
    rosters: list[tuple[float, frozenset[int]]] = field(default_factory=list)

    def __init__(self, seed: int, disk: Disk) -> None:
        super().__init__(seed, disk)
        self.plans, self.truths, self.rosters = defaultdict(list), {}, []

    def publish(self, sender: Process, message: Message) -> None:
        if isinstance(message, Plan):
            self.plans[message.target].append((self.now_s, sender.name, message))
        if isinstance(message, Truth):
            self.truths[message.k] = message.states
        if isinstance(message, Waveform):
            self.rosters.append((self.now_s, frozenset(roster_of(message).ids.tolist())))
        super().publish(sender, message)

    def confirmed(self, at_s: float) -> set[int]:
        """Tracks that were planned for in the second before this time, as confirmed when it was done last."""
        last = {m: [plan for when, _, plan in said if at_s - 1.0 <= when < at_s][-1:] for m, said in self.plans.items()}
        return {m for m, found in last.items() if found and found[0].status == "tracking" and found[0].confirmed}

    def ended(self, tracks: Set[int]) -> set[int]:
        """Those that are missing in some roster since something was done."""
        return {m for m in tracks for when, ids in self.rosters if when >= AT_S and m not in ids}

    def longest_s(self, track: int) -> float:
        """Longest time between two plans of a track."""
        times = [when for when, _, _ in self.plans[track]]
        return max(after - before for before, after in pairwise(times))


def _kill(cluster: Cluster, name: str) -> None:
    cluster.kill(name)


def _hang(cluster: Cluster, name: str) -> None:
    cluster.processes[name].halted.add(Fault(Kind.HANG, AT_S, SECONDS, name))


def _freeze(cluster: Cluster, name: str) -> None:
    _hang(cluster, name)
    process = cluster.processes[name]

    def expire() -> None:
        process.is_dead_to_others = True
        cluster.tell_members()

    cluster.at(cluster.now_s + LEASE_S, expire)


def _restart(cluster: Cluster, name: str, away_s: float = 1.0) -> None:
    cluster.kill(name)
    cluster.at(cluster.now_s + away_s, lambda: cluster.start(name))


@pytest.fixture
def disk() -> Iterator[Disk]:
    found = Disk(generator(1, Purpose.FAULT, -1, 2))
    yield found
    found.close()


def _halt(cluster: Cluster, name: str, away_s: float) -> None:
    process, fault = cluster.processes[name], Fault(Kind.HANG, cluster.now_s, cluster.now_s + away_s, name)
    process.halted.add(fault)

    def go_on() -> None:
        process.halted.discard(fault)
        cluster.serve(process)

    cluster.at(fault.until_s, go_on)


def _slow_down(cluster: Cluster, name: str, away_s: float) -> None:
    """Let it hang most of the time."""
    for i in range(round(away_s)):
        cluster.at(AT_S + i, lambda: _halt(cluster, name, 0.9))


def _played(
    disk: Disk,
    rate_hz: float,
    do: Callable[[Cluster], None],
    scenario: Scenario | None = None,
    seconds: float = SECONDS,
) -> Heard:
    """Some seconds of a run in real time, in which something is done to the processes once two tracks are confirmed."""
    cluster = Heard(1, disk)
    for name in NAMES:
        cluster.start(name)
    start = RunStart.of(scenario or load("smoke", UNKNOWN), Strategy.POWER_AWARE, 1, 10_000, rate_hz)
    cluster.ask([start.model_copy(update={"run": "take"})])
    cluster.at(AT_S, lambda: do(cluster))
    while cluster.step(seconds):
        pass
    return cluster


@pytest.mark.parametrize("fault", [_kill, _hang, _freeze])
@pytest.mark.parametrize("rate_hz", [RATE_HZ, 1.0])
def test_a_planner_that_is_gone_ends_no_track(
    disk: Disk, rate_hz: float, fault: Callable[[Cluster, str], None]
) -> None:
    cluster = _played(disk, rate_hz, lambda cluster: fault(cluster, "planner-0"))
    confirmed = cluster.confirmed(AT_S)
    orphans = {m for m in confirmed if [name for when, name, _ in cluster.plans[m] if when < AT_S][-1] == "planner-0"}
    assert orphans  # else nothing is seen
    assert not cluster.ended(confirmed)
    assert confirmed <= cluster.confirmed(SECONDS)
    for m in orphans:
        assert cluster.plans[m][-1][1] == "planner-1"
        assert cluster.longest_s(m) <= max(WITHIN_S, MISSED / rate_hz) + 1.0 / rate_hz + TICKS_S


def _restart_both(cluster: Cluster, name: str) -> None:
    """So that nobody has the scans."""
    for planner in (name, "planner-1"):
        _restart(cluster, planner)


@pytest.mark.parametrize("fault", [_kill, _hang, _freeze, _restart_both])
def test_estimates_of_the_new_owner_are_where_the_old_one_would_have_coasted_to(
    disk: Disk, monkeypatch: pytest.MonkeyPatch, fault: Callable[[Cluster, str], None]
) -> None:
    """And as near to the target as a belief that has coasted since the last plan says, in each dwell from then on."""
    states: dict[tuple[int, int], tuple[TrackerModel, TrackState]] = {}
    whole = OwnedTrack.observe

    def observe(track: OwnedTrack, scan: Detections, model: TrackerModel) -> None:
        whole(track, scan, model)
        states.setdefault((track.state.target, track.state.k), (model, track.state))

    monkeypatch.setattr(OwnedTrack, "observe", observe)
    cluster = _played(disk, RATE_HZ, lambda cluster: fault(cluster, "planner-0"))
    taken_over = 0
    for m in cluster.confirmed(AT_S):
        last, owner = max((plan.k, name) for when, name, plan in cluster.plans[m] if when < AT_S)
        if owner != "planner-0":
            continue
        model, state = states[m, last]
        target = np.argmin(np.linalg.norm(cluster.truths[last] - state.belief.moments()[0], axis=1))
        for plan in [plan for _, _, plan in cluster.plans[m] if last < plan.k <= last + COASTED]:
            mean, covariance = coast(model, state, plan.k + 1).belief.moments()
            assert _distance(plan.estimate - mean, covariance) < UNLIKELY
            assert _distance(plan.estimate - cluster.truths[plan.k][target], covariance) < UNLIKELY
            assert np.trace(plan.covariance[::2, ::2]) < np.trace(covariance[::2, ::2])
            taken_over += 1
    assert taken_over


def _distance(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Squared, in standard deviations."""
    return float(error @ np.linalg.solve(covariance, error))


@pytest.mark.parametrize("name", ["allocator-0", "emulator-0", "recorder-0", "planner-0"])
def test_a_process_that_comes_back_after_a_second_ends_no_track(disk: Disk, name: str) -> None:
    cluster = _played(disk, RATE_HZ, lambda cluster: _restart(cluster, name))
    confirmed = cluster.confirmed(AT_S)
    assert confirmed
    assert not cluster.ended(confirmed)
    assert confirmed <= cluster.confirmed(SECONDS)
    assert cluster.rosters[-1][0] > SECONDS - 0.5


@pytest.mark.parametrize("rate_hz", [2.0, 4.0, pytest.param(10.0, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("fault", [_halt, _restart, _slow_down])
def test_looks_that_are_repeated_while_no_allocator_answers_end_no_track(
    disk: Disk, rate_hz: float, fault: Callable[[Cluster, str, float], None]
) -> None:
    """In seven seconds aircraft fly out of their looks and gates: in each dwell a second passes for them."""
    away_s, until_s = 7.0, AT_S + 11.0
    cluster = _played(disk, rate_hz, lambda cluster: fault(cluster, "allocator-0", away_s), load(TRAFFIC), until_s)
    confirmed = cluster.confirmed(AT_S)
    assert confirmed
    assert not cluster.ended(confirmed)
    assert confirmed <= cluster.confirmed(until_s)
    assert cluster.rosters[-1][0] > until_s - 1.0


def test_plans_of_a_run_whose_waveforms_came_late_are_replayed(disk: Disk) -> None:
    """Tracks begin in a scan that is not the next one after their birth."""
    _played(disk, RATE_HZ, lambda cluster: _slow_down(cluster, "allocator-0", 5.0))
    outcome = replay(StoredRun(partial(answer, Store(disk.journal))), "planner")
    assert outcome == Replay(agreed=outcome.agreed)
    assert outcome.agreed > 100


def _cut(reader: str) -> Callable[[Cluster], None]:
    """Let nothing of the emulator get to some processes for a while, three times."""

    def begin(cluster: Cluster) -> None:
        for i, (after_s, long_s) in enumerate(((0.5, 0.7), (2.5, 1.5), (6.0, 3.0))):
            fault = Fault(Kind.CUT, AT_S + after_s, AT_S + after_s + long_s, "emulator", reader, 1.0, i)
            cluster.at(fault.at_s, partial(cluster.links.begin, fault))
            cluster.at(fault.until_s, partial(cluster.links.end, fault))

    return begin


def _halt_all(cluster: Cluster) -> None:
    for i, name in enumerate(NAMES):
        cluster.at(AT_S + 0.4 * i, partial(_halt, cluster, name, 2.0))
        cluster.at(AT_S + 5.0 + 0.3 * i, partial(_halt, cluster, name, 2.7))


def _restart_planners_again(cluster: Cluster) -> None:
    """So that tracks are taken over some dwells after their birth, and snapshots are old."""
    for after_s in (0.5, 6.0):
        for name in ("planner-0", "planner-1"):
            cluster.at(AT_S + after_s, partial(_restart, cluster, name))


@pytest.mark.parametrize("fault", [_restart_planners_again, _halt_all, _cut("planner-0"), _cut("recorder"), _cut("")])
def test_every_plan_of_a_run_with_outages_is_replayed(disk: Disk, fault: Callable[[Cluster], None]) -> None:
    """Scans that some process missed come again: no dwell is lost, and each belief had the scans of the journal."""
    cluster = _played(disk, RATE_HZ, fault, seconds=18.0)
    outcome = replay(StoredRun(partial(answer, Store(disk.journal))), "planner")
    assert outcome == Replay(agreed=outcome.agreed, cut_short=outcome.cut_short)
    stored = {(plan.target, plan.k) for said in cluster.plans.values() for _, _, plan in said}
    assert outcome.agreed > max(100, 0.9 * len(stored))


def test_plans_of_a_planner_that_went_without_scans_are_told_from_those_that_differ(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where no recall helps in time; dwells that no process has the scans of are none that differ."""
    monkeypatch.setattr(RecallRequest, "may_ask", lambda *_: False)
    _played(disk, RATE_HZ, _cut("planner-0"), seconds=18.0)
    outcome = replay(StoredRun(partial(answer, Store(disk.journal))), "planner")
    assert (outcome.difference, outcome.missing) == (None, 0)
    assert outcome.other_scans > 0
    assert outcome.agreed > 200


def test_allocators_that_come_and_go_give_each_new_track_the_next_number(disk: Disk) -> None:
    """No id is used twice, and none is left out but those of a roster that was never radiated."""

    def restart(cluster: Cluster) -> None:
        for i in range(4):
            cluster.at(AT_S + i, lambda: _restart(cluster, "allocator-0", 0.5))

    cluster = _played(disk, RATE_HZ, restart)
    seen = {m for _, ids in cluster.rosters for m in ids}
    assert len(seen) >= 2
    assert max(seen) < len(seen) + 4


def test_planners_that_are_all_away_for_longer_than_a_snapshot_is_old_go_on_from_all_scans(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    away_s, coasted = 4.0, list[int]()
    whole = OwnedTrack.coast

    def coast(track: OwnedTrack, k: int) -> None:
        coasted.append(k - track.k)
        whole(track, k)

    monkeypatch.setattr(OwnedTrack, "coast", coast)

    def restart(cluster: Cluster) -> None:
        for name in ("planner-0", "planner-1"):
            _restart(cluster, name, away_s)

    cluster = _played(disk, RATE_HZ, restart)
    confirmed = cluster.confirmed(AT_S)
    assert confirmed
    assert not cluster.ended(confirmed)
    assert confirmed <= cluster.confirmed(SECONDS)
    assert all(n <= 1 for n in coasted)
    assert all(cluster.longest_s(m) <= away_s + 0.5 + 1.0 / RATE_HZ for m in confirmed)


def test_a_planner_is_not_suspended_for_the_one_before_it(disk: Disk) -> None:
    cluster = _played(disk, RATE_HZ, lambda cluster: cluster.kill("planner-0"))
    orphans = {m for m in cluster.confirmed(AT_S) if cluster.plans[m][0][1] == "planner-0"}
    assert orphans
    for m in orphans:  # one gap, and it stays where it is
        assert {name for when, name, _ in cluster.plans[m] if when >= AT_S} == {"planner-1"}


def test_a_track_coasts_longer_than_two_takeovers_take() -> None:
    assert COASTED_S > 2.0 * (LEASE_MS / 1000 + LEAVE_AFTER_S + TICKS_S)


@pytest.mark.parametrize("amount", [1.0, 2.0, 3.0])  # the receiver raises, measures nonsense, measures nothing
def test_an_outage_of_the_receiver_ends_no_track(disk: Disk, amount: float) -> None:
    def begin(cluster: Cluster) -> None:
        cluster.receiver_faults.amounts.append(amount)
        cluster.at(AT_S + 2.0, cluster.receiver_faults.amounts.clear)

    cluster = _played(disk, RATE_HZ, begin)
    confirmed = cluster.confirmed(AT_S)
    assert confirmed
    assert not cluster.ended(confirmed)
    assert confirmed <= cluster.confirmed(SECONDS)
    for m in confirmed:
        assert cluster.longest_s(m) < 2.0 / RATE_HZ  # each dwell is planned for, measured or not
        coasted = [plan.existence for when, _, plan in cluster.plans[m] if AT_S + 0.5 < when < AT_S + 2.0]
        assert coasted
        assert min(filter(None, coasted)) > 0.95
