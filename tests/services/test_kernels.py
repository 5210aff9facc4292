"""Compiling all kernels: a stop is obeyed, a folder that cannot be written is no end, old kernels go."""

import errno
import gc
import logging
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import lock_descriptor
from numba.core.dispatcher import Dispatcher

from cogradar.services import kernels
from cogradar.services.errors import RunFailed
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.tables import BELIEFS, BIN_RULES
from cogradar.shared.tracking.assignment.shares import unclaimed
from cogradar.shared.wire.session import free_port
from tests.shared.tracking.contested import LOBE, scan_of, shares

COGRADAR = [sys.executable, "-m", "cogradar"]
COMMANDS = {
    "run": ["run", "smoke"],
    "run --in-process": ["run", "smoke", "--in-process", "--json"],
    "campaign": ["campaign", "smoke", "--runs", "1"],
    "bench": ["bench", "kernels"],
    "verify": ["verify", "--json"],
    "service": ["service", "emulator", "--connect", f"tcp/127.0.0.1:{free_port()}"],
}


def _environment(folder: Path | str) -> dict[str, str]:
    return os.environ | {"COGRADAR_CACHE_DIR": str(folder), "PYTHONUNBUFFERED": "1"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "number", "code"),
    [
        ("run", signal.SIGINT, 130),
        ("run --in-process", signal.SIGTERM, 143),
        ("campaign", signal.SIGTERM, 143),
        ("bench", signal.SIGINT, 130),
        ("verify", signal.SIGTERM, 143),
        ("service", signal.SIGTERM, 0),  # a service ends as it is asked to
    ],
)
def test_a_stop_is_obeyed_while_kernels_compile(
    command: str, number: signal.Signals, code: int, tmp_path: Path
) -> None:
    arguments = [*COGRADAR, *COMMANDS[command]]
    arguments += ["--store", str(tmp_path / "c.db")] if command == "campaign" else []
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    running = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=_environment(tmp_path)
    )
    try:
        assert running.stdout is not None
        next(line for line in running.stdout if "compiling kernels" in line)
        time.sleep(2.0)
        running.send_signal(number)
        sent, _ = running.communicate(timeout=30)
    finally:
        running.kill()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    # By the processor's time, as others may use it: some seconds to start, two of compiling, one until it is noticed.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 15.0  # all kernels take a minute
    assert running.returncode == code, sent
    assert "Traceback" not in sent
    if code:
        lines = [line.strip() for line in sent.splitlines()]
        assert lines.count("interrupted while compiling kernels; the next start goes on") == 1
    assert list(tmp_path.glob("cogradar/kernels-*"))
    assert not list(tmp_path.glob("cogradar/kernels-*/complete"))


def test_one_function_that_takes_long_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports came only when the next function began."""

    def slow(_: object) -> None:
        time.sleep(1.0)
        raise RunFailed("enough")

    monkeypatch.setattr(kernels, "EACH_S", 0.1)
    monkeypatch.setattr("cogradar.services.runs.in_process.play", slow)
    said: list[str] = []
    with pytest.raises(RunFailed, match="enough"):
        kernels._compile(said.append, None)
    assert len(said) > 1
    assert said[0] == f"compiling kernels: 0 of some {kernels.FUNCTIONS} functions"
    time.sleep(0.3)
    n = len(said)
    time.sleep(0.3)
    assert len(said) == n


def test_check_waits_for_no_compiler(tmp_path: Path) -> None:
    """It calls few kernels once, and says the same of them as plain Python."""
    command = [*COGRADAR, "check", "paper"]
    said = [
        subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
        for environment in (_environment(tmp_path), dict(os.environ))
    ]
    assert list(tmp_path.rglob("*.nbc")) == []
    assert said[0] == said[1]


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_folder_that_cannot_be_written_costs_time_but_no_run(tmp_path: Path) -> None:
    """Kernels are compiled once for all processes of the command, into a folder that goes with it."""
    command = [*COGRADAR, "run", "smoke", "--dwells", "2", "--json"]
    environment = _environment("/proc/x") | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    (line,) = [line.strip() for line in done.stderr.splitlines() if "cannot be kept" in line]
    assert line.startswith("compiled kernels cannot be kept in /proc/x/cogradar/kernels-")
    assert line.endswith(": No such file or directory")
    assert list(tmp_path.iterdir()) == []


def test_kernels_that_cannot_even_be_shared_are_compiled_and_not_marked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in {"CACHED": False, "NOT_KEPT": "/x: Read-only file system", "CACHE_DIR": tmp_path}.items():
        monkeypatch.setattr(kernels, name, value)
    compiled: list[object] = []
    monkeypatch.setattr(kernels, "_compile", lambda _, stop: compiled.append(stop))
    sent: list[str] = []
    kernels.compile_all(sent.append)
    assert sent == [
        "compiled kernels cannot be kept in /x: Read-only file system",
        "compiling kernels: for this command only, a minute or two",
    ]
    assert compiled == [None]
    assert list(tmp_path.iterdir()) == []
    assert not kernels.are_compiled()


def test_kernels_of_every_filter_and_rule_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or the planners of a first run would compile them, each for itself and in the middle of it."""
    warmed: list[RadarConfig] = []
    monkeypatch.setattr("cogradar.services.runs.in_process.play", lambda _: None)
    monkeypatch.setattr("cogradar.services.planner.decision.warm_up", lambda radar, _: warmed.append(radar))
    kernels._compile(lambda _: None, None)
    assert {radar.belief.filter for radar in warmed} == set(BELIEFS)
    assert {radar.planner.rule for radar in warmed} == set(BIN_RULES)
    assert {radar.is_unknown for radar in warmed} == {True, False}


