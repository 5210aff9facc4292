"""Driving Docker from tests: one project of the compose file, of its own name, image and port."""

import functools
import json
import os
import shutil
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from cogradar.services.errors import NoMetrics
from cogradar.services.metrics.client import ask_service
from cogradar.services.planner.ownership import owners
from cogradar.shared.wire.session import free_port

ROOT = Path(__file__).parents[2]
PROJECT = f"cogradar-test-{os.getpid()}"
IMAGE = "cogradar-test"
PORT = free_port()
ROUTER = f"tcp/127.0.0.1:{PORT}"  # as this process sees it
ENVIRONMENT = os.environ | {
    "COGRADAR_IMAGE": IMAGE,
    "COGRADAR_PORT": str(PORT),
    "COGRADAR_HTTP_PORT": "0",
    "COGRADAR_SCENARIO": "",
    "COGRADAR_DWELLS": "",
}
# Limits are for what hangs. A machine that is busy with other work may need several times as long as an idle one.
COMMAND_S = 600.0
CHANGE_S = 300.0


def compose_is_there() -> bool:
    """Whether there is Docker Compose, which reads files without an engine."""
    if shutil.which("docker") is None:
        return False
    command = ["docker", "compose", "version"]
    return subprocess.run(command, capture_output=True, check=False, timeout=CHANGE_S).returncode == 0


@functools.cache
def engine_answers() -> bool:
    """Whether a Docker engine and Compose are there."""
    if shutil.which("docker") is None:
        return False
    return all(
        subprocess.run(["docker", *command], capture_output=True, check=False, timeout=CHANGE_S).returncode == 0
        for command in (["info"], ["compose", "version"])
    )


def docker(*arguments: str, stdin: str | None = None, **environment: str) -> str:
    """Standard output of a docker command that succeeds."""
    done = subprocess.run(
        ["docker", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=ENVIRONMENT | environment,
        timeout=COMMAND_S,
    )
    assert done.returncode == 0, f"docker {' '.join(arguments)}\n{done.stdout[-2000:]}{done.stderr[-4000:]}"
    return done.stdout.strip()


def compose(*arguments: str, stdin: str | None = None, **environment: str) -> str:
    """Standard output of a compose command on this session's project. The operator idles unless it is given more."""
    return docker("compose", "--project-name", PROJECT, *arguments, stdin=stdin, **environment)


def cli(*arguments: str, options: tuple[str, ...] = ()) -> Any:
    """What `cogradar ... --json` prints in a container of its own."""
    return json.loads(compose("run", "--rm", "-T", *options, "cli", *arguments, "--json"))


def runs() -> list[dict[str, Any]]:
    """Rows of `query runs`, asked from this process through the router's port; none while nobody answers."""
    try:
        return ask_service(ROUTER, "runs", {})
    except NoMetrics:
        return []


def containers(service: str) -> list[str]:
    """Container ids of a service."""
    return compose("ps", "--all", "--quiet", service).split()


def inspect(container: str) -> Any:
    """All that the engine knows of a container."""
    return json.loads(docker("inspect", container))[0]


def crash(container: str) -> None:
    """End a container's process from outside, as a crash would: the engine starts it again. Needs root."""
    os.kill(inspect(container)["State"]["Pid"], signal.SIGKILL)


def wait_for(what: str, condition: Any, within_s: float = CHANGE_S) -> Any:
    """First true value of `condition()`; fails, naming `what`, if there is none in time."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.1)
    raise AssertionError(f"{what}: not within {within_s:g} s")


def left_over() -> str:
    """What the engine still has of this session's project: containers, networks, volumes."""
    mine = f"label=com.docker.compose.project={PROJECT}"
    found = [docker("ps", "--all", "--quiet", "--filter", mine)]
    found += [docker(kind, "ls", "--quiet", "--filter", mine) for kind in ("network", "volume")]
    return " ".join(found).strip()


class Run:
    """A run of the paper's scenario on the services, in a container of its own, beside the test."""

    def __init__(self, dwells: int, seed: int = 1) -> None:
        self._known = {row["run"] for row in runs()}
        command = ("run", "paper", "--dwells", str(dwells), "--seed", str(seed))
        self._played = ThreadPoolExecutor(1).submit(cli, *command)

    def row(self) -> Any:
        """Row of the run in `query runs`, or None."""
        return next((row for row in runs() if row["run"] not in self._known), None)

    def wait_until(self, t: int) -> Any:
        """Row of the run once dwell t is done, while it still goes on."""

        def reached() -> Any:
            row = self.row()
            return row if row and row["t"] >= t else None

        row = wait_for(f"dwell {t}", reached)
        assert row["status"] == "running", row
        return row

    def planner_of(self, target: int) -> str:
        """Container of the planner that owns a track."""
        names = {f"planner-{container[:12]}": container for container in containers("planner")}
        return names[owners(self.row()["run"], 3, sorted(names))[target]]

    def result(self) -> Any:
        """The finished run."""
        return self._played.result(COMMAND_S)
