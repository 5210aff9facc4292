"""Campaigns: the same results whoever plays them, in whatever order, and however often they are interrupted."""

import json
import multiprocessing
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

from services import campaign as campaigns
from services import in_process
from services.campaign import BadCampaign, Campaign, Tally, open_store, parse_strategies, results_digest
from services.recordings import snapshots
from services.runs import Interrupted, RunFailed
from services.store import Store, StoreError
from shared.messages import Waveform
from shared.scenario import Strategy
from shared.wire.codec import decode
from tests.services.loop import SMOKE

STRATEGIES = (Strategy.UNIFORM, Strategy.POWER_AWARE)
SMALL = Campaign(SMOKE, STRATEGIES, runs=3, first_seed=5, dwells=4)
CAMPAIGN = [sys.executable, "-m", "services.cli", "campaign", "smoke", "--seed", "5", "--workers", "2"]
CAMPAIGN += ["--strategies", "uniform,power-aware"]


@pytest.fixture(scope="module")
def reference() -> str:
    """Digest of SMALL's results, played in this process one run after the other, last run first."""
    store = Store(":memory:")
    for place, start in reversed(list(enumerate(SMALL.starts(), 1))):
        played = Store(":memory:")
        in_process.play(start, store=played)
        (row,) = played.read("SELECT acquisition_scans FROM run")
        keep = [("waveform", row["acquisition_scans"] - 2 + t) for t in snapshots(4)]
        store.add_recording(played.recording(start.run, keep), place)
    return results_digest(store)


def _play(store: Store, workers: int = 2, campaign: Campaign = SMALL, **other: Any) -> Tally:
    return campaigns.play(campaign, store, workers, **({"stop": threading.Event()} | other))


def test_runs_are_named_by_what_they_are_and_seeds_are_shared() -> None:
    names = [start.run for start in SMALL.starts()]
    assert names == [f"smoke-{strategy}-{seed}" for seed in (5, 6, 7) for strategy in ("uniform", "power-aware")]
    assert {(start.seed, start.dwells) for start in SMALL.starts()} == {(5, 4), (6, 4), (7, 4)}


def test_snapshots_are_the_papers() -> None:
    assert snapshots(300) == (75, 200, 300)
    assert snapshots(1) == (1,)
    assert snapshots(4) == (1, 2, 4)


@pytest.mark.parametrize("text", ["", "best", "uniform,", "uniform,uniform", "uniform, power-aware"])
def test_bad_strategies_are_refused(text: str) -> None:
    with pytest.raises(BadCampaign, match="orthogonal,uniform,power-aware"):
        parse_strategies(text)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 3])
def test_results_do_not_depend_on_the_number_of_workers(workers: int, reference: str) -> None:
    store, seen = Store(":memory:"), []
    tally = _play(store, workers, report=lambda now: seen.append(now.done))
    assert results_digest(store) == reference
    assert seen == [0, 1, 2, 3, 4, 5, 6]
    assert (tally.played, {name: len(cpu) for name, cpu in tally.cpu_s.items()}) == (
        6,
        {"uniform": 3, "power-aware": 3},
    )
    # In the order of the campaign, not of arrival.
    assert [row["run"] for row in store.read("SELECT run FROM run ORDER BY rowid")] == [s.run for s in SMALL.starts()]


@pytest.mark.slow
def test_the_waveforms_kept_are_those_of_the_snapshots() -> None:
    """The beams radiated at dwell t are the bins that its scores say were asked for."""
    store = Store(":memory:")
    _play(store, 1, Campaign(SMOKE, (Strategy.POWER_AWARE,), runs=1, first_seed=5, dwells=12))
    rows = store.read("SELECT k, payload, acquisition_scans FROM message JOIN run USING (run) ORDER BY k")
    assert [row["k"] - row["acquisition_scans"] + 2 for row in rows] == [3, 8, 12]
    for row, t in zip(rows, (3, 8, 12), strict=True):
        waveform = decode(row["payload"])
        assert isinstance(waveform, Waveform)
        scores = store.read("SELECT bin, share FROM score WHERE t = ? ORDER BY track", [t])
        assert waveform.beams.tolist() == [score["bin"] for score in scores]
        assert waveform.shares.tolist() == [score["share"] for score in scores]


@pytest.mark.slow
def test_an_interrupted_campaign_goes_on_to_the_same_result(reference: str) -> None:
    store, stop = Store(":memory:"), threading.Event()

    def report(now: Tally) -> None:
        if now.played == 2:
            stop.set()

    with pytest.raises(Interrupted, match="--resume"):
        _play(store, report=report, stop=stop)
    assert multiprocessing.active_children() == []
    (partial,) = store.read("SELECT COUNT(*) AS n FROM run")
    assert 2 <= partial["n"] < 6
    assert _play(store).played == 6 - partial["n"]
    assert results_digest(store) == reference


@pytest.mark.slow
def test_a_killed_worker_costs_nothing_but_time(reference: str) -> None:
    store = Store(":memory:")
    said: list[str] = []

    def report(now: Tally) -> None:
        if now.played == 1 and not said:
            os.kill(next(child.pid for child in multiprocessing.active_children() if child.pid), signal.SIGKILL)

    _play(store, report=report, say=said.append)
    assert said == ["a worker process died; what it was playing is played again"]
    assert results_digest(store) == reference


