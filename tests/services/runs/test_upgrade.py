"""An upgrade in mid-run: all that plays runs is replaced by another build, and the run goes on from its checkpoint."""

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from cogradar.services import kernels
from cogradar.services.runs import cluster, in_process
from cogradar.services.topology import TOPOLOGY
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.session import free_port
from tests.services.loop import smoke_start

pytestmark = [pytest.mark.zenoh, pytest.mark.slow]

OLD = "0123456789abcdef"
# The same program under another digest: what it computes is the same, and nobody of this build hears it.
AS_OLD = (
    f"import cogradar.shared.protocol.build as b; b.build = lambda: {OLD!r}; "
    "import cogradar.services.cli.app as app; app.main()"
)
START = smoke_start(dwells=600)


@contextmanager
def _system(folder: Path, endpoint: str, *, old: bool) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """All processes of a system with two planners; what is left of them is killed."""
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for service in TOPOLOGY:
            for i in range(2 if service.scalable else 1):
                name = f"{service.role}-{i}"
                processes[name] = _begin(folder, endpoint, service.role, name, old=old)
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def _begin(folder: Path, endpoint: str, role: Role, name: str, *, old: bool) -> subprocess.Popen[bytes]:
    program = ["-c", AS_OLD] if old else ["-m", "cogradar"]
    command = [sys.executable, *program, "service", role.value, "--name", name]
    command += ["--listen" if role is Role.ROUTER else "--connect", endpoint]
    command += ["--store", str(folder / "store.db")] if role in {Role.RECORDER, Role.METRICS} else []
    with (folder / f"{name}-{'old' if old else 'new'}.log").open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"PYTHONUNBUFFERED": "1"})


def _wait_until(is_so: Callable[[], bool], within_s: float = 90.0) -> None:
    deadline = time.monotonic() + within_s
    while not is_so():
        assert time.monotonic() < deadline, "too late"
        time.sleep(0.1)


def _run(store: Path) -> dict[str, Any]:
    with suppress(sqlite3.OperationalError), closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as db:
        db.row_factory = sqlite3.Row
        return dict(db.execute("SELECT * FROM run").fetchone() or {"acknowledged_k": -1})
    return {"acknowledged_k": -1}


@pytest.mark.nightly
def test_a_run_goes_on_with_another_build_to_the_same_digest(tmp_path: Path) -> None:
    kernels.compile_all(lambda _: None)
    endpoint, store, stop = f"tcp/127.0.0.1:{free_port()}", tmp_path / "store.db", threading.Event()
    with _system(tmp_path, endpoint, old=True) as old:
        cluster.wait_until_up(endpoint, old.keys() - {"router-0"}, lambda: None)
        cluster.start_on(endpoint, START, notify=lambda _: None, stop=stop)  # who begins a run may be of any build
        _wait_until(lambda: _run(store)["acknowledged_k"] >= START.dwells // 10)
        left = old["planner-1"]  # is forgotten
        ended = {name: process for name, process in old.items() if process is not left}
        for process in ended.values():
            process.send_signal(signal.SIGTERM)
        assert {name: process.wait(20.0) for name, process in ended.items()} == dict.fromkeys(ended, 0)
        stood_at = _run(store)["acknowledged_k"]
        assert START.dwells // 10 <= stood_at < START.dwells
        with _system(tmp_path, endpoint, old=False):
            _wait_until(lambda: _run(store)["status"] != "running")
            assert left.poll() is None  # it looks on
            assert (
                f"planner-1 runs build {OLD}, this system {build()}: they do not hear each other"
                in (tmp_path / "emulator-0-new.log").read_text()
            )
    run = _run(store)
    assert (run["status"], run["digest"]) == ("complete", in_process.play(START).run["digest"])
