"""A disk that is really full: runs are held or go on unrecorded, say so, and go on when there is room."""

import json
import os
import re
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cogradar.services.errors import NoRoom
from cogradar.services.metrics.answers import NO_ROOM, answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, EmulatorCheckpoint, Message, Refused, RunCancel
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import play as play_cores
from tests.services.loop import smoke_start

DWELLS = 20
START = smoke_start(dwells=DWELLS)
SIZE_MIB = 8
AWAY_TICKS = 60  # for which there is no room


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small file system of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE_MIB}m", "tmpfs", str(folder)]
    if os.geteuid() or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system needs root")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def _fill(disk: Path) -> Path:
    """Leave no byte on a disk."""
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        try:
            while file.write(bytes(4096)):
                pass
        except OSError as error:
            assert error.strerror == "No space left on device"  # noqa: PT017 - nothing else may end it
    return ballast


def _recorder(journal: Journal, messages: list[Message]) -> Recorder:
    core = Recorder(journal)
    for message in messages:
        core.handle(message)
    return core


def _tick(core: Recorder, n: int) -> list[Checkpoint]:
    answers = [answer for _ in range(n) for answer in core.handle(Tick(0.0))]
    return [one for one in answers if isinstance(one, Checkpoint) and not isinstance(one, EmulatorCheckpoint)]


@pytest.mark.parametrize("when", [0.2, 0.8])
@pytest.mark.parametrize("is_killed", [False, True])
def test_in_lockstep_the_run_is_held_and_ends_as_any_other(disk: Path, when: float, is_killed: bool) -> None:
    """The same digest and scores; also if the recorder is killed and started again while there is no room."""
    whole = FaultyNetwork(START, 2, np.random.default_rng(0))
    steps = 0
    while whole.step():
        steps += 1
    journal = Journal(str(disk / "run.db"))
    network = FaultyNetwork(START, 2, np.random.default_rng(0), journal=journal)
    began = int(when * steps)
    held: list[int] = []

    def fill() -> None:
        ballast = _fill(disk)
        for i in range(AWAY_TICKS):
            while network.step():
                pass
            network.tick()
            if is_killed and i == AWAY_TICKS // 2:
                network.kill("recorder-0")
                network.start("recorder-0")
        sent = network.processes["recorder-0"].sent
        held.extend(message.k for message in sent if isinstance(message, Checkpoint) and message.held)
        (row,) = journal.read("SELECT status FROM run")
        assert row["status"] == "running"
        ballast.unlink()

    assert play(network, {began: fill}) == in_process.play(START).run["digest"]
    assert held
    assert network.scores() == whole.scores()
    assert network.refused == []
    journal.close()


def test_it_says_so_and_takes_no_new_run(disk: Path, caplog: pytest.LogCaptureFixture) -> None:
    sent = play_cores(START)
    journal = Journal(str(disk / "run.db"))
    core = _recorder(journal, sent[: len(sent) // 2])
    _tick(core, 4)
    ballast = _fill(disk)
    for message in sent[len(sent) // 2 :]:
        core.handle(message)
    told = _tick(core, 40)
    assert core.trouble
    assert core.measures()["journal_full"] == 1
    assert len({checkpoint.k for checkpoint in told if checkpoint.held}) == 1
    assert caplog.text.count("are held until it can be written") == 1
    with pytest.raises(Refused, match="disk is full"):
        core.handle(smoke_start(run="another"))
    metrics = MetricsCore(str(disk / "run.db"))
    metrics.handle(told[-1])
    (row,) = answer(metrics.store, "runs", {})
    assert (row["status"], row["waiting_for"]) == ("running", NO_ROOM)
    ballast.unlink()
    told = _tick(core, 8)
    assert core.measures()["journal_full"] == 0
    assert not told[-1].held
    metrics.handle(told[-1])
    (row,) = answer(metrics.store, "runs", {})
    assert row["waiting_for"] != NO_ROOM
    metrics.close()
    core.close()


def test_a_run_that_is_cancelled_meanwhile_is_over_when_there_is_room(disk: Path) -> None:
    sent = play_cores(START)
    journal = Journal(str(disk / "run.db"))
    core = _recorder(journal, sent[: len(sent) // 2])
    ballast = _fill(disk)
    core.handle(RunCancel(run=START.run, reason="as it failed"))
    core.handle(RunCancel(run=START.run))
    _tick(core, 8)
    assert core.trouble
    ballast.unlink()
    assert _tick(core, 8)[-1].ended
    assert journal.read("SELECT status, reason FROM run") == [{"status": "stopped", "reason": "as it failed"}]
    core.close()


def test_a_journal_is_not_begun_without_room_and_an_older_one_is_held(disk: Path) -> None:
    path = disk / "run.db"
    journal = Journal(str(path))
    _recorder(journal, [START])
    metrics = MetricsCore(str(path))  # as long as it reads, the log stays where it is
    journal.close()
    ballast = _fill(disk)
    with pytest.raises(NoRoom, match="full"):
        Journal(str(disk / "new.db"))
    journal = Journal(str(path))  # its log goes into the file, which makes some room
    _fill(disk)
    core = Recorder(journal, resume=False)
    assert core.trouble
    ballast.unlink()
    _tick(core, 8)
    assert [row["reason"] for row in metrics.store.read("SELECT reason FROM run")] == ["interrupted"]
    core.close()
    metrics.close()


@pytest.mark.nightly
@pytest.mark.parametrize(("pace", "dwells"), [((), 400), (("--pace", "realtime", "--rate", "5"), 100)])
def test_a_whole_system_goes_on_when_there_is_room(disk: Path, pace: tuple[str, ...], dwells: int) -> None:
    """As a user runs it. In real time no dwell is missing: what was not recorded meanwhile is sent again."""
    path = disk / "run.db"
    command = [sys.executable, "-m", "cogradar", "run", "smoke", "--dwells", str(dwells), "--json", *pace]
    running = subprocess.Popen([*command, "--store", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        _until(lambda: _recorded(path) >= 40, 90.0)
        ballast = _fill(disk)
        time.sleep(8.0)
        before = _recorded(path)
        time.sleep(4.0)
        assert _recorded(path) == before < dwells
        ballast.unlink()
        output, errors = running.communicate(timeout=180)
    finally:
        running.kill()
    assert running.returncode == 0, errors
    found = json.loads(output)
    with closing(sqlite3.connect(path)) as db:
        ((status, k),) = db.execute("SELECT status, acknowledged_k FROM run").fetchall()
        scans = [row[0] for row in db.execute("SELECT k FROM message WHERE topic = 'scan' ORDER BY k")]
    assert status == "complete"
    assert scans == list(range(k))
    if pace:
        assert found["elapsed_s"] < 1.3 * k / 5.0 + 10.0
    else:
        undisturbed = subprocess.run([*command, "--in-process"], capture_output=True, check=True)
        assert json.loads(undisturbed.stdout)["digest"] == found["digest"]
    assert not re.search(rb"Traceback", errors)


def _until(condition: object, within_s: float) -> None:
    deadline = time.monotonic() + within_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _recorded(path: Path) -> int:
    """Acknowledged dwells."""
    if not path.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
            return int(db.execute("SELECT COALESCE(SUM(acknowledged_k), 0) FROM run").fetchone()[0])
    except sqlite3.OperationalError:
        return 0
