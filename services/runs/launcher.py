"""Starts every process of the system on this machine, keeps them alive, and ends them all, whatever happens."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from cogradar.services.certs.names import ALLOWED, SETTINGS
from cogradar.services.errors import BadInput, RunFailed, check_stop
from cogradar.services.recorder.store.address import without_password
from cogradar.services.topology import TOPOLOGY, Start
from cogradar.services.web.address import inherited, listen, url
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.plugins.sources import VARIABLE, allowance
from cogradar.shared.wire.session import CONFIG_VARIABLE, free_port

SCRATCH = "cogradar-run-"  # and the id of the process, begin the names of our temporary folders
MAX_LOG_BYTES = 1 << 20  # of what a process writes; only the last lines are ever shown
GRACE_S = 4.0  # between SIGTERM and SIGKILL
_NAMES = {one.value: one.name for one in signal.Signals}
MAX_RESTARTS, RESTART_WINDOW_S = 5, 60.0  # of one process; more is no accident


class Faults(Protocol):
    """Says which process to kill, and when."""

    def victim(self, names: Sequence[str], now_s: float) -> str | None:
        """Name of the process to kill now, None for none."""


@dataclass(frozen=True)
class LocalProcesses:
    """The processes of a system on this machine, and what they are given."""

    planners: int
    store: str | None = None  # journal; None: a file that goes with them
    faults: Faults | None = None
    front_end: str = Start.front_end
    http: str = ""  # where metrics serves (`listen` of web.address)
    pool: int = 1  # emulators, and allocators


def scratch() -> tempfile.TemporaryDirectory[str]:
    """A temporary folder that says whose it is. Folders of our killed processes are removed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*"):
        owner = folder.name.removeprefix(SCRATCH).partition("-")[0]
        with suppress(OSError):
            if owner.isdecimal() and _is_ours(folder) and not _is_alive(int(owner)):
                shutil.rmtree(folder)
    return tempfile.TemporaryDirectory(prefix=f"{SCRATCH}{os.getpid()}-")


def _is_ours(folder: Path) -> bool:
    return sys.platform != "win32" and folder.stat().st_uid == os.getuid()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


