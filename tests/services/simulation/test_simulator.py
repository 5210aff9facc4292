"""The simulator: a schedule is a function of its seed, its faults do something, and what is wrong is found."""

import math
import sys
from dataclasses import replace
from functools import partial

import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery.inactivity import Inactivity
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import Deposed
from cogradar.services.planner.core import PlannerCore
from cogradar.services.planner.ownership import owners
from cogradar.services.runs import in_process
from cogradar.services.simulation import trials
from cogradar.services.simulation.cluster import Cluster
from cogradar.services.simulation.disk import Disk
from cogradar.services.simulation.memory import FUNCTIONS, Memory
from cogradar.services.simulation.schedule import DWELLS, JOINED_S, Asked, Fault, Kind, Schedule
from cogradar.services.simulation.simulator import Outcome, play
from cogradar.services.simulation.skies import start_of
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Plan, Scan, Truth
from cogradar.shared.protocol.orders import DropTrack, EndRun, Look, PowerLimit, SectorSearch
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import parse_radar
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.pool import members
from cogradar.shared.wire.pool.shares import Shares
from tests.services.loop import checkpoint, scans, waveforms
from tests.services.loop import play as play_cores
from tests.services.simulation.plain import played

IN_CI, LOT = 5000, 250  # schedules, and of them in one test


pytestmark = pytest.mark.usefixtures("remembered")


def test_what_is_remembered_is_replaced_where_it_is_called() -> None:
    found = {
        getattr(value, "__wrapped__", None)
        for name, module in sys.modules.items()
        if name.startswith("cogradar.")
        for value in list(vars(module).values())
        if callable(value)
    }
    assert found >= set(FUNCTIONS)


@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_equal_arguments_are_computed_once(sky: str) -> None:
    computed, memory = list[TrackerModel](), Memory(10)
    for _ in range(2):
        radar = parse_radar(start_of(sky, 1, 0.0).scenario["radar"], "here")
        memory.result(computed.append, (TrackerModel.of(radar, Strategy.POWER_AWARE, 1),))
    assert len(computed) == 1


def test_named_arguments_count_as_the_others() -> None:
    computed, memory = list[str](), Memory(10)

    def said(what: str, *, loud: bool) -> str:
        computed.append(what)
        return what.upper() if loud else what

    found = [memory.result(said, ("on",), {"loud": loud}) for loud in (True, False, True, False)]
    assert found == ["ON", "on", "ON", "on"]
    assert computed == ["on", "on"]


def test_what_cannot_be_told_by_its_value_is_no_argument() -> None:
    class Opaque:
        def __init__(self) -> None:
            self.value = 1

    with pytest.raises(TypeError, match="Opaque cannot be told by its value"):
        Memory(10).result(repr, (Opaque(),))


@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_without_faults_it_is_the_run_of_one_process(sky: str) -> None:
    outcome = played(sky=sky)
    assert outcome.violation == ""
    assert outcome.found is not None
    (found,) = outcome.found.values()
    assert found[2] == in_process.play(start_of(sky, 1, 0.0)).run["digest"]


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 2.0, 10.0])
def test_without_faults_nothing_is_asked_for_again(rate_hz: float) -> None:
    assert played(rate_hz=rate_hz).violation == ""


def test_a_schedule_is_a_function_of_its_seed() -> None:
    for seed in (3, 4, 5):
        assert Schedule.draw(seed) == Schedule.draw(seed)
        assert play(Schedule.draw(seed)) == play(Schedule.draw(seed))


def test_every_kind_of_fault_is_drawn() -> None:
    drawn = [Schedule.draw(seed) for seed in range(200)]
    assert {fault.kind for schedule in drawn for fault in schedule.faults} == set(Kind)
    assert {schedule.sky for schedule in drawn if schedule.rate_hz} == {"known", "unknown"}


@pytest.mark.parametrize("who", ["emulator-0", "allocator-0"])
@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_runs_that_are_moved_to_another_process_and_back_are_the_same(who: str, rate_hz: float) -> None:
    moved = Fault(Kind.MOVED, 0.03, 0.9, who)
    assert played(moved, rate_hz=rate_hz).violation == ""
    crash = Fault(Kind.CRASH, 0.1, 0.4, who, n=1)  # it is started while its runs are elsewhere
    assert played(moved, crash, rate_hz=rate_hz).violation == ""


