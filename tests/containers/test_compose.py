"""The compose file with a real engine: the same digest as in one process, whatever dies, and hardened inside."""

import json
import os
import subprocess
import sys
import time
from typing import Any

import httpx
import pytest

from tests.containers.conftest import PLANNERS, FirstUp
from tests.containers.engine import (
    PROJECT,
    ROOT,
    Run,
    cli,
    compose,
    containers,
    crash,
    docker,
    inspect,
    runs,
    wait_for,
)

pytestmark = pytest.mark.docker

needs_root = pytest.mark.skipif(
    os.geteuid() != 0, reason="only root can end a container's process from outside, as a crash would"
)

PUBLISHED = ("router", "metrics")
SERVICES = ("router", "recorder", "metrics", "emulator", "planner", "allocator", "operator")
DWELLS = 100
LONG = 600  # dwells of a run in which something happens meanwhile: many seconds on any machine
CUT_S = 6.0
STOP_S = 5
DOWN_S = 9.0
ANSWER_S = 60.0


@pytest.fixture(scope="session")
def digests(request: pytest.FixtureRequest) -> dict[int, str]:
    """Digest per number of dwells, from one process in a container of the same image."""
    request.getfixturevalue("services")
    there = {}
    for dwells in (DWELLS, LONG):
        alone = ("run", "paper", "--in-process", "--dwells", str(dwells))
        there[dwells] = cli(*alone, options=("--env", "COGRADAR_CONNECT="))["digest"]
    return there


def test_the_first_up_is_a_radar_that_tracks(services: FirstUp) -> None:
    assert [row["target"] for row in services.answer] == [2]
    assert services.answer[0]["n"] > 0
    assert services.answer_s < ANSWER_S


@pytest.mark.usefixtures("services")
def test_an_operator_that_stops_cancels_its_run_and_without_a_scenario_it_begins_none() -> None:
    first = [row for row in runs() if row["rate_hz"] == 5.0]  # as the compose file has it
    assert [row["seed"] for row in first] == list(range(1, len(first) + 1))
    assert first[-1]["reason"] == "by user"
    assert not [row for row in runs() if row["status"] == "running"]


def test_three_planners_give_the_digest_of_one_process(digests: dict[int, str]) -> None:
    assert len(containers("planner")) == PLANNERS
    assert cli("run", "paper", "--dwells", str(DWELLS))["digest"] == digests[DWELLS]
    assert len(containers("planner")) == PLANNERS, "the command-line container changed the number of planners"


def test_the_host_gives_the_same_digest(digests: dict[int, str]) -> None:
    """Kernels of the image are compiled for any machine of the architecture, those of the host for its processor."""
    command = [sys.executable, "-m", "cogradar", "run", "paper", "--in-process", "--dwells", str(DWELLS), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout)["digest"] == digests[DWELLS]


@pytest.mark.usefixtures("services")
def test_metrics_answers_another_container_during_a_run() -> None:
    run = Run(LONG)
    name = run.wait_until(1)["run"]
    row = cli("query", "p_d", "--target", "2", "--run", name)[0]
    assert row["target"] == 2
    assert 0 < row["n"] < LONG, "the answer was meant to come in the middle of the run"
    run.result()


def test_a_killed_planner_is_replaced_by_the_others_with_the_same_digest(digests: dict[int, str]) -> None:
    run = Run(LONG)
    run.wait_until(10)
    victim = run.planner_of(target=1)
    docker("kill", "--signal", "KILL", victim)
    try:
        assert run.row()["status"] == "running"
        assert not inspect(victim)["State"]["Running"]
        assert run.result()["digest"] == digests[LONG]
    finally:
        docker("start", victim)
        _wait_until_healthy(victim)


def test_a_planner_cut_off_the_network_for_six_seconds_changes_no_digest(digests: dict[int, str]) -> None:
    run = Run(LONG)
    run.wait_until(10)
    victim = run.planner_of(target=1)
    docker("network", "disconnect", f"{PROJECT}_loop", victim)
    try:
        time.sleep(CUT_S)
        assert run.row()["status"] == "running"
    finally:
        docker("network", "connect", f"{PROJECT}_loop", victim)
    assert run.result()["digest"] == digests[LONG]
    _wait_until_healthy(victim)


@needs_root
@pytest.mark.parametrize("service", ["recorder", pytest.param("metrics", marks=pytest.mark.nightly)])
def test_a_crash_of_recorder_or_metrics_changes_no_digest(service: str, digests: dict[int, str]) -> None:
    run = Run(LONG)
    run.wait_until(10)
    crash(containers(service)[0])
    assert run.result()["digest"] == digests[LONG]


@pytest.mark.nightly
def test_with_several_of_every_role_that_may_be_those_that_serve_die_and_the_digest_is_the_same(
    digests: dict[int, str],
) -> None:
    several = {"planner": 4, "emulator": 2, "allocator": 2, "recorder": 2}
    scales = [part for role, n in several.items() for part in ("--scale", f"{role}={n}")]
    compose("up", "--detach", "--no-build", "--wait", *scales, COGRADAR_SCENARIO="")
    assert {role: len(containers(role)) for role in several} == several
    run = Run(LONG)
    run.wait_until(10)
    victims = [each for role in several for each in containers(role)[:1]]
    for victim in victims:
        docker("kill", "--signal", "KILL", victim)
    assert run.row() is None or run.row()["status"] == "running"
    assert run.result()["digest"] == digests[LONG]
    assert not any(inspect(victim)["State"]["Running"] for victim in victims)
    compose("up", "--detach", "--no-build", "--wait", "--scale", f"planner={PLANNERS}", COGRADAR_SCENARIO="")