@pytest.mark.slow
def test_no_track_waits_for_the_compiler() -> None:
    """What tracks that compete for detections need was compiled beforehand: a planner of a live run would stand still
    for as long as it takes, and lose all tracks meanwhile.
    """
    with multiprocessing.get_context("spawn").Pool(1) as alone:  # what other tests called does not count
        assert alone.apply(_compiled_late) == []


def _compiled_late() -> list[str]:
    kernels._compile(lambda _: None, None)
    before = _compiled()
    scan = scan_of([(0.1, 0.1, 50.25), (0.13, 0.13, 50.25)], [(0.1, 50.25), (0.13, 50.25)])
    assert sorted(share.row for share in shares(scan)) == [0, 1]
    assert unclaimed(LOBE, scan).size == 0
    return sorted(_compiled() - before)


def _compiled() -> set[str]:
    """Kernels of this process with the types that they were called with."""
    made = [thing for thing in gc.get_objects() if isinstance(thing, Dispatcher)]
    return {
        f"{kernel.py_func.__qualname__}{types}"
        for kernel in made
        if kernel.py_func.__module__.startswith("cogradar.")
        for types in kernel.overloads
    }


def test_a_full_disk_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "/x/kernel.nbi")

    monkeypatch.setattr(kernels, "CACHE_DIR", tmp_path)
    monkeypatch.setattr(kernels, "_compile", full)
    with pytest.raises(RunFailed, match=r"/x/kernel\.nbi: No space left on device"):
        kernels.compile_all(lambda _: None)
    assert not (tmp_path / "complete").exists()


def _folder(root: Path, name: str, days: float, *, complete: bool = True) -> Path:
    folder = root / f"kernels-{name}"
    folder.mkdir()
    (folder / "kernel.nbc").write_bytes(b"code")
    if complete:
        (folder / "complete").touch()
    then = time.time() - 86400.0 * days
    for path in (*folder.iterdir(), folder):
        os.utime(path, (then, then))
    return folder


def test_kernels_that_nobody_used_for_a_month_are_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    old, torn = _folder(tmp_path, "old", 31), _folder(tmp_path, "torn", 31, complete=False)
    recent, mine = _folder(tmp_path, "recent", 29), _folder(tmp_path, "mine", 400)
    used, other = _folder(tmp_path, "used", 400), tmp_path / "notes-old"
    other.mkdir()
    os.utime(other, (0, 0))
    monkeypatch.setattr(kernels, "CACHE_DIR", mine)
    with (used / "in-use.1").open("wb") as file:  # the process with the first number has ended
        assert lock_descriptor(file.fileno(), blocking=False)  # what another process does that uses them
        kernels.compile_all(lambda _: pytest.fail("nothing to compile"))
    assert [path.exists() for path in (old, torn, recent, mine, used, other)] == [False, False, True, True, True, True]
    assert time.time() - (mine / "complete").stat().st_mtime < 60.0  # used today
    kernels.compile_all(lambda _: None)
    assert not used.exists()  # its process has gone


def test_a_process_marks_the_kernels_that_it_uses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = _folder(tmp_path, "mine", 400)
    monkeypatch.setattr(kernels, "CACHE_DIR", mine)
    assert not kernels._is_in_use(mine)
    kernels.compile_all(lambda _: None)
    first = kernels._locks.pop(mine)
    kernels.compile_all(lambda _: None)  # as another process would
    os.close(first)
    assert kernels._is_in_use(mine)
    os.close(kernels._locks.pop(mine))
    assert not kernels._is_in_use(mine)
    assert {path.name for path in mine.glob("in-use*")} == {"in-use.0", "in-use.1"}


JOINS = """
import sys, time
from cogradar.services import kernels
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import Checkpoint, RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
if sys.argv[1] == "loads":
    kernels.load_planner()
start = RunStart.of(load("paper"), Strategy.POWER_AWARE, 1, 20)
told = {"run": start.run, "strategy": start.strategy, "dwells": 20, "rate_hz": 0.0, "seed": radar_seed(1)}
checkpoint = Checkpoint(**told, radar=start.scenario["radar"], k=5, t=5)
before, began = set(sys.modules), time.process_time()
list(PlannerCore("p").handle(checkpoint))
print(len(set(sys.modules) - before), time.process_time() - began)
"""


def test_a_run_that_is_joined_to_load_is_not_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """Each start of a planner said that it owns tracks, of a run that is nowhere else."""
    caplog.set_level(logging.INFO)
    kernels.load_planner()
    logging.getLogger("cogradar").info("after it")
    assert caplog.messages == ["after it"]


def test_a_planner_has_loaded_what_it_needs_before_it_joins_a_run() -> None:
    """Others leave tracks to it as soon as they see it, and it loaded for half a second of processor then."""
    kernels.compile_all(lambda _: None)

    def join(*how: str) -> tuple[int, float]:
        done = subprocess.run([sys.executable, "-c", JOINS, *how], capture_output=True, text=True, check=True)
        n_module, cpu_s = done.stdout.split()
        return int(n_module), float(cpu_s)

    n_before, before_s = join("not")
    n_module, cpu_s = join("loads")
    assert n_before > n_module == 0
    assert cpu_s < 0.6 * before_s
