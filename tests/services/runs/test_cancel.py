"""A run that is cancelled is over for everybody within seconds, whatever is lost, and however often it is cancelled."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from cogradar.services.errors import Interrupted, RunFailed
from cogradar.services.metrics.selection import LISTING
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cancel as cancelling
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.run import RunInterrupted
from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.messages import Message, RunCancel, RunEnd
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.queries import ask
from cogradar.shared.wire.session import free_port, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from studies.processes.timestamps import ask_timestamps
from tests.services.loop import checkpoints, play, scans, smoke_start

COGRADAR = [sys.executable, "-m", "cogradar"]
START = smoke_start(dwells=8)
ENDED = checkpoints(START, ended=True)
CANCEL = RunCancel(run="r")


def _said(core: RecorderCore, event: Event) -> list[Message]:
    """What it answers, without its epochs."""
    return [answer.model_copy(update={"epoch": 0, "leads": []}) for answer in core.handle(event)]


def _row(store: Journal) -> dict[str, Any]:
    (row,) = store.read("SELECT status, reason, digest FROM run")
    return row


# Recorder.


def test_a_run_that_is_cancelled_ends_and_its_end_is_sent_as_often_as_it_is_cancelled() -> None:
    store = Journal(":memory:")
    core = RecorderCore(store)
    core.handle(START)
    assert _said(core, CANCEL) == ENDED
    assert _said(core, CANCEL) == ENDED
    assert _row(store) == {"status": "stopped", "reason": "by user", "digest": ""}
    assert _said(core, START) == ENDED  # a start that is sent again begins nothing
    assert _said(RecorderCore(store, resume=True), CANCEL) == ENDED


def test_a_run_that_its_services_cannot_go_on_with_says_why_it_was_stopped() -> None:
    store = Journal(":memory:")
    core = RecorderCore(store)
    core.handle(START)
    assert _said(core, RunCancel(run="r", reason="because planner-0 ended too often")) == ENDED
    assert _row(store) == {"status": "stopped", "reason": "because planner-0 ended too often", "digest": ""}


def test_who_goes_on_with_a_run_that_is_over_is_told_so() -> None:
    core = RecorderCore(Journal(":memory:"))
    sent = play(START)
    for message in (START, *sent[:4], CANCEL):
        core.handle(message)
    assert _said(core, scans(sent)[2]) == ENDED
    assert _said(core, RunEnd(run="r", k=9, t=8, status="complete")) == ENDED


def test_a_run_may_be_cancelled_before_its_start_is_received() -> None:
    store = Journal(":memory:")
    core = RecorderCore(store)
    assert core.handle(CANCEL) == ()
    assert _said(core, START) == [*checkpoints(START), *ENDED]
    assert _row(store)["reason"] == "by user"


def test_a_run_that_is_complete_stays_so() -> None:
    store = Journal(":memory:")
    core = RecorderCore(store)
    for message in play(START):
        core.handle(message)
    complete = _row(store)
    assert complete["status"] == "complete"
    assert _said(core, CANCEL) == ENDED
    assert _row(store) == complete


# Processes.


def _cogradar(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COGRADAR, *arguments], capture_output=True, text=True, timeout=60, check=False)


def _runs(endpoint: str) -> dict[str, dict[str, Any]]:
    session = open_session([endpoint], 5.0, lambda: None)
    try:
        return {row["run"]: row for row in json.loads(ask(session, "runs", {}, 10.0))}
    finally:
        session.close()


def _until(condition: Callable[[], bool], within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _nobody_speaks_of(endpoint: str, *runs: str) -> None:
    """Soon no process says anything of the runs any more: not when metrics repeats itself, nor by itself."""
    session = open_session([endpoint], 5.0, lambda: None)

    def said() -> list[dict[str, int]]:
        timings = [ask_timestamps(session, run, 5.0) for run in runs]
        return [{name: len(process.sent) for name, process in timing.items()} for timing in timings]

    try:
        deadline, then, now = time.monotonic() + 20.0, list[dict[str, int]](), said()
        while now != then:
            assert time.monotonic() < deadline
            time.sleep(3.0)
            then, now = now, said()
        assert all(sum(counts.values()) > 0 for counts in then)
    finally:
        session.close()


@pytest.mark.zenoh
@pytest.mark.parametrize(
    ("number", "code", "pace"),
    [(signal.SIGINT, 130, "lockstep"), (signal.SIGTERM, 143, "lockstep"), (signal.SIGTERM, 143, "realtime")],
)
def test_a_run_on_shared_services_ends_with_its_command(
    number: signal.Signals, code: int, pace: str, endpoint: str
) -> None:
    before = set(_runs(endpoint))
    command = [*COGRADAR, "run", "smoke", "--dwells", "100000", "--pace", pace, "--connect", endpoint]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        _until(lambda: any(row["t"] > 0 for name, row in _runs(endpoint).items() if name not in before))
        began = time.monotonic()
        run.send_signal(number)
        table, errors = run.communicate(timeout=15)
        assert time.monotonic() - began < 6.0
    finally:
        run.kill()
        run.communicate()
    (name,) = set(_runs(endpoint)) - before
    assert f"all {_runs(endpoint)[name]['t']}" in table  # as of a run that ends by itself
    assert (run.returncode, errors.strip()) == (code, f"interrupted; {name} is stopped")
    row = _runs(endpoint)[name]
    assert (row["status"], row["reason"]) == ("stopped", "by user")
    _nobody_speaks_of(endpoint, name)


@pytest.mark.zenoh
def test_a_command_whose_run_somebody_else_cancels_shows_what_it_came_to(endpoint: str) -> None:
    before = set(_runs(endpoint))
    command = [*COGRADAR, "run", "smoke", "--dwells", "100000", "--connect", endpoint]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        _until(lambda: any(row["t"] > 0 for name, row in _runs(endpoint).items() if name not in before))
        (name,) = set(_runs(endpoint)) - before
        subprocess.run([*COGRADAR, "cancel", name, "--connect", endpoint], check=True, capture_output=True)
        table, errors = run.communicate(timeout=30)
    finally:
        run.kill()
        run.communicate()
    assert run.returncode == 1
    assert errors.splitlines()[-1] == "stopped by user"
    dwells = _runs(endpoint)[name]["t"]
    assert f"all {dwells}" in table
    assert "target 2, acquired in" in table
    assert "digest none: not all of the run is there" in table


@pytest.mark.zenoh
def test_a_run_that_was_left_alone_is_cancelled_by_name(endpoint: str) -> None:
    done = _cogradar("run", "smoke", "--dwells", "100000", "--connect", endpoint, "--detach")
    assert done.returncode == 0, done.stderr
    name = done.stdout.strip()
    assert done.stdout == f"{name}\n"
    assert _runs(endpoint)[name]["status"] == "running"
    _until(lambda: _runs(endpoint)[name]["t"] > 0)
    done = _cogradar("cancel", name, "--connect", endpoint)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{name} is stopped\n", "")
    assert _runs(endpoint)[name]["reason"] == "by user"
    _nobody_speaks_of(endpoint, name)
    again = _cogradar("cancel", name, "--connect", endpoint)
    assert (again.returncode, again.stdout) == (2, "")
    assert again.stderr == f"{name}: has ended already (stopped)\n"


@pytest.mark.zenoh
def test_a_run_that_there_is_not_cannot_be_cancelled(endpoint: str) -> None:
    for name in ("nobody", "../*", "a b"):
        done = _cogradar("cancel", name, "--connect", endpoint)
        assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{name}: no such run; {LISTING}\n")


@pytest.mark.zenoh
def test_the_runs_of_a_load_end_with_its_command(endpoint: str) -> None:
    before = set(_runs(endpoint))
    command = [sys.executable, "-m", "studies", "load", "--scenario", "smoke", "--dwells", "10000", "--at-once", "3"]
    load = subprocess.Popen([*command, "--connect", endpoint], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        _until(lambda: sum(row["t"] > 0 for name, row in _runs(endpoint).items() if name not in before) == 3)
        load.send_signal(signal.SIGINT)
        load.communicate(timeout=15)
    finally:
        load.kill()
        load.communicate()
    assert load.returncode == 130
    theirs = [row for name, row in _runs(endpoint).items() if name not in before]
    assert [row["reason"] for row in theirs] == ["by user"] * 3
    _nobody_speaks_of(endpoint, *(row["run"] for row in theirs))


@pytest.mark.zenoh
def test_a_run_whose_command_was_killed_goes_on_until_it_is_cancelled_by_name(endpoint: str) -> None:
    before = set(_runs(endpoint))
    command = [*COGRADAR, "run", "smoke", "--dwells", "100000", "--connect", endpoint]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _until(lambda: any(row["t"] > 0 for name, row in _runs(endpoint).items() if name not in before))
    run.kill()
    run.wait()
    (name,) = set(_runs(endpoint)) - before
    t = _runs(endpoint)[name]["t"]
    _until(lambda: _runs(endpoint)[name]["t"] > t + 50)
    assert _cogradar("cancel", name, "--connect", endpoint).returncode == 0
    _nobody_speaks_of(endpoint, name)


@pytest.mark.zenoh
def test_an_interrupt_waits_for_no_results_of_a_slow_metrics(router: str) -> None:
    """All answers together have two seconds: each of them had, and a long run has many."""

    def slow(metric: str, _: Mapping[str, str]) -> bytes:
        time.sleep(0.0 if metric == "runs" else 0.8)
        return json.dumps([{"status": "stopped", "t": 300}]).encode()

    sessions = [open_session([router], 10.0, lambda: None) for _ in range(2)]
    metrics, operator = (
        ZenohBus(session, role, role) for session, role in zip(sessions, (Role.METRICS, Role.OPERATOR), strict=True)
    )
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            metrics.receive(0.05)

    serving = threading.Thread(target=serve)
    try:
        metrics.serve_queries(slow)
        serving.start()
        began = time.monotonic()
        with (
            pytest.raises(Interrupted, match=r"^interrupted; r is stopped$") as ended,
            distributed._cancelled_and_told(sessions[1], operator, smoke_start(dwells=400)),
        ):
            raise Interrupted("interrupted")
        assert not isinstance(ended.value, RunInterrupted)
        assert time.monotonic() - began < distributed.LAST_ANSWER_S + 1.0
    finally:
        over.set()
        serving.join()
        for bus in (operator, metrics):
            bus.close()


@pytest.mark.zenoh
def test_what_nobody_confirms_is_said_within_seconds(router: str) -> None:
    session = open_session([router], 5.0, lambda: None)
    bus = ZenohBus(session, Role.OPERATOR, "operator")
    began = time.monotonic()
    try:
        assert cancelling.cancel(session, bus, ["a", "b"]) == ["a", "b"]
        with (
            pytest.raises(Interrupted, match=r"^stop; no confirmation that a is stopped: it may go on$"),
            cancelling.cancelled_unless_over(session, bus, lambda: ["a"]),
        ):
            raise Interrupted("stop")
    finally:
        bus.close()
    assert time.monotonic() - began < 2.0 * (cancelling.WITHIN_S + cancelling.ANSWER_WITHIN_S) + 1.0
    done = _cogradar("cancel", "a", "--connect", router)
    assert (done.returncode, done.stderr) == (3, f"no metrics service answers at {router}\n")


@pytest.mark.zenoh
@pytest.mark.parametrize("quiet_s", [0.0, 5.0])
def test_services_that_are_missing_are_named_and_not_waited_for_for_long(
    quiet_s: float, router: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody is told that it takes half a second, as it always does."""
    monkeypatch.setattr(distributed, "ALIVE_WITHIN_S", 0.5)
    monkeypatch.setattr(distributed, "QUIET_S", quiet_s)
    said: list[str] = []
    with pytest.raises(RunFailed, match=r"^not alive within 0 s: recorder, metrics, emulator, planner, allocator$"):
        distributed.start_on(router, START, notify=said.append, stop=threading.Event())
    assert said == ([] if quiet_s else ["waiting for recorder, metrics, emulator, planner, allocator"])


def test_without_services_nothing_can_be_cancelled() -> None:
    done = _cogradar("cancel", "r", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert done.returncode == 3
    assert "no metrics service" in done.stderr


def test_a_run_is_left_alone_only_where_services_are_up() -> None:
    done = _cogradar("run", "smoke", "--detach")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--connect" in done.stderr
