"""`cogradar campaign` as a user runs it: ended from outside, on a full disk, and what `cogradar report` then says."""

import json
import re
import resource
import shlex
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from tests.services.cli.here import here

CAMPAIGN = [sys.executable, "-m", "cogradar", "campaign", "smoke", "--seed", "5", "--workers", "2"]
CAMPAIGN += ["--strategies", "uniform,power-aware"]


def _runs_in(path: Path) -> int:
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
            return int(db.execute("SELECT COUNT(*) FROM run").fetchone()[0])
    except sqlite3.Error:
        return 0  # not there yet


def _workers_of(pid: int) -> list[int]:
    """Live processes that descend from a process, itself excluded."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z":
                parents[int(entry.name)] = int(fields[1])
    return [child for child, parent in parents.items() if parent == pid]


def _alive(pids: list[int]) -> list[int]:
    def is_alive(pid: int) -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        except OSError:
            return False

    return [pid for pid in pids if is_alive(pid)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_a_campaign_ended_from_outside_leaves_no_process_and_goes_on(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    path, whole = tmp_path / "c.db", tmp_path / "whole.db"
    command = [*CAMPAIGN, "--runs", "8", "--dwells", "40", "--store", str(path)]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        _until(lambda: _runs_in(path) >= 2, 60)
        workers = _workers_of(running.pid)
        assert len(workers) >= 2
        running.send_signal(number)
        _, errors = running.communicate(timeout=10)
    finally:
        running.kill()
    assert running.returncode == code
    assert "Traceback" not in errors
    _until(lambda: _alive(workers) == [], 5)
    assert 2 <= _runs_in(path) < 16
    if number is signal.SIGKILL:  # once is enough
        resumed = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
        assert resumed.returncode == 0, resumed.stderr
        played = subprocess.run([*command[:-1], str(whole)], capture_output=True, text=True, check=False)
        assert _digest_line(played.stdout) == _digest_line(resumed.stdout)


def test_a_disk_that_is_really_full_is_one_line_and_exit_code_1(tmp_path: Path) -> None:
    """A limit on any file that the process writes stands for the disk: an empty store fits, a run does not."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (64 << 10, 64 << 10))

    command = [*CAMPAIGN, "--runs", "1", "--store", str(tmp_path / "c.db")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=limit)
    assert done.returncode == 1, done.stderr
    assert "c.db" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_report_of_a_campaign_on_the_command_line(tmp_path: Path) -> None:
    store = str(tmp_path / "c.db")
    done = subprocess.run([*CAMPAIGN, "--runs", "2", "--store", store], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = here("report", store, "--json")
    assert f"digest {json.loads(found.stdout)['digest']}" == _digest_line(done.stdout)
    other = here(*CAMPAIGN[3:], "--runs", "3", "--store", store)
    assert other.returncode == 2
    assert "runs = 2 there, 3 asked for" in other.stderr
    shown = here("report", store)
    assert all(words in shown.stdout for words in ("Detection", "Lost tracks", "uniform", "power-aware"))
    twice = here("report", store, store, "--json")
    assert json.loads(twice.stdout) == [json.loads(found.stdout)] * 2
    for nothing in ([str(tmp_path / "no.db")], [store, "--into", "no.md"]):
        refused = here("report", *nothing)
        assert refused.returncode == 2
        assert len(refused.stderr.strip().splitlines()) == 1


def _digest_line(output: str) -> str:
    return next(line for line in output.splitlines() if line.startswith("digest"))


def _until(is_so: Callable[[], bool], within_s: float) -> None:
    deadline = time.monotonic() + within_s
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.slow
def test_a_sweep_prints_its_table_and_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cogradar", "sweep", "smoke", "--over", "radar.array.n_tx=8,16", "--runs", "1"]
    command += ["--strategies", "uniform", "--dwells", "3", "--store", str(tmp_path / "s.db"), "--out", str(tmp_path)]
    played = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    assert played.returncode == 0, played.stderr
    rows = json.loads(played.stdout)
    assert [(row["radar.array.n_tx"], row["scenario"], row["runs"]) for row in rows] == [
        (8, "smoke-1", 1),
        (16, "smoke-2", 1),
    ]
    (page := tmp_path / "page.md").write_text("<!-- sweep s -->\n<!-- /sweep s -->\n")
    again = here(*command[3:], "--csv", "--resume", "--into", str(page))
    (first,) = re.findall("`cogradar (run .*)`, digest `(.*)`", page.read_text())
    assert f"digest {first[1]}" in here(*shlex.split(first[0])).stdout
    assert again.stdout.splitlines()[0].startswith("radar.array.n_tx,scenario,strategy,runs")
    assert "2 of 2 runs, 0 of them now" in again.stderr
    assert {path.name for path in tmp_path.iterdir()} >= {"sweep.png", "sweep.pdf"}
    refused = here(*command[3:], "--dask", "x", "--workers", "2")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
