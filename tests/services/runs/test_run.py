"""Whole runs: the digest is the backbone. Equal in one process and over Zenoh, whatever the number of planners."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.errors import Failure, Interrupted, RunFailed
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner.owned_track import SNAPSHOT_DWELLS
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import in_process
from cogradar.services.runs.launcher import LocalProcesses
from cogradar.services.runs.run import Progress, Result, Rows, progress
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.queries import NoAnswer
from tests.scenarios import varied
from tests.services.conftest import service_processes
from tests.services.loop import SMOKE
from tests.services.stored import rows


def _start(seed: int = 1, strategy: Strategy = Strategy.POWER_AWARE, dwells: int = 6) -> RunStart:
    return RunStart.of(SMOKE, strategy, seed, dwells)


DISTURBED = 400  # dwells of runs in which something happens


def _over_zenoh(start: RunStart, planners: int = 1, store: str | None = None, **other: Any) -> Result:
    settings: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}
    return distributed.play(start, LocalProcesses(planners, store), **(settings | other))


@pytest.mark.zenoh
@pytest.mark.parametrize("planners", [1, 3])
def test_the_digest_is_the_same_in_one_process_and_over_zenoh(planners: int) -> None:
    local, remote = in_process.play(_start()), _over_zenoh(_start(), planners)
    assert remote.run["digest"] == local.run["digest"]
    assert remote.targets == [row | {"run": remote.run["run"]} for row in local.targets]


def test_the_digest_of_a_rule_of_looking_does_not_depend_on_the_number_of_planners() -> None:
    start = RunStart.of(load("smoke", ["radar.planner.rule=exact"]), Strategy.POWER_AWARE, 1, 6)
    (digest,) = {in_process.play(start, planners=planners).run["digest"] for planners in (1, 2, 5)}
    assert digest != in_process.play(_start()).run["digest"]


def test_the_digest_tells_seeds_and_strategies_apart() -> None:
    starts = [_start(), _start(seed=2), _start(strategy=Strategy.UNIFORM), _start(dwells=7)]
    runs = [in_process.play(start) for start in starts]
    assert len({run.run["digest"] for run in runs}) == len(runs)


@pytest.mark.parametrize("planners", [1, 2, 5])
def test_the_digest_does_not_depend_on_the_number_of_planners(planners: int) -> None:
    one, several = in_process.play(_start()), in_process.play(_start(), planners=planners)
    assert several.run["digest"] == one.run["digest"]


@pytest.mark.slow
def test_the_papers_scenario_at_full_size_tracks_every_target() -> None:
    """30 dwells at full size: at these ranges P_D of each tested true bin exceeds 0.999 (closed form), so that misses
    come from bins alone; 24 of 30 allows for the change of bin that each target may make."""
    result = in_process.play(RunStart.of(load("paper"), Strategy.POWER_AWARE, 1, 30))
    assert [row["lost"] for row in result.targets] == [False, False, False]
    assert all(row["detections"] >= 24 for row in result.targets)


def test_a_target_that_flies_over_the_array_does_not_end_the_run() -> None:
    """Without motion noise it can be there exactly: range 0 km, bearing undefined. Then it is behind, and gone."""
    targets = [{"state": [2.0, -1.0, 0.0, 0.0]}, SMOKE.simulated.targets[1].model_dump()]
    scenario = varied(SMOKE, {"targets": targets, "motion": {"sigma_s_km_s2": 0.0}})
    store = in_memory()
    in_process.play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, 5), store=store)
    rows = store.read("SELECT x * x + y * y AS squared FROM score WHERE target = 1")
    assert [row["squared"] for row in rows] == [1.0, 0.0, None, None, None]


def test_an_acquisition_that_cannot_end_is_an_error_that_says_so() -> None:
    deaf = varied(SMOKE, {"echo": {"amplitude_db": -100.0}}, acquisition={"max_scans": 3})
    with pytest.raises(RunFailed, match="within 3 scans"):
        in_process.play(RunStart.of(deaf, Strategy.POWER_AWARE, 1, None))


def test_progress_is_reported_and_a_stop_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_process, "REPORT_EVERY_S", 0.0)
    stop = threading.Event()
    seen: list[Progress] = []

    def report(now: Progress) -> None:
        seen.append(now)
        if now.t > 0:
            stop.set()

    store = in_memory()
    with pytest.raises(Interrupted):
        in_process.play(_start(dwells=40), store=store, report=report, stop=stop)
    assert store.read("SELECT status, reason FROM run") == [{"status": "stopped", "reason": "by user"}]
    assert 0 < seen[-1].t <= 16  # it is reported as far as it is acknowledged
    assert [row["target"] for row in seen[-1].targets] == [1, 2]


def test_a_run_that_fails_in_one_process_is_not_left_running(monkeypatch: pytest.MonkeyPatch) -> None:
    """By an error of whatever part; what was not committed is undone, and the error is what is told."""

    def fail(*_: object) -> None:
        raise ZeroDivisionError

    store = in_memory()
    monkeypatch.setattr("cogradar.services.allocator.core.AllocatorCore.handle", fail)
    with pytest.raises(ZeroDivisionError):
        in_process.play(_start(dwells=40), store=store)
    (row,) = store.read("SELECT status, reason FROM run")
    assert (row["status"], row["reason"] != "by user") == ("failed", True)


@pytest.mark.zenoh
def test_a_store_keeps_the_run_for_later_questions(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    result = _over_zenoh(_start(), store=path)
    (row,) = rows(path, "SELECT digest, status FROM run")
    assert (row["digest"], row["status"]) == (result.run["digest"], "complete")


@contextmanager
def _struck(path: str, act: Callable[[], None]) -> Iterator[None]:
    """Does something once the store has a quarter of the run's dwells; metrics would say it late on a busy machine."""
    over, seen = threading.Event(), list[int]()

    def strike() -> None:
        while not over.wait(0.01):
            if at := _acknowledged(path):
                seen.append(at)
                act()
                return

    striker = threading.Thread(target=strike)
    striker.start()
    try:
        yield
    finally:
        over.set()
        striker.join()
    assert seen
    assert seen[0] < DISTURBED


