"""The operator: one run after the other, whatever is lost, until it is stopped."""

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from cogradar.services.errors import NoMetrics
from cogradar.services.metrics.answers import Rows
from cogradar.services.metrics.client import ask_service
from cogradar.services.operator.core import GONE_TICKS, LISTEN_TICKS, RESEND_TICKS, OperatorCore
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, RunCancel, RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.queries import names_alive
from cogradar.shared.wire.runner import TICK_S
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import Listener
from tests.samples import sample
from tests.services.loop import SMOKE


@pytest.fixture
def operator() -> OperatorCore:
    return OperatorCore(SMOKE, 10.0)


def test_it_begins_one_run_after_the_other(operator: OperatorCore) -> None:
    runs = []
    for _ in range(3):
        (start,) = _ticks(operator, 1)
        assert isinstance(start, RunStart)
        runs.append(start)
        assert not operator.handle(_checkpoint(start.run))
        assert not _ticks(operator, 1)
        assert not operator.handle(_checkpoint(start.run, ended=True))
    assert [(run.seed, run.strategy, run.rate_hz, run.dwells) for run in runs] == [
        (seed, Strategy.POWER_AWARE, 10.0, SMOKE.dwells) for seed in (1, 2, 3)
    ]
    assert len({run.run for run in runs}) == 3


def test_it_sends_a_start_again_until_a_checkpoint_comes(operator: OperatorCore) -> None:
    (start,) = _ticks(operator, 1)
    assert _ticks(operator, 2 * RESEND_TICKS) == [start, start]
    for _ in range(3 * RESEND_TICKS):  # a run that goes on
        operator.handle(_checkpoint(start.run))
        assert not _ticks(operator, 1)


def test_it_sends_a_start_again_when_checkpoints_cease(operator: OperatorCore) -> None:
    """The journal was lost, or the checkpoint of the end: the recorder begins the run again, or repeats its end."""
    (start,) = _ticks(operator, 1)
    operator.handle(_checkpoint(start.run))
    assert _ticks(operator, RESEND_TICKS) == [start]


def test_the_end_of_another_run_is_not_its_business(operator: OperatorCore) -> None:
    (start,) = _ticks(operator, 1)
    operator.handle(_checkpoint("somebody-elses", ended=True))
    assert _ticks(operator, RESEND_TICKS) == [start]


def test_it_waits_twice_as_long_after_every_run_that_fails() -> None:
    operator, waits = OperatorCore(SMOKE, 10.0), []
    for t in (3, 3, 3, SMOKE.dwells, 3):
        n = 1
        while not (sent := _ticks(operator, 1)):
            n += 1
        waits.append(n)
        operator.handle(_checkpoint(sent[0].run, ended=True, t=t))
    assert waits == [1, 2, 4, 8, 1]


def test_it_cancels_its_run_when_it_leaves(operator: OperatorCore) -> None:
    assert not operator.leave()
    (start,) = _ticks(operator, 1)
    assert operator.leave() == (RunCancel(run=start.run),)
    operator.handle(_checkpoint(start.run, ended=True))
    assert not operator.leave()


ENDLESS = SMOKE.model_copy(update={"dwells": NO_END})


def test_a_run_without_an_end_outlives_its_operator_and_is_found_by_the_next_one() -> None:
    operator = OperatorCore(ENDLESS, 10.0)
    start = _begun(operator)
    assert not operator.leave()
    other = OperatorCore(ENDLESS, 10.0)
    assert not other.handle(_goes_on(start, k=1000))
    assert not _ticks(other, GONE_TICKS - 1)
    assert not other.handle(_goes_on(start, k=1016))  # a recorder that was started again
    assert not _ticks(other, GONE_TICKS - 1)
    other.handle(_goes_on(start, k=1016).model_copy(update={"ended": True}))
    assert [type(message) for message in _ticks(other, 1)] == [RunStart]


def test_of_two_runs_without_an_end_the_older_one_stays() -> None:
    """The recorder was away for longer than an operator listens: it begins a run, and then hears of the other one."""
    operator = OperatorCore(ENDLESS, 10.0)
    start = _begun(operator)
    operator.handle(_goes_on(start, k=16))
    older = start.model_copy(update={"run": "older"})
    younger = start.model_copy(update={"run": "younger"})
    assert not operator.handle(_goes_on(younger, k=0))
    cancel = RunCancel(run=start.run, reason="for another run of this radar")
    assert operator.handle(_goes_on(older, k=5000)) == (cancel,)
    assert not operator.handle(_goes_on(start, k=32))
    assert not _ticks(operator, GONE_TICKS - 1)