def test_in_real_time_a_process_that_lost_a_run_radiates_no_dwell_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = Fault(Kind.MOVED, 0.3, 2.5, "emulator-0")
    run = partial(played, moved, rate_hz=10.0, dwells=40, checkpoint_dwells=16)
    assert run().violation == ""
    monkeypatch.setattr(Inactivity, "_serve", lambda *_: [])
    assert "was radiated twice" in run().violation


# Pools.


def _pooled(*faults: Fault, **changed: object) -> Outcome:
    at = [replace(fault, at_s=JOINED_S + fault.at_s, until_s=JOINED_S + fault.until_s) for fault in faults]
    return played(*at, pool=2, **changed)


def _frozen(role: str, i: int) -> Fault:
    return Fault(Kind.FREEZE, 0.002, 4.0, f"{role}-{i}")


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
@pytest.mark.parametrize("role", ["emulator", "allocator"])
def test_runs_of_a_process_that_is_gone_or_frozen_are_taken_over(role: str, rate_hz: float) -> None:
    for fault in (Fault(Kind.CRASH, 0.002, math.inf, f"{role}-0"), _frozen(role, 0), _frozen(role, 1)):
        outcome = _pooled(fault, rate_hz=rate_hz, dwells=60 if rate_hz else DWELLS)
        assert outcome.violation == ""


@pytest.mark.parametrize("kind", [Kind.ROUTER, Kind.CUT, Kind.UNHEARD])
def test_processes_that_do_not_see_each_other_change_no_run(kind: Kind) -> None:
    who, whom = ("", "") if kind is Kind.ROUTER else ("emulator-0", "emulator-1" if kind is Kind.CUT else "")
    hidden = Fault(kind, 0.002, 2.5, who, whom, n=1)
    assert _pooled(hidden).violation == ""
    assert _pooled(hidden, Fault(Kind.CRASH, 0.004, 3.0, "emulator-1")).violation == ""


@pytest.mark.parametrize("role", ["emulator", "allocator"])
def test_a_process_that_acts_after_its_claim_is_lost_is_found(role: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(members, "PAUSE_S", math.inf)
    said = [_pooled(_frozen(role, i)).violation for i in (0, 1)]
    assert any(f"{role}-" in text and "which" in text and "serves" in text for text in said), said


def test_two_processes_that_serve_one_run_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Shares, "see", lambda *_, **__: None)
    assert "serves" in _pooled(Fault(Kind.HANG, 3.0, 3.1, "planner-0")).violation


def test_claims_that_are_never_given_up_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Shares, "_expire", lambda *_: None)
    gone = [_pooled(Fault(Kind.CRASH, 0.002, math.inf, f"emulator-{i}")).violation for i in (0, 1)]
    assert any("not over" in text for text in gone), gone


@pytest.mark.parametrize("kind", [Kind.CRASH, Kind.HANG, Kind.FREEZE])
@pytest.mark.parametrize("who", ["recorder-0", "emulator-0", "allocator-0"])
def test_nothing_goes_on_without_a_process_that_there_is_one_of(kind: Kind, who: str) -> None:
    outcome = played(Fault(kind, 0.01, 3.0, who))
    assert outcome.violation == ""
    assert outcome.simulated_s >= 3.0


@pytest.mark.parametrize("sky", ["known", "unknown"])
@pytest.mark.parametrize("amount", [1.0, 2.0, 3.0])  # it raises, it measures nonsense, it measures nothing
def test_a_receiver_that_fails_for_a_while_ends_no_run(sky: str, amount: float) -> None:
    fault = Fault(Kind.RECEIVER, 0.3, 0.8, "emulator-0", amount=amount)
    assert played(fault, sky=sky, rate_hz=10.0).violation == ""
    at_once = Fault(Kind.RECEIVER, 0.0, 0.05, "emulator-0", amount=amount)
    assert played(at_once, sky=sky).violation == ""  # the same run, byte for byte


def test_who_is_behind_never_finds_its_inbox_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    handle, drained = AllocatorCore.handle, list[tuple[float, bool]]()

    def noted(self: AllocatorCore, event: Event) -> object:
        if isinstance(event, Tick):
            drained.append((event.now_s, event.drained))
        return handle(self, event)

    monkeypatch.setattr(AllocatorCore, "handle", noted)
    assert played(Fault(Kind.BEHIND, 1.0, 2.0, "allocator-0"), Fault(Kind.CUT, 0.0, 3.0, "x", "y", n=1)).violation == ""
    assert {has for now_s, has in drained if now_s < 1.0 or now_s > 2.3} == {True}
    assert {has for now_s, has in drained if 1.3 < now_s < 2.0} == {False}