def _acknowledged(path: str) -> int:
    """Dwells in a store, 0 below a quarter of the run's."""
    try:
        with closing(Journal(path, read_only=True)) as journal:
            rows = journal.read("SELECT acknowledged_t AS t FROM run WHERE t >= ?", [DISTURBED // 4])
    except Failure:
        return 0
    return rows[0]["t"] if rows else 0


@pytest.fixture(scope="module")
def undisturbed() -> str:
    return str(in_process.play(_start(dwells=DISTURBED)).run["digest"])


@pytest.mark.zenoh
@pytest.mark.parametrize(
    "victim",
    [
        *("planner-0", "recorder", "router"),
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("planner", "emulator", "allocator", "metrics")),
    ],
)
def test_a_process_that_is_killed_is_started_again_and_the_digest_is_the_same(
    victim: str, undisturbed: str, tmp_path: Path, process_names: Callable[[], list[str]]
) -> None:
    """Both planners at once, one of them, and each other role; nothing is missing in the store."""
    sent, store = list[str](), str(tmp_path / "runs.db")
    with _struck(store, lambda: _signal(victim, signal.SIGKILL)):
        result = _over_zenoh(_start(dwells=DISTURBED), 2, notify=sent.append, store=store)
    assert result.run["digest"] == undisturbed
    assert [line for line in sent if f"{victim}" in line and "signal 9" in line and "starting it again" in line]
    counts = rows(store, "SELECT topic, COUNT(DISTINCT k) AS n FROM message GROUP BY topic")
    assert {row["n"] for row in counts} == {result.run["acquisition_scans"] + DISTURBED}
    assert process_names() == []


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.parametrize(
    "victim",
    [
        "planner-0",
        "recorder",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("emulator", "allocator", "metrics", "router")),
    ],
)
def test_a_process_that_freezes_for_six_seconds(victim: str, undisturbed: str, tmp_path: Path) -> None:
    """Beyond its lease: a planner's tracks are taken over, and it may take them back when it thaws."""
    thaw = threading.Timer(6.0, lambda: _signal(victim, signal.SIGCONT))

    def freeze() -> None:
        _signal(victim, signal.SIGSTOP)
        thaw.start()

    store = str(tmp_path / "runs.db")
    try:
        with _struck(store, freeze):
            assert _over_zenoh(_start(dwells=DISTURBED), 2, store=store).run["digest"] == undisturbed
    finally:
        thaw.cancel()


