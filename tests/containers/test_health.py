"""The heartbeat of services, as the health check of a container reads it."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cogradar.services.health import VARIABLE, Heartbeat
from cogradar.shared.wire.session import free_port
from tests.containers.deployments import ROOT

CPU_S = 0.05  # that a check may take
OLD_S = 31.0


def _healthy(file: Path) -> subprocess.CompletedProcess[str]:
    command = [str(ROOT / "deploy" / "container" / "healthy.sh"), "metrics"]
    environment = os.environ | {VARIABLE: str(file)}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def _service(file: Path, *arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "cogradar", "service", *arguments]
    return subprocess.Popen(command, env=os.environ | {VARIABLE: str(file)})


def _becomes(file: Path, code: int, within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while (is_other := _healthy(file).returncode != code) and time.monotonic() < deadline:
        time.sleep(0.1)
    return not is_other


def _age(file: Path) -> None:
    """As if nothing had been written for long; whoever is well writes again."""
    then = time.time() - OLD_S
    os.utime(file, (then, then))


@pytest.fixture
def services(tmp_path: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """A router and a metrics service, whose heartbeats are files of their names."""
    where = f"tcp/127.0.0.1:{free_port()}"
    processes = {
        "router": _service(tmp_path / "router", "router", "--listen", where),
        "metrics": _service(tmp_path / "metrics", "metrics", "--connect", where, "--store", str(tmp_path / "store.db")),
    }
    try:
        yield processes
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGCONT)
            process.terminate()
            process.wait(10)


@pytest.mark.zenoh
def test_who_is_up_beats_and_who_hangs_or_has_no_router_does_not(
    services: dict[str, subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    metrics = tmp_path / "metrics"
    assert _becomes(tmp_path / "router", 0, 30.0)
    assert _becomes(metrics, 0, 30.0)
    services["metrics"].send_signal(signal.SIGSTOP)
    _age(metrics)
    time.sleep(2.0)
    assert _healthy(metrics).stdout == "metrics: no heartbeat for 30 seconds\n"
    services["metrics"].send_signal(signal.SIGCONT)
    assert _becomes(metrics, 0, 10.0)
    services["router"].kill()
    time.sleep(2.0)
    _age(metrics)
    time.sleep(2.0)
    assert _healthy(metrics).returncode == 1


def test_a_check_costs_little_and_tells_what_troubles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Held:
        trouble = "the disk is full"

    monkeypatch.setenv(VARIABLE, str(tmp_path / "beat"))
    Heartbeat(core=Held())()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = [_healthy(tmp_path / "beat") for _ in range(10)]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert {(one.returncode, one.stdout) for one in found} == {(0, "the disk is full")}
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 10 * CPU_S
    assert _healthy(tmp_path / "nobody").returncode == 1