def test_it_begins_no_run_and_listens_to_none_before_a_recorder_is_there() -> None:
    """A recorder that is restarted may read for longer than an operator listens, and then goes on with its run."""
    operator = OperatorCore(ENDLESS, 10.0)
    start, is_there = _begun(OperatorCore(ENDLESS, 10.0)), False
    operator.has_recorder = lambda: is_there
    assert not _ticks(operator, 20 * LISTEN_TICKS)
    is_there = True
    assert not _ticks(operator, LISTEN_TICKS - 1)
    operator.handle(_goes_on(start, k=1000))
    is_there = False  # for longer than it waits for a run that it found
    assert not _ticks(operator, 2 * GONE_TICKS)
    is_there = True
    assert not _ticks(operator, LISTEN_TICKS - 1)
    operator.handle(_goes_on(start, k=1016))
    assert not _ticks(operator, GONE_TICKS - 1)


def test_a_run_of_another_radar_or_with_an_end_is_not_taken() -> None:
    operator = OperatorCore(ENDLESS, 10.0)
    start = _begun(OperatorCore(ENDLESS, 10.0))
    other = {"rate_hz": 5.0}, {"dwells": 1000}, {"radar": load("paper").radar.model_dump()}
    for change in other:
        operator.handle(_goes_on(start, k=1000).model_copy(update=change))
    assert len(_ticks(operator, LISTEN_TICKS)) == 1


def _begun(operator: OperatorCore) -> RunStart:
    (start,) = _ticks(operator, LISTEN_TICKS)
    assert isinstance(start, RunStart)
    return start


def _goes_on(start: RunStart, k: int) -> Checkpoint:
    (found, _) = RecordedRun(start, k, k).checkpoint()
    return found


def test_without_a_scenario_it_idles() -> None:
    operator = OperatorCore(None)
    assert not _ticks(operator, 3 * RESEND_TICKS)
    assert not operator.leave()


@pytest.mark.zenoh
def test_the_service_begins_its_run_when_a_recorder_is_there(router: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cogradar", "service", "operator", "--connect", router]
    session = open_session([router], 10.0, lambda: None)
    heard, deadline = Listener(session, [RunStart]), time.monotonic() + 60.0
    with subprocess.Popen([*command, "--scenario", "smoke", "--set", "dwells=unlimited"]) as operator:
        try:
            while not names_alive(session, "*", Role.OPERATOR):
                assert time.monotonic() < deadline
            assert heard.receive(2.0 * LISTEN_TICKS * TICK_S) == []
            recorder = [sys.executable, "-m", "cogradar", "service", "recorder", "--store", str(tmp_path / "s.db")]
            with subprocess.Popen([*recorder, "--connect", router]) as recording:
                begun = heard.receive(60.0)
                recording.terminate()
            assert [(type(message), getattr(message, "dwells", 0)) for message in begun] == [(RunStart, NO_END)]
        finally:
            operator.terminate()
    heard.close()
    session.close()


@pytest.mark.zenoh
def test_the_service_plays_until_it_is_stopped(endpoint: str) -> None:
    command = [sys.executable, "-m", "cogradar", "service", "operator", "--connect", endpoint]
    # Long enough for the third run to be still under way when it is seen.
    operator = subprocess.Popen([*command, "--scenario", "smoke", "--rate", "50", "--set", "dwells=80"])
    try:
        runs = _wait_for_third(endpoint)
        operator.send_signal(signal.SIGTERM)
        assert operator.wait(10) == 0
        last = _wait_until_over(endpoint, runs[2]["run"])
    finally:
        operator.kill()
        operator.wait()
    assert [(run["seed"], run["rate_hz"], run["status"]) for run in runs[:2]] == [
        (seed, 50.0, "complete") for seed in (1, 2)
    ]
    assert (last["seed"], last["status"], last["reason"]) == (3, "stopped", "by user")


def _wait_for_third(endpoint: str) -> Rows:
    """Runs of the operator, in their order, while the third one goes on."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        with suppress(NoMetrics):  # of a busy machine: it may answer the next time
            runs = sorted(ask_service(endpoint, "runs", {}), key=lambda row: int(row["seed"]))
            if len(runs) == 3:
                return runs
        time.sleep(0.05)
    raise AssertionError("no third run within a minute")


def _wait_until_over(endpoint: str, run: str) -> dict[str, object]:
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        (row,) = ask_service(endpoint, "runs", {"run": run})
        if row["status"] != "running":
            return row
        time.sleep(0.05)
    raise AssertionError(f"{run} goes on")


def _ticks(operator: OperatorCore, n: int) -> list[Message]:
    return [message for i in range(n) for message in operator.handle(Tick(0.25 * i))]


def _checkpoint(run: str, *, ended: bool = False, t: int = SMOKE.dwells) -> Checkpoint:
    message = sample(Checkpoint, run=run, ended=ended, dwells=SMOKE.dwells, t=t)
    assert isinstance(message, Checkpoint)
    return message
