"""Certificates are replaced and revoked while a run goes on: it ends as the run of one process."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from cogradar.services import kernels
from cogradar.services.certs import authority, names
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import Checkpoint
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.queries import alive
from cogradar.shared.wire.session import CONFIG_VARIABLE, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.loop import smoke_start

START = smoke_start(dwells=1500, run="rotated")
LOCAL, OTHER = "planner.0", "planner.9"
WITHIN_S = 120.0


class _Watched:
    """A system that is looked at by an operator; what has ended is started again."""

    def __init__(self, launcher: Launcher) -> None:
        self._check = launcher.check
        self._session = open_session([launcher.endpoint], WITHIN_S, launcher.check)
        self.bus = ZenohBus(self._session, Role.OPERATOR, "test")
        self.newest: Checkpoint | None = None

    def close(self) -> None:
        self.bus.close()

    def until(self, condition: Callable[[], object]) -> None:
        end_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < end_s
            self._check()
            event = self.bus.receive(0.05)
            self.newest = event if isinstance(event, Checkpoint) else self.newest

    def until_planners(self, *names: str) -> None:
        self.until(lambda: alive(self._session, build()).names.get(Role.PLANNER, []) == list(names))

    def until_dwells(self, more: int) -> Checkpoint:
        before = self.newest.k if self.newest is not None else 0
        self.until(lambda: self.newest is not None and (self.newest.k >= before + more or self.newest.ended))
        assert self.newest is not None
        return self.newest


@contextmanager
def _planner(launcher: Launcher, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """One more, with a certificate of its own."""
    command = [sys.executable, "-m", "cogradar", "service", "planner", "--name", OTHER]
    environment = os.environ | {CONFIG_VARIABLE: str(folder / OTHER / names.SETTINGS)}
    command += ["--connect", launcher.endpoint]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.terminate()


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.zenoh
def test_a_run_goes_on_while_certificates_are_replaced_and_revoked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One planner's is issued again, and it is started again; another's is taken off the list of the router."""
    kernels.compile_all(lambda _: None)
    folder, store = tmp_path / "certs", str(tmp_path / "runs.db")
    authority.create(folder, 2)
    authority.issue(folder, [*(f"{role}.0" for role in Role), OTHER], ["127.0.0.1"], 1)
    monkeypatch.setenv(CONFIG_VARIABLE, str(folder / "operator.0" / names.SETTINGS))
    launcher = Launcher(LocalProcesses(1, store), threading.Event()).with_certificates(folder)
    with launcher, closing(_Watched(launcher)) as watched, _planner(launcher, folder) as other:
        watched.until_planners(LOCAL, OTHER)
        watched.until(lambda: len(watched.bus.alive().names) == len(Role) - 1)  # all but the router
        watched.bus.publish(START)
        watched.until_dwells(16)

        shutil.rmtree(folder / LOCAL)
        authority.issue(folder, [LOCAL], [], 1)
        launcher.signal(LOCAL, signal.SIGTERM)
        watched.until_planners(OTHER)
        watched.until_planners(LOCAL, OTHER)
        assert not watched.until_dwells(16).ended

        listed = [name for name in names.allowed(str(folder / names.ALLOWED)) if name != OTHER]
        (folder / names.ALLOWED).write_text("\n".join(listed))
        launcher.signal("router.0", signal.SIGTERM)
        watched.until_planners(LOCAL)
        assert watched.until_dwells(10**9).ended
        watched.until_planners(LOCAL)
        assert other.poll() is None  # it is there, and nobody hears it
        with closing(Journal(store, read_only=True)) as journal:
            (run,) = journal.read("SELECT status, digest FROM run")
    assert run == {"status": "complete", "digest": in_process.play(START).run["digest"]}
