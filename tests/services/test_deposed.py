"""Real recorders: one that was stopped, and goes on beside the one that took over from it, ends itself. One that comes
second stands by until the first is gone.
"""

import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest

from cogradar.services import health, kernels
from cogradar.services.errors import Deposed
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import Checkpoint
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.loop import smoke_start

START = smoke_start(dwells=600, run="succeeded")
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

    def end(self) -> None:
        """It must be the run of one process."""
        while not self.next().ended:
            pass
        (run,) = self._journal.read("SELECT status, digest FROM run")
        assert run == {"status": "complete", "digest": in_process.play(START).run["digest"]}


@contextmanager
def _processes(store: Path) -> Iterator[Launcher]:
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(1, str(store)), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        yield launcher


@contextmanager
def _run_that_goes_on(launcher: Launcher, store: Path) -> Iterator[_Readers]:
    """After some dwells."""
    session = open_session([launcher.endpoint], 10.0, lambda: None)
    bus, journal = ZenohBus(session, Role.OPERATOR, "test"), Journal(str(store), read_only=True)
    with closing(bus), closing(journal):
        bus.publish(START)
        readers = _Readers(bus, journal)
        while readers.next().k < 16:
            pass
        yield readers


@contextmanager
def _successor(launcher: Launcher, role: Role, *options: str) -> Iterator[None]:
    """Another process of a role, while its first one is stopped; then that one goes on, and must end itself soon."""
    name = f"{role}-1"
    command = [sys.executable, "-m", "cogradar", "service", role.value, "--name", name, *options]
    with subprocess.Popen([*command, "--connect", launcher.endpoint], stderr=subprocess.DEVNULL) as successor:
        try:
            yield
        finally:
            successor.terminate()


def _ends_itself(launcher: Launcher, name: str, said: str) -> None:
    launcher.signal(name, signal.SIGCONT)
    began = time.monotonic()
    assert launcher._processes[name].wait(WITHIN_S) == Deposed.exit_code
    assert time.monotonic() - began < 5.0
    assert said in launcher._tail(name)


@pytest.mark.zenoh
def test_a_recorder_ends_itself_and_nothing_that_was_acknowledged_is_lost(tmp_path: Path) -> None:
    store = tmp_path / "runs.db"
    with ExitStack() as stack:
        launcher = stack.enter_context(_processes(store))
        readers = stack.enter_context(_run_that_goes_on(launcher, store))
        before = readers.next().epoch
        _stop_between_transactions(launcher, store)
        Path(f"{store}.lock").unlink()  # as after a lock that the file system has taken back
        stack.enter_context(_successor(launcher, Role.RECORDER, "--store", str(store)))
        while (now := readers.next().epoch) == before:
            pass
        assert now > before
        # Whether it first reads the store or hears the other one is chance; both name the two epochs.
        _ends_itself(launcher, "recorder-0", f"with epoch {now}, this recorder has epoch {before}: ")
        assert readers.next().epoch == now
        readers.end()


@pytest.mark.zenoh
def test_a_second_recorder_stands_by_and_takes_over(tmp_path: Path) -> None:
    store = tmp_path / "runs.db"
    with ExitStack() as stack:
        launcher = stack.enter_context(_processes(store))
        beat = tmp_path / "beat"
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv(health.VARIABLE, str(beat))
            stack.enter_context(_successor(launcher, Role.RECORDER, "--store", str(store)))
        until_s = time.monotonic() + WITHIN_S
        while not beat.exists() or not beat.read_text().startswith("stands by"):  # the run might end before that
            assert time.monotonic() < until_s
            launcher.check()
            time.sleep(0.05)
        readers = stack.enter_context(_run_that_goes_on(launcher, store))
        before = readers.next().epoch
        launcher.signal("recorder-0", signal.SIGKILL)
        began = time.monotonic()
        while readers.next().epoch == before:
            pass
        assert time.monotonic() - began < 5.0
        readers.end()