@pytest.mark.parametrize("kind", [Kind.CUT, Kind.LOSS])
def test_nothing_goes_on_if_no_message_arrives(kind: Kind) -> None:
    outcome = played(Fault(kind, 0.01, 3.0, "emulator-0", "recorder-0", 1.0), Fault(kind, 0.01, 3.0, "x", "y"))
    assert outcome.violation == ""
    assert outcome.simulated_s >= 3.0


def test_a_full_disk_lets_the_run_wait_for_room() -> None:
    outcome = played(Fault(Kind.FULL, 0.005, 3.0, "recorder-0"))
    assert outcome.violation == ""
    assert outcome.simulated_s >= 3.0


@pytest.mark.parametrize("n", [1, 2, 3, 5, 13])
@pytest.mark.parametrize("is_done", [False, True])
def test_an_error_of_the_disk_ends_the_recorder_and_changes_no_run(
    n: int, is_done: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the commit that it was is there or not."""
    died, ended = Cluster._died, list[str]()

    def noted(self: Cluster, key: str, error: Exception) -> None:
        ended.append(f"{key}: {error}")
        died(self, key, error)

    monkeypatch.setattr(Cluster, "_died", noted)
    monkeypatch.setattr(Disk, "is_done", lambda _: is_done)
    assert played(Fault(Kind.BROKEN, 0.0, 3.0, "recorder-0", amount=n)).violation == ""
    (text,) = ended
    assert text.startswith("recorder-0: ")
    assert text.endswith("disk I/O error")


def test_transactions_that_were_never_synced_are_played_again(monkeypatch: pytest.MonkeyPatch) -> None:
    cut_back, lost = Disk.cut_back, list[int]()

    def noted(self: Disk) -> None:
        before = self.path.with_name(f"{self.path.name}-wal").stat().st_size
        cut_back(self)
        lost.append(before - self.path.with_name(f"{self.path.name}-wal").stat().st_size)

    monkeypatch.setattr(Disk, "cut_back", noted)
    for seed in range(6):
        assert played(Fault(Kind.UNSYNCED, 0.003, 0.02, "recorder-0"), seed=seed).violation == ""
    assert max(lost) > 0


@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_a_journal_that_is_away_lets_the_run_wait_for_it(sky: str) -> None:
    away = Fault(Kind.REMOVED, 0.003, 3.0, "recorder-0")
    outcome = played(away, sky=sky)
    assert outcome.violation == ""
    assert outcome.simulated_s >= 3.0
    crash = Fault(Kind.CRASH, 1.0, 2.0, "recorder-0", n=1)
    assert played(away, crash, sky=sky).violation == ""


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_planners_that_never_come_back_are_not_needed(rate_hz: float) -> None:
    gone = [Fault(Kind.GONE, 0.002 * i, math.inf, f"planner-{i}", n=i) for i in (1, 2)]
    assert played(*gone, planners=3, rate_hz=rate_hz).violation == ""


SUCCEEDED = Fault(Kind.SUCCESSOR, 0.0005, 2.5, "recorder-0")


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_a_recorder_that_wakes_beside_its_successor_ends_and_changes_nothing(
    sky: str, rate_hz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    died, ended = Cluster._died, list[tuple[str, type[Exception], float]]()

    def noted(self: Cluster, key: str, error: Exception) -> None:
        ended.append((key, type(error), self.now_s))
        died(self, key, error)

    monkeypatch.setattr(Cluster, "_died", noted)
    assert played(SUCCEEDED, sky=sky, rate_hz=rate_hz).violation == ""
    ((key, kind, at_s),) = ended
    assert (key, kind) == ("recorder-0.left1", Deposed)
    assert 2.5 <= at_s < 3.6


COMMANDS = (
    Asked(0, PowerLimit(share=0.5), 4),
    Asked(0, SectorSearch(from_deg=-90, to_deg=0, search="blank"), 4),
    Asked(0, Look(bearing_deg=20, dwells=2, share=0.2), 5),
    Asked(0, DropTrack(track=0), 5),
    Asked(0, EndRun(), 7),
)


@pytest.mark.parametrize("who", ["recorder-0", "emulator-0", "allocator-0", "planner-0"])
@pytest.mark.parametrize("checkpoint_dwells", [2, 16])
def test_a_command_shapes_the_same_dwells_whoever_dies_around_it(who: str, checkpoint_dwells: int) -> None:
    for at_s in (0.0015, 0.004, 0.3):
        fault = Fault(Kind.CRASH, at_s, at_s + 1.0, who)
        for sky in ("known", "unknown"):
            commands = COMMANDS[::4] if sky == "known" else COMMANDS
            outcome = played(fault, sky=sky, commands=commands, checkpoint_dwells=checkpoint_dwells)
            assert outcome.violation == ""


# What was found, shrunk.


@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_an_emulator_that_comes_back_goes_on_after_the_waveform_that_others_have_come_to(sky: str) -> None:
    """It radiated a dwell of the acquisition again, with beams; or dwell 0, with tracks that had not begun by then."""
    start = start_of(sky, 1, 10.0)
    newest = next(one for one in waveforms(play_cores(start_of(sky, 1, 0.0))) if one.tracking)
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(newest)
    core.handle(checkpoint(start))
    scan, truth = core.handle(Tick(1.0))
    assert isinstance(scan, Scan)
    assert isinstance(truth, Truth)
    assert scan.k == newest.k + 1


def test_a_dwell_of_the_acquisition_that_comes_again_with_beams_ends_no_planner() -> None:
    """Seed 400, where an emulator had radiated dwell 1 twice."""
    received = {seed: scans(play_cores(start_of("known", seed, 0.0))) for seed in range(1, 6)}
    seed = next(seed for seed, heard in received.items() if heard[1].t == 0)  # one scan does not end the acquisition
    hears = checkpoint(start_of("known", seed, 10.0))
    first, *_, late = received[seed]
    planner = PlannerCore("planner-0", lambda: 0.0)
    said = [
        answer
        for event in (hears, first, late.model_copy(update={"k": 1}), Tick(1.0))
        for answer in planner.handle(event)
    ]
    assert {plan.status for plan in said if isinstance(plan, Plan)} <= {"searching"}


def test_planners_do_not_ask_again_and_again_for_a_dwell_that_never_was() -> None:
    """Seed 347. Two planners asked as fast as they were answered, and more with every answer, which both received."""
    hangs = Fault(Kind.HANG, 0.4058, 0.8009, "allocator-0"), Fault(Kind.HANG, 0.3931, 1.2298, "emulator-0")
    outcome = played(*hangs, seed=347, run_seed=4, rate_hz=10.0, checkpoint_dwells=16, snapshot_dwells=2)
    assert outcome.violation == ""
    assert outcome.handled < 1000


@pytest.mark.parametrize("heard", [1, 2, 3, 4])
def test_who_takes_a_track_plans_for_it_from_the_first_dwell_on_that_is_not_acknowledged(heard: int) -> None:
    """Seed 5635: a planner died in the acquisition, while the recorder was away. Who took its track planned no more of
    the dwells before, and the run stood still for ever."""
    start = start_of("known", 1, 0.0)
    other = next(name for name in map(str, range(99)) if owners(start.run, 2, ("a", name))[1] == name)
    received, planner = scans(play_cores(start)), PlannerCore("a")
    events: list[Event] = [checkpoint(start), Membership(Role.PLANNER, ("a", other)), *received[:heard]]
    events += [Membership(Role.PLANNER, ("a",)), *received[heard:]]
    said = [answer for event in events for answer in planner.handle(event)]
    planned = sorted((plan.k, plan.target) for plan in said if isinstance(plan, Plan))
    assert planned == [(scan.k, target) for scan in received for target in (0, 1)]


# All together.


@pytest.mark.long
@pytest.mark.parametrize("first", range(1, IN_CI, LOT))
def test_so_many_schedules_hold(first: int) -> None:
    """A failing seed is shown with its faults by `cogradar simulate --replay SEED`."""
    tally = trials.play_lot(first, LOT)
    assert tally.failed == {}
    assert tally.faults > 2 * LOT
    assert tally.handled > DWELLS * LOT


@pytest.mark.parametrize("seed", range(8))
def test_a_bit_of_the_journal_that_flips_changes_no_run_without_notice(seed: int) -> None:
    """The run is set aside, all runs are held, the file is refused, or nothing that is read has changed."""
    assert played(Fault(Kind.ROT, 0.003, 0.02, "recorder-0"), seed=seed).violation == ""
