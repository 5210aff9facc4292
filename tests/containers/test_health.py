"""Health checks, against a router and a metrics service of this machine."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.health import fault
from shared.protocol.topics import Role
from shared.wire.session import free_port

pytestmark = pytest.mark.zenoh
NAME = "metrics-here"


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """Where a router listens that a metrics service is connected to, and that service's process."""
    where = f"tcp/127.0.0.1:{free_port()}"
    store = str(tmp_path / "store.db")
    processes = [
        _service("router", "--listen", where),
        _service("metrics", "--connect", where, "--name", NAME, "--store", store),
    ]
    try:
        deadline = time.monotonic() + 60
        while fault(Role.METRICS, NAME, where) and time.monotonic() < deadline:
            time.sleep(0.2)
        yield where, processes[1].pid
    finally:
        for process in processes:
            process.send_signal(signal.SIGCONT)
            process.terminate()
            process.wait(10)


def test_services_that_are_up_are_healthy(endpoint: tuple[str, int]) -> None:
    where, _ = endpoint
    assert fault(Role.ROUTER, "any", where) is None
    assert fault(Role.METRICS, NAME, where) is None


def test_a_service_that_the_router_does_not_see_is_not(endpoint: tuple[str, int]) -> None:
    where, _ = endpoint
    assert fault(Role.PLANNER, "planner-x", where) == "the router does not see cogradar/alive/1/*/planner/planner-x"
    assert "does not see" in (fault(Role.METRICS, "metrics-elsewhere", where) or "")


def test_a_metrics_service_that_does_not_answer_is_not(endpoint: tuple[str, int]) -> None:
    where, pid = endpoint
    os.kill(pid, signal.SIGSTOP)
    assert "nobody answered" in (fault(Role.METRICS, NAME, where) or "")


def test_the_command_says_what_is_wrong_in_one_line() -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    done = _health("planner", "planner-x", endpoint=nobody)
    assert done.returncode == 1
    assert done.stderr.startswith(f"planner-x: no Zenoh router at {nobody}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("arguments", [(), ("dashboard",), ("observer",), ("planner", "a", "b")])
def test_the_command_refuses_what_is_no_role(arguments: tuple[str, ...]) -> None:
    done = _health(*arguments, endpoint="tcp/127.0.0.1:1")
    assert (done.returncode, done.stderr) == (2, "usage: python -m services.health ROLE [NAME]\n")


def _service(role: str, *options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "cogradar", "service", role, *options])


def _health(*arguments: str, endpoint: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.health", *arguments]
    environment = os.environ | {"COGRADAR_CONNECT": endpoint}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