def test_workers_that_keep_dying_end_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> Iterator[Any]:
        raise BrokenProcessPool

    monkeypatch.setattr(campaigns, "_play_on_pool", broken)
    with pytest.raises(RunFailed, match="died 4 times"):
        _play(Store(":memory:"))


@pytest.mark.slow
def test_a_full_disk_leaves_whole_runs_and_a_campaign_that_goes_on(tmp_path: Path, reference: str) -> None:
    """SQLite is told that the disk is full at a number of pages that holds some of the runs but not all."""
    path = str(tmp_path / "c.db")
    store = open_store(path, SMALL, resume=False)
    (page,) = store.read("PRAGMA page_count")
    store.read(f"PRAGMA max_page_count = {page['page_count'] + 2}")
    with pytest.raises(StoreError, match=r"c\.db: database or disk is full"):
        _play(store)
    store.close()
    again = open_store(path, SMALL, resume=True)
    counts = again.read("SELECT run, COUNT(t) AS n FROM run LEFT JOIN score USING (run) GROUP BY run")
    assert len(counts) < 6
    assert {row["n"] for row in counts} <= {2 * 4}
    _play(again)
    assert results_digest(again) == reference


def test_a_run_that_fails_is_a_result() -> None:
    """It would fail again: recorded with its reason, not played a second time."""
    deaf = SMOKE.model_copy(
        update={
            "echo": SMOKE.echo.model_copy(update={"amplitude_db": -100.0}),
            "acquisition": SMOKE.acquisition.model_copy(update={"max_scans": 3}),
        }
    )
    store = Store(":memory:")
    (start,) = Campaign(deaf, (Strategy.UNIFORM,), runs=1, first_seed=1, dwells=4).starts()
    recording, _ = campaigns._play_one(start)
    store.add_recording(recording, 1)
    (run,) = store.read("SELECT status, reason FROM run")
    assert run["status"] == "failed"
    assert "within 3 scans" in run["reason"]
    assert campaigns._missing([start], store) == []


def test_the_digest_sees_every_score(reference: str) -> None:
    store = Store(":memory:")
    for place, start in enumerate(SMALL.starts(), 1):
        store.add_recording(campaigns._play_one(start)[0], place)
    assert results_digest(store) == reference
    nudged = "UPDATE score SET x_hat = x_hat * (1 + 3e-16) WHERE run = 'smoke-uniform-6' AND t = 2 AND target = 1"
    store._write(nudged, ())
    assert results_digest(store) != reference


def test_a_store_with_something_else_is_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "c.db")
    open_store(path, SMALL, resume=False).close()
    with pytest.raises(BadCampaign, match="0 of the 6 runs of this campaign; add --resume"):
        open_store(path, SMALL, resume=False)
    open_store(path, SMALL, resume=True).close()
    others = {
        "runs = 3 there, 4 asked for": Campaign(SMOKE, STRATEGIES, runs=4, first_seed=5, dwells=4),
        "first_seed = 5 there, 1": Campaign(SMOKE, STRATEGIES, runs=3, first_seed=1, dwells=4),
        "strategies = uniform,power-aware there": Campaign(SMOKE, STRATEGIES[:1], runs=3, first_seed=5, dwells=4),
        "dwells = 4 there, 5": Campaign(SMOKE, STRATEGIES, runs=3, first_seed=5, dwells=5),
        "its scenario, smoke": Campaign(SMOKE.model_copy(update={"title": "x"}), STRATEGIES, 3, 5, 4),
    }
    for words, other in others.items():
        for resume in (False, True):
            with pytest.raises(BadCampaign, match=words):
                open_store(path, other, resume=resume)


def test_a_store_played_by_another_program_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = str(tmp_path / "c.db")
    open_store(path, SMALL, resume=False).close()
    monkeypatch.setattr(campaigns, "program", lambda: "another")
    with pytest.raises(BadCampaign, match="another version of the program"):
        open_store(path, SMALL, resume=True)


def test_a_store_of_single_runs_is_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "c.db")
    store = Store(path)
    store.add_recording(campaigns._play_one(SMALL.starts()[0])[0], 1)
    store.close()
    with pytest.raises(BadCampaign, match="belong to no campaign"):
        open_store(path, SMALL, resume=True)


def _runs_in(path: Path) -> int:
    try:
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as db:
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
    """A limit of 24 KiB on any file that the process writes stands for the disk."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (24 << 10, 24 << 10))

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
    cogradar = [sys.executable, "-m", "services.cli"]
    found = subprocess.run([*cogradar, "report", store, "--json"], capture_output=True, text=True, check=True)
    assert f"digest {json.loads(found.stdout)['digest']}" == _digest_line(done.stdout)
    other = subprocess.run([*CAMPAIGN, "--runs", "3", "--store", store], capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "runs = 2 there, 3 asked for" in other.stderr
    shown = subprocess.run([*cogradar, "report", store], capture_output=True, text=True, check=True)
    assert all(words in shown.stdout for words in ("Detection", "Lost tracks", "uniform", "power-aware"))
    for nothing in ([*cogradar, "report", str(tmp_path / "no.db")], [*cogradar, "report", store, "--into", "no.md"]):
        refused = subprocess.run(nothing, capture_output=True, text=True, check=False)
        assert refused.returncode == 2
        assert len(refused.stderr.strip().splitlines()) == 1


def _digest_line(output: str) -> str:
    return next(line for line in output.splitlines() if line.startswith("digest"))


def _until(is_so: Callable[[], bool], within_s: float) -> None:
    deadline = time.monotonic() + within_s
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.05)
