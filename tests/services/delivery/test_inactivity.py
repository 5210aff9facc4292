"""Runs of which nobody speaks any more are forgotten, and begin again where the store says."""

import numpy as np
import pytest

from cogradar.services.delivery.inactivity import FORGET_S, Inactivity
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Plan, RunCancel, RunEnd
from cogradar.shared.protocol.recovery import ScanRecall
from cogradar.shared.wire.runner import TICK_S
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import SMOKE, checkpoint, plans, scans, smoke_start, waveforms
from tests.services.loop import play as all_messages

START = smoke_start(dwells=20)
BEGIN = checkpoint(START)
WORKERS = ("emulator-0", "allocator-0", "planner-0", "planner-1")


def _ticks(inactivity: Inactivity, seconds: float, begin_s: float = 0.0) -> list[str]:
    times = np.arange(begin_s, begin_s + seconds, TICK_S)
    return [run for time_s in times for run in inactivity.after(Tick(float(time_s)))]


def test_a_run_is_forgotten_when_it_was_silent_for_long_and_not_before() -> None:
    inactivity = Inactivity()
    _ticks(inactivity, 5.0)
    assert inactivity.after(BEGIN) == []
    assert _ticks(inactivity, FORGET_S - 1.0, 5.0) == []
    assert inactivity.after(plans(all_messages(smoke_start()))[0]) == []  # any message of the run
    assert _ticks(inactivity, FORGET_S - 1.0, 5.0 + FORGET_S) == []
    assert _ticks(inactivity, 3.0, 4.0 + 2.0 * FORGET_S) == ["r"]
    assert _ticks(inactivity, 2.0 * FORGET_S, 3.0 * FORGET_S) == []


def test_a_process_that_was_frozen_has_not_heard_silence() -> None:
    inactivity = Inactivity()
    inactivity.after(Tick(0.0))
    inactivity.after(BEGIN)
    assert inactivity.after(Tick(10.0 * FORGET_S)) == []


def test_what_is_said_of_other_runs_does_not_count() -> None:
    inactivity = Inactivity()
    inactivity.after(BEGIN)
    inactivity.after(BEGIN.model_copy(update={"run": "other"}))
    _ticks(inactivity, FORGET_S - 10.0)
    inactivity.after(BEGIN.model_copy(update={"run": "other"}))
    assert _ticks(inactivity, 20.0, FORGET_S) == ["r"]


def test_a_run_in_real_time_is_waited_for_as_long_as_it_takes_besides() -> None:
    inactivity, slow = Inactivity(), checkpoint(START.model_copy(update={"rate_hz": 0.1}))
    inactivity.after(slow)
    lasts_s = (SMOKE.radar.acquisition.max_scans + 20) / 0.1
    assert _ticks(inactivity, lasts_s + FORGET_S - 2.0) == []
    assert _ticks(inactivity, 4.0, lasts_s + FORGET_S - 2.0) == ["r"]


def _knows(network: FaultyNetwork, name: str, run: str = "r") -> bool:
    """Whether a core keeps anything under the name of a run."""
    fields = vars(network.processes[name].core).values()
    return any(isinstance(field, dict) and run in field for field in fields)


def _let_pass(network: FaultyNetwork, seconds: float) -> None:
    for _ in range(int(seconds / TICK_S)):
        network.tick()
        while network.step():
            pass


@pytest.mark.parametrize("until", [60, 200])
def test_workers_forget_a_run_whose_metrics_is_gone_and_go_on_when_it_is_back(until: int) -> None:
    """The digest is that of an undisturbed run."""
    expected = play(FaultyNetwork(START, 2, np.random.default_rng(0)), {})
    network = FaultyNetwork(START, 2, np.random.default_rng(1))
    for _ in range(until):
        assert network.step()
    assert all(_knows(network, name) for name in WORKERS)
    network.kill("recorder-0")
    _let_pass(network, FORGET_S - 5.0)
    assert all(_knows(network, name) for name in WORKERS)
    _let_pass(network, 10.0)
    assert not any(_knows(network, name) for name in WORKERS)
    network.start("recorder-0")
    assert play(network, {}) == expected
    assert network.refused == []


@pytest.mark.parametrize("name", WORKERS)
def test_a_worker_that_was_cut_off_and_forgot_a_run_takes_it_up_again(name: str) -> None:
    expected = play(FaultyNetwork(START, 2, np.random.default_rng(0)), {})
    network = FaultyNetwork(START, 2, np.random.default_rng(2))
    for _ in range(120):
        assert network.step()
    network.processes[name].cut_off = True
    _let_pass(network, FORGET_S + 10.0)
    assert not _knows(network, name)
    (run,) = network.store.read("SELECT status FROM run")  # it ends without a planner that has no track, and waits else
    assert [_knows(network, other) for other in WORKERS if other != name] == 3 * [run["status"] == "running"]
    network.processes[name].cut_off = False
    assert play(network, {}) == expected


@pytest.mark.parametrize("seed", range(5))
def test_a_cancelled_run_is_forgotten_by_all_whatever_is_lost(seed: int) -> None:
    """The operator says it until metrics shows it; who lost the last checkpoint hears it again, or nothing any more."""
    network = FaultyNetwork(START, 2, np.random.default_rng(seed), loss=0.3)
    while not network.store.read("SELECT 1 FROM run"):
        network.publish("operator", START)
        network.step()
    for _ in range(100):
        if not network.step():
            network.tick()
    sent = 0
    while network.store.read("SELECT status, reason FROM run") != [{"status": "stopped", "reason": "by user"}]:
        network.publish("operator", RunCancel(run="r"))
        network.step()
        sent += 1
    assert sent < 1000
    _let_pass(network, FORGET_S + 10.0)
    assert not any(_knows(network, name) for name in (*WORKERS, "recorder-0"))


def test_a_radar_in_real_time_transmits_to_the_end_though_nobody_else_is_left() -> None:
    """Much longer than a run is waited for, since the machine is slow: each dwell counts as if somebody spoke."""
    core, dwells = EmulatorCore(SimulatedFrontEnd.open), int(FORGET_S) + 50
    begin = checkpoint(START.model_copy(update={"rate_hz": 1000.0, "dwells": dwells}))
    core.handle(begin)
    core.handle(Tick(0.0))
    core.handle(next(waveform for waveform in waveforms(all_messages(smoke_start())) if waveform.tracking))
    sent = [message for i in range(1, dwells + 20) for message in core.handle(Tick(float(i)))]
    assert isinstance(sent[-1], RunEnd)
    assert (sent[-1].t, sent[-1].status) == (dwells, "complete")
    assert core.wake_s is None
    assert [run for i in range(2 * dwells) for run in core.handle(Tick(dwells + 20.0 + i))] == []
    assert core.handle(begin) == []  # the run begins anew: it was forgotten after its end
    assert core.has_deferred


def test_a_planner_that_forgot_a_run_begins_it_again_at_the_checkpoint() -> None:
    core, received = PlannerCore("p"), scans(all_messages(START))
    core.handle(BEGIN)
    first = [plan for scan in received for plan in core.handle(scan)]
    for i in range(int(FORGET_S) + 5):
        assert list(core.handle(Tick(float(i)))) == []
    k, t = 10, received[9].t
    assert list(core.handle(checkpoint(START, k, t))) == [ScanRecall(run="r", k=0, targets=[0, 1], planner="p")]
    again = [message for scan in received for message in core.handle(scan)]
    assert [m for m in again if isinstance(m, Plan)] == [
        plan for plan in first if isinstance(plan, Plan) and plan.k >= k
    ]