@pytest.mark.zenoh
@pytest.mark.nightly
@pytest.mark.parametrize("victim", ["planner", "recorder"])
def test_a_process_that_is_killed_late_in_a_long_run(victim: str, tmp_path: Path) -> None:
    """Planners go on from the snapshots of their tracks, the recorder from its file; the snapshots go with the run."""
    start, path, stop, kept = _start(dwells=1500), str(tmp_path / "runs.db"), threading.Event(), list[int]()

    def strike() -> None:
        while len(kept) < len(SMOKE.simulated.targets) and not stop.wait(0.05):
            kept[:] = _snapshots_from(path, 4 * SNAPSHOT_DWELLS - 1)
        _signal(victim, signal.SIGKILL)

    striker = threading.Thread(target=strike)
    striker.start()
    try:
        result = _over_zenoh(start, 2, store=path, notify=(sent := list[str]()).append)
    finally:
        stop.set()
        striker.join()
    assert result.run["digest"] == in_process.play(start).run["digest"]
    assert [line for line in sent if victim in line and "signal 9" in line]
    assert len(kept) == len(SMOKE.simulated.targets)
    assert _snapshots_from(path, 0) == []


def _snapshots_from(path: str, k: int) -> list[int]:
    """Dwells of the snapshots in a store, of this dwell and later ones; none if there is no store yet."""
    try:
        found = rows(path, "SELECT k FROM snapshot WHERE k >= ?", [k])
    except Failure:
        return []
    return [row["k"] for row in found]


@pytest.mark.zenoh
def test_a_process_that_keeps_dying_ends_the_run_with_its_name(process_names: Callable[[], list[str]]) -> None:
    with pytest.raises(RunFailed, match=r"allocator-0 ended unexpectedly.*after 5 restarts of it within 60 s"):
        _over_zenoh(_start(dwells=100_000), report=lambda _: _signal("allocator", signal.SIGKILL))
    assert process_names() == []


@pytest.mark.zenoh
def test_an_interrupt_ends_every_process(process_names: Callable[[], list[str]]) -> None:
    stop = threading.Event()
    with pytest.raises(Interrupted):
        _over_zenoh(_start(dwells=100_000), 2, stop=stop, report=lambda _: stop.set())
    assert process_names() == []


def _signal(name: str, number: signal.Signals) -> None:
    """Send a signal to a process, or to all of a role."""
    for pid, command in service_processes().items():
        if f"--name {name} " in command or f"service {name} " in command:
            os.kill(pid, number)


def test_targets_are_asked_for_when_there_are_more_dwells_to_sum() -> None:
    row = {"status": "running", "waiting_for": "", "confirmed": None, "reason": "", "fault": None}
    asked, before = list[str](), None
    for t, k in ((1, 5), (1, 6), (2, 6)):

        def ask(metric: str, _: dict[str, str], t: int = t, k: int = k) -> Rows:
            asked.append(metric)
            return [row | {"t": t, "k": k}] if metric == "runs" else [{"seen": t}]

        before = progress(ask, _start(), before)
        assert before is not None
        assert (before.t, before.k, before.targets) == (t, k, [{"seen": t}])
    assert asked == ["runs", "summary", "runs", "runs", "summary"]


def test_progress_needs_no_scores() -> None:
    """A metrics that was started again sums a long run first. Its run was thought to stand still, and cancelled."""
    row = {"status": "running", "waiting_for": "", "confirmed": None, "reason": "", "fault": None, "t": 7, "k": 9}

    def ask(metric: str, _: dict[str, str]) -> Rows:
        if metric == "runs":
            return [row]
        raise NoAnswer

    now = progress(ask, _start())
    assert now is not None
    assert (now.t, now.k, now.targets) == (7, 9, [])
