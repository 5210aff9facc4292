"""The compose file with certificates: the same digest, and nobody gets in without one, or does more than its part."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml

from cogradar.services.topology import SERVICES
from cogradar.shared.protocol.topics import Role
from tests.containers.deployments import ROOT, compose_file
from tests.containers.engine import COMMAND_S, ENVIRONMENT, PROJECT, docker, wait_for

OVERRIDE = ROOT / "deploy" / "secure" / "compose.yml"
FILES = ("--file", "docker-compose.yml", "--file", str(OVERRIDE.relative_to(ROOT)))
SECURED = f"{PROJECT}-secured"
DWELLS = "20"


def test_every_service_has_a_certificate_of_its_own_and_sees_no_other_roles() -> None:
    services = yaml.safe_load(OVERRIDE.read_text(encoding="utf-8"))["services"]
    assert set(services) == {*SERVICES, "cli", "certs"}
    assert set(services) - {"certs"} == set(compose_file()["services"])
    seen = {name: service["volumes"][0]["volume"]["subpath"] for name, service in services.items() if name != "certs"}
    several = {name for name, service in SERVICES.items() if service.scalable}
    alone = {name: f"keys/{name}.compose" for name in SERVICES if name not in several} | {"cli": "keys/operator.cli"}
    assert seen == alone | {name: f"keys/{name}" for name in several}
    issued = services["certs"]["command"][0]
    assert all(path.removeprefix("keys/") in issued.split() for path in alone.values())
    assert issued.count("for role in emulator planner allocator;") == 2
    assert all(
        (services[name]["environment"]["COGRADAR_ZENOH"] == "/keys/*/zenoh.json5") == (name in several) for name in seen
    )
    for name in seen:
        assert services[name]["environment"]["COGRADAR_CONNECT"].startswith("tls/")
        assert services[name]["depends_on"] == {"certs": {"condition": "service_completed_successfully"}}
    assert services[Role.ROUTER]["command"][-2:] == ["--allow", "/keys/allowed"]


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[str]]]:
    """Begins the script of the image, with a program in place of cogradar that says which certificate it was given."""
    stubs, keys = tmp_path / "stubs", tmp_path / "keys"
    stubs.mkdir()
    programs = {"cogradar": 'echo "$COGRADAR_ZENOH"; read -r _'} | dict.fromkeys(("grep", "mkdir", "cp"), "")
    for name, text in programs.items():
        (stubs / name).write_text(f"#!/bin/sh\n{text}\nexit 0\n")
        (stubs / name).chmod(0o755)
    for name in ("planner.1", "planner.2"):
        (keys / name).mkdir(parents=True)
        (keys / name / "zenoh.json5").touch()
    own = {"COGRADAR_ZENOH": f"{keys}/*/zenoh.json5", "COGRADAR_CACHE_DIR": str(tmp_path)}
    environment = os.environ | own | {"PATH": f"{stubs}:{os.environ['PATH']}"}
    with ExitStack() as ended:

        def run() -> subprocess.Popen[str]:
            pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
            script = ["sh", str(ROOT / "deploy" / "container" / "entrypoint.sh")]
            begun = subprocess.Popen(script, text=True, env=environment, **pipes)
            return ended.enter_context(begun)

        yield run


def _taken(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return Path(process.stdout.readline().strip()).parent.name


def test_each_container_takes_a_certificate_that_no_other_has(begin: Callable[[], subprocess.Popen[str]]) -> None:
    first, second = begin(), begin()
    assert {_taken(first), _taken(second)} == {"planner.1", "planner.2"}
    _, said = begin().communicate()
    assert said.endswith("keys/*/zenoh.json5: other containers have all of these certificates: issue one more\n")
    first.communicate("\n")
    third = begin()
    assert _taken(third) in {"planner.1", "planner.2"}
    for process in (second, third):
        process.communicate("\n")


def test_a_container_that_is_refused_takes_another_certificate_some_time(
    begin: Callable[[], subprocess.Popen[str]],
) -> None:
    """A container of another machine may have the one that is free here; always the same one could never start."""
    taken = set[str]()
    for _ in range(50):
        taken.add(_taken(process := begin()))
        process.communicate("\n")
    assert taken == {"planner.1", "planner.2"}


def _compose(*arguments: str) -> str:
    return docker("compose", *FILES, "--project-name", SECURED, *arguments, COGRADAR_PORT="0", COGRADAR_SCENARIO="")


@pytest.fixture
def secured(request: pytest.FixtureRequest) -> Iterator[None]:
    request.getfixturevalue("image")
    try:
        _compose("up", "--detach", "--no-build", "--scale", "planner=2")
        yield
    finally:
        _compose("down", "--volumes", "--timeout", "2")


@pytest.mark.docker
@pytest.mark.usefixtures("secured")
def test_the_whole_system_runs_with_certificates() -> None:
    """A run on it has the digest of one process; without a key, or with a planner's, nobody is answered."""
    command = ("cogradar", "run", "smoke", "--dwells", DWELLS, "--json")
    answer = wait_for("a run", lambda: json.loads(_try("run", "--rm", "cli", *command[1:]) or "null"))
    bare = ("exec", "--env", "COGRADAR_CONNECT=", "--env", "COGRADAR_ZENOH=")
    alone = json.loads(_try(*bare, "planner", *command, "--in-process"))
    assert answer["digest"] == alone["digest"]
    asked = ("cogradar", "query", "runs", "--json")
    assert json.loads(_try("exec", "operator", *asked))[0]["digest"] == answer["digest"]
    key = "/keys/planner.1/zenoh.json5"
    assert _try("exec", "planner", "cat", key) != ""
    assert _try("exec", "--env", f"COGRADAR_ZENOH={key}", "planner", *asked) == ""
    assert _try("exec", "--env", "COGRADAR_ZENOH=", "operator", *asked) == ""
    assert "is open" not in _compose("logs", "router")


def _try(verb: str, *arguments: str) -> str:
    """Standard output of a compose command; nothing if it failed."""
    command = ["docker", "compose", *FILES, "--project-name", SECURED, verb, "-T", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, env=ENVIRONMENT, timeout=COMMAND_S
    )
    return done.stdout if done.returncode == 0 else ""