@needs_root
@pytest.mark.usefixtures("services")
def test_services_that_crash_are_started_again() -> None:
    victims = [containers(service)[0] for service in SERVICES]
    before = {victim: inspect(victim)["RestartCount"] for victim in victims}
    for victim in victims:
        crash(victim)
    for victim in victims:
        wait_for("a restart", lambda victim=victim: inspect(victim)["RestartCount"] > before[victim])
        _wait_until_healthy(victim)


def test_the_store_survives_its_container(digests: dict[int, str]) -> None:
    digest = cli("run", "paper", "--dwells", str(DWELLS))["digest"]
    compose("rm", "--stop", "--force", "recorder", "metrics")
    compose("up", "--detach", "--no-build", "--no-deps", "--wait", "recorder", "metrics")
    kept = runs()
    assert digest == digests[DWELLS]
    assert [row["digest"] for row in kept if row["dwells"] == DWELLS].count(digest) >= 1


@pytest.mark.parametrize("service", SERVICES)
@pytest.mark.usefixtures("services")
def test_the_hardening_holds_inside(service: str) -> None:
    asked = json.loads(compose("config", "--format", "json"))["services"][service]
    seen = json.loads(compose("exec", "-T", service, "python", "-", stdin=PROBE))
    assert seen["uids"] == [10001] * 4
    assert seen["gids"] == [10001] * 4
    assert set(seen["capabilities"].values()) == {"0000000000000000"}
    assert seen["no_new_privileges"] == "1"
    assert seen["memory"] == int(asked["mem_limit"])
    assert seen["pids"] == asked["pids_limit"]
    assert seen["process_1"].startswith("/opt/cogradar/venv/bin/python"), "no shell between the engine and the service"
    writable = ["/tmp"] + (["/data"] if service in {"recorder", "metrics"} else [])  # noqa: S108
    assert [place for place in seen["places"] if seen["places"][place]] == writable
    assert seen["tools"] == []
    assert seen["has_default_route"] == (service in PUBLISHED)


@pytest.mark.usefixtures("services")
def test_ports_are_published_on_loopback_only() -> None:
    published = {service: _published(service) for service in SERVICES}
    assert published == {service: ["127.0.0.1"] if service in PUBLISHED else [] for service in SERVICES}


@pytest.mark.usefixtures("services")
def test_runs_are_served_over_http() -> None:
    (binding,) = inspect(containers("metrics")[0])["NetworkSettings"]["Ports"]["8080/tcp"]
    address = f"http://127.0.0.1:{binding['HostPort']}"
    assert httpx.get(f"{address}/readyz", timeout=30.0).json() == {"status": "ok"}
    assert "rows" in httpx.get(f"{address}/api/v1/runs", timeout=30.0).json()


@pytest.mark.usefixtures("image")
def test_kernels_come_with_the_image() -> None:
    alone = ("--env", "COGRADAR_CONNECT=", "--env", "NUMBA_DEBUG_CACHE=1")
    said = compose("run", "--rm", "-T", "--no-deps", *alone, "cli", "run", "paper", "--in-process", "--dwells", "3")
    assert "data loaded from" in said
    assert "data saved to" not in said


@pytest.mark.usefixtures("services")
def test_everything_is_down_within_nine_seconds_by_itself() -> None:
    """The engine kills whoever is not gone after the grace period, which shows as exit code 137."""
    everyone = [container for service in SERVICES for container in containers(service)]
    assert {inspect(container)["Config"]["StopTimeout"] for container in everyone} == {STOP_S}
    began = time.monotonic()
    compose("stop")  # as `down` does first; what the engine keeps of a container that is gone is not for certain
    codes = {container: inspect(container)["State"]["ExitCode"] for container in everyone}
    compose("down")
    assert time.monotonic() - began < DOWN_S
    assert codes == dict.fromkeys(everyone, 0)


def _wait_until_healthy(container: str) -> None:
    wait_for(f"{container} healthy", lambda: inspect(container)["State"]["Health"]["Status"] == "healthy")


def _published(service: str) -> list[str]:
    ports: dict[str, Any] = inspect(containers(service)[0])["NetworkSettings"]["Ports"]
    return [binding["HostIp"] for bindings in ports.values() for binding in bindings or ()]


PROBE = """
import json, os, pathlib, shutil

def first(*files):
    return int(next(pathlib.Path(file).read_text() for file in files if os.path.exists(file)))

def writable(place):
    try:
        pathlib.Path(place, "probe").touch()
        pathlib.Path(place, "probe").unlink()
        return True
    except OSError:
        return False

status = dict(line.split(":", 1) for line in pathlib.Path("/proc/1/status").read_text().splitlines())
routes = [line.split() for line in pathlib.Path("/proc/net/route").read_text().splitlines()[1:]]
group = "/sys/fs/cgroup/"
print(json.dumps({
    "uids": [int(number) for number in status["Uid"].split()],
    "gids": [int(number) for number in status["Gid"].split()],
    "capabilities": {key: status[key].strip() for key in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")},
    "no_new_privileges": status["NoNewPrivs"].strip(),
    "memory": first(group + "memory.max", group + "memory/memory.limit_in_bytes"),
    "pids": first(group + "pids.max", group + "pids/pids.max"),
    "process_1": pathlib.Path("/proc/1/cmdline").read_bytes().split(bytes(1))[0].decode(),
    "places": {place: writable(place) for place in ("/", "/opt/cogradar", "/etc", "/usr", "/var/tmp", "/tmp", "/data")},
    "tools": [tool for tool in ("gcc", "cc", "ld", "make", "ruff", "mypy", "pytest", "uv") if shutil.which(tool)],
    "has_default_route": any(route[1] == "00000000" for route in routes),
}))
"""
