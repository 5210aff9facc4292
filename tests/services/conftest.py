"""Services for tests, and who of ours is running: tests that start processes check that they left none."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from cogradar.services import kernels
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import MEMORY
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from tests.postgresql import Server, running

MARK = "COGRADAR_TEST_SESSION"
os.environ[MARK] = str(os.getpid())


def service_processes() -> dict[int, str]:
    """Service processes that this test session started, process id -> command line; nobody else's."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue  # it ended meanwhile
            if "cogradar service" in command and _is_ours(entry):
                found[int(entry.name)] = command
    return found


def _is_ours(entry: Path) -> bool:
    """Whether a process carries this session's mark, which children inherit with the environment."""
    try:
        return f"{MARK}={os.getpid()}".encode() in (entry / "environ").read_bytes().split(b"\0")
    except OSError:
        return False


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Services that are up, with two planners."""
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(2), threading.Event()) as launcher:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        yield launcher.endpoint


@pytest.fixture
def process_names() -> Callable[[], list[str]]:
    """Command lines of the service processes left, after up to five seconds of grace."""
    before = set(service_processes())

    def names() -> list[str]:
        deadline = time.monotonic() + 5.0
        while (left := {pid: c for pid, c in service_processes().items() if pid not in before}) and (
            time.monotonic() < deadline
        ):
            time.sleep(0.05)
        return list(left.values())

    return names


@pytest.fixture(scope="session")
def postgresql() -> Iterator[Server]:
    """A PostgreSQL server."""
    with running() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def either_store(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The journals in memory of a module's tests, or schemas of a server in place of them."""
    if request.param == "sqlite":
        yield
        return
    server: Server = request.getfixturevalue("postgresql")
    with ExitStack() as opened:

        def journal(path: str, **options: Any) -> Journal:
            return opened.enter_context(closing(Journal(server.url() if path == MEMORY else path, **options)))

        monkeypatch.setattr(request.module, "Journal", journal)
        yield