class Launcher:
    """The local processes, as a context: entered, all of them are started; left, all of them are gone.

    Each child holds the read end of a pipe from this process and stops when it closes, so that they end even if
    this process is killed. They are in sessions of their own: Ctrl-C reaches this process, which ends them in order.
    """

    def __init__(
        self,
        processes: LocalProcesses,
        stop: threading.Event,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        """The socket of HTTP is ours: it outlives a restart of metrics."""
        if os.name == "nt":
            raise BadInput("processes of their own need Linux or macOS: on Windows use WSL, or --in-process")
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._given, self._stop, self._notify = processes, stop, notify
        self._http = listen(processes.http)
        self.under_fire = False  # whether faults strike
        self._killed: set[str] = set()  # by us: no accident
        self._roles: dict[str, Role] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._restarts: defaultdict[str, deque[float]] = defaultdict(deque)  # when, by name
        self._folder = scratch()
        self._certificates: Path | None = None

    def with_certificates(self, folder: Path) -> Self:
        """Connect the processes by TLS, each with its certificate of a folder: ROLE.0, ... Before it is entered."""
        self._certificates = folder
        self.endpoint = self.endpoint.replace("tcp/", "tls/")
        return self

    def __enter__(self) -> Self:
        try:
            for service in TOPOLOGY:
                for i in range(service.number(self._given.planners, self._given.pool)):
                    self._add(service.role, i)
        except BaseException:
            self._end_all()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_all()

    @property
    def url(self) -> str | None:
        """Where metrics serves HTTP, None if it does not."""
        return None if self._http is None else url(self._http)

    @property
    def processes(self) -> dict[str, int]:
        """Process ids by name, as they are now."""
        return {name: process.pid for name, process in self._processes.items()}

    @property
    def names(self) -> list[str]:
        """Names of the processes that show themselves alive: all but the router."""
        return [name for name, role in self._roles.items() if role is not Role.ROUTER]

    def add_planner(self) -> None:
        """Start one more."""
        self._add(Role.PLANNER, sum(role is Role.PLANNER for role in self._roles.values()))

    def _add(self, role: Role, number: int) -> None:
        name = f"{role}-{number}" if self._certificates is None else f"{role}.{number}"  # as on its certificate
        self._roles[name] = role
        self._start(name)

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a process."""
        self._processes[name].send_signal(number)

    def check(self) -> None:
        """Start again what has ended. Raises Interrupted if the user wants to stop, RunFailed if one ends too often."""
        check_stop(self._stop)
        for name, process in self._processes.items():
            if process.poll() is not None:
                self._restart(name, process.returncode)
            if (log := Path(self._folder.name, name)).stat().st_size > MAX_LOG_BYTES:
                os.truncate(log, 0)  # the process appends: it goes on at the new end
        if self._given.faults is None or not self.under_fire:
            return
        if (victim := self._given.faults.victim(list(self._processes), time.monotonic())) is not None:
            self._killed.add(victim)
            self._processes[victim].kill()

    def _restart(self, name: str, code: int) -> None:
        how = f"exit code {code}" if code >= 0 else f"signal {-code}, {_NAMES.get(-code, 'of its own')}"
        if code == BadInput.exit_code:  # it would be refused again: a store that somebody else took meanwhile
            raise BadInput(self._lines(name)[-1] if self._lines(name) else f"{name}: refused")
        if name in self._killed:
            self._killed.remove(name)
        else:
            self._count_restart(name, how)
        self._notify(f"{name} ended unexpectedly ({how}); starting it again")
        self._close_pipe(self._processes[name])
        self._start(name, again=True)

    def _count_restart(self, name: str, how: str) -> None:
        """Raise RunFailed if a process ended too often lately."""
        now, before = time.monotonic(), self._restarts[name]
        while before and now - before[0] > RESTART_WINDOW_S:
            before.popleft()
        if len(before) == MAX_RESTARTS:
            raise RunFailed(
                f"{name} ended unexpectedly ({how}), after {MAX_RESTARTS} restarts of it within"
                f" {RESTART_WINDOW_S:.0f} s, which is the most.\nIts last lines:\n{self._tail(name) or '  (none)'}"
            )
        before.append(now)

    def _start(self, name: str, *, again: bool = False) -> None:
        role = self._roles[name]
        command = [sys.executable, "-m", "cogradar", "service", role.value, "--name", name, "--with-parent"]
        command += ["--listen" if role is Role.ROUTER else "--connect", self.endpoint]
        word = ""
        environment = os.environ | {"PYTHONUNBUFFERED": "1", VARIABLE: allowance()}
        if self._certificates is not None:
            environment[CONFIG_VARIABLE] = str(self._certificates / name / SETTINGS)
            command += ["--allow", str(self._certificates / ALLOWED)] if role is Role.ROUTER else []
        if role is Role.EMULATOR:
            named, word = without_password(self._given.front_end)  # all users of the machine can read a command
            command += ["--front-end", named]
        elif role in {Role.RECORDER, Role.METRICS}:
            named, word = without_password(self._given.store or str(Path(self._folder.name, "store.db")))
            command += ["--store", named]
        environment |= {"PGPASSWORD": word} if word else {}
        http = [self._http] if role is Role.METRICS and self._http is not None else []
        for listener in http:
            command += ["--http", inherited(listener, self._given.http)]
        if role is Role.RECORDER:
            command += [] if again else ["--no-resume"]  # what other runs left unfinished there is none of ours
        with Path(self._folder.name, name).open("ab") as output:
            self._processes[name] = subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
                command,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=[listener.fileno() for listener in http],
                env=environment,
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
            self._close_pipe(process)
        if self._http is not None:
            self._http.close()
        self._folder.cleanup()

    @staticmethod
    def _close_pipe(process: subprocess.Popen[bytes]) -> None:
        if process.stdin is not None:
            process.stdin.close()

    def _tail(self, name: str) -> str:
        return "\n".join(f"  {name}: {line}" for line in self._lines(name)[-15:])

    def _lines(self, name: str) -> list[str]:
        return Path(self._folder.name, name).read_text(errors="replace").splitlines()
