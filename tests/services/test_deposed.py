"""Real processes: a recorder that was stopped, and goes on beside the one that took over from it."""

import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from cogradar.services.errors import Deposed
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import Checkpoint
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.loop import smoke_start

START = smoke_start(dwells=400, run="succeeded")
WITHIN_S = 60.0


def _stop_between_transactions(launcher: Launcher, store: Path) -> None:
    """One that has a transaction open also has the file: nobody could take over."""
    with closing(sqlite3.connect(store, timeout=0.0, isolation_level=None)) as db:
        while True:
            launcher.signal("recorder-0", signal.SIGSTOP)
            time.sleep(0.01)
            with suppress(sqlite3.OperationalError):
                db.execute("BEGIN IMMEDIATE")
                db.execute("ROLLBACK")
                return
            launcher.signal("recorder-0", signal.SIGCONT)
            time.sleep(0.003)


class _Readers:
    """What readers are told of the run; each time the journal has it."""

    def __init__(self, bus: ZenohBus, journal: Journal) -> None:
        self._bus, self._journal, self._until_s = bus, journal, time.monotonic() + WITHIN_S

    def next(self) -> Checkpoint:
        while time.monotonic() < self._until_s:
            event = self._bus.receive(0.1)
            if isinstance(event, Checkpoint):
                (row,) = self._journal.read("SELECT acknowledged_k AS k FROM run")
                assert row["k"] >= event.k
                return event
        raise AssertionError("no checkpoint")


@pytest.mark.zenoh
def test_it_ends_itself_and_nothing_that_was_acknowledged_is_lost(tmp_path: Path) -> None:
    store = tmp_path / "runs.db"
    launcher = Launcher(LocalProcesses(1, str(store)), threading.Event())
    second = [sys.executable, "-m", "cogradar", "service", "recorder", "--name", "recorder-1"]
    with launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        session = open_session([launcher.endpoint], 10.0, lambda: None)
        with (
            closing(ZenohBus(session, Role.OPERATOR, "test")) as bus,
            closing(Journal(str(store), read_only=True)) as journal,
        ):
            bus.publish(START)
            readers = _Readers(bus, journal)
            while (before := readers.next()).k < 16:
                pass
            _stop_between_transactions(launcher, store)
            Path(f"{store}.lock").unlink()  # as after a lock that the file system has taken back
            command = [*second, "--connect", launcher.endpoint, "--store", str(store)]
            with subprocess.Popen(command, stderr=subprocess.DEVNULL) as successor:
                try:
                    while (now := readers.next()).epoch == before.epoch:
                        pass
                    assert now.epoch > before.epoch
                    launcher.signal("recorder-0", signal.SIGCONT)
                    began = time.monotonic()
                    assert launcher._processes["recorder-0"].wait(WITHIN_S) == Deposed.exit_code
                    assert time.monotonic() - began < 5.0
                    assert f"recorder-1 has {store} with epoch {now.epoch}, this" in launcher._tail("recorder-0")
                    while not now.ended:
                        now = readers.next()
                        assert now.epoch > before.epoch
                finally:
                    successor.terminate()
            (run,) = journal.read("SELECT status, digest FROM run")
    assert run == {"status": "complete", "digest": in_process.play(START).run["digest"]}
