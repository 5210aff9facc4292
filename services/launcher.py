"""Starts every process of the system on this machine, watches them, and ends them all, whatever happens."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from services.runs import Interrupted, RunFailed
from services.topology import TOPOLOGY
from shared.topics import Role
from shared.wire.zenoh_bus import free_port

GRACE_S = 4.0  # between SIGTERM and SIGKILL


class Launcher:
    """The local processes, as a context: entered, all of them are alive; left, all of them are gone.

    Each child holds the read end of a pipe from this process and stops when it closes, so that they end even if
    this process is killed. They are in sessions of their own: Ctrl-C reaches this process, which ends them in order.
    """

    def __init__(self, planners: int, store: str, stop: threading.Event) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._planners = planners
        self._store = store
        self._stop = stop
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._logs = tempfile.TemporaryDirectory(prefix="cogradar-")

    def __enter__(self) -> Self:
        try:
            for service in TOPOLOGY:
                for i in range(self._planners if service.scalable else 1):
                    self._start(service.role, f"{service.role}-{i}")
        except BaseException:
            self._end_all()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_all()

    @property
    def names(self) -> list[str]:
        """Names of the processes that show themselves alive: all but the router."""
        return [name for name in self._processes if not name.startswith(Role.ROUTER)]

    def check(self) -> None:
        """Raise if the user wants to stop or if a process has ended."""
        if self._stop.is_set():
            raise Interrupted("interrupted")
        for name, process in self._processes.items():
            if process.poll() is not None:
                code = process.returncode
                how = f"exit code {code}" if code >= 0 else f"signal {-code}"
                raise RunFailed(f"{name} ended unexpectedly ({how})\n{self._tail(name)}".rstrip())

    def _start(self, role: Role, name: str) -> None:
        command = [sys.executable, "-m", "services.cli", "service", role.value, "--name", name, "--with-parent"]
        command += ["--listen" if role is Role.ROUTER else "--connect", self.endpoint]
        if role is Role.METRICS:
            command += ["--store", self._store]
        with Path(self._logs.name, name).open("wb") as log:
            self._processes[name] = subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
                command,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"PYTHONUNBUFFERED": "1"},
            )

    def _end_all(self) -> None:
        for process in self._processes.values():
            process.terminate()
        deadline = time.monotonic() + GRACE_S
        for process in self._processes.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()
        self._logs.cleanup()

    def _tail(self, name: str) -> str:
        lines = Path(self._logs.name, name).read_text(errors="replace").splitlines()
        return "\n".join(f"  {name}: {line}" for line in lines[-15:])
