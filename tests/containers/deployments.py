"""What each way to deploy says of each role, in one shape, so that they can be compared with the program."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
BASE = ROOT / "deploy" / "kubernetes" / "base"
UNIT = ROOT / "deploy" / "systemd" / "cogradar@.service"
ENVIRONMENT_FILE = ROOT / "deploy" / "systemd" / "cogradar.env"
COMPOSE = ROOT / "docker-compose.yml"


@dataclass(frozen=True)
class Process:
    """How one role is started: arguments of `cogradar`, environment, command of the health check."""

    arguments: list[str]
    environment: dict[str, str]
    health: list[str] | None


def compose_file() -> Any:
    """The compose file, anchors resolved."""
    return yaml.safe_load(COMPOSE.read_text(encoding="utf-8"))


def from_compose() -> dict[str, Process]:
    """Processes of the compose file, without the command line's own."""
    services = compose_file()["services"]
    return {
        name: Process(service["command"], _by_default(service["environment"]), service["healthcheck"]["test"][1:])
        for name, service in services.items()
        if "profiles" not in service
    }


def _by_default(environment: dict[str, str]) -> dict[str, str]:
    """An environment as it is if none of its variables is set outside."""
    return {key: re.sub(r"^\$\{\w+:?-(.*)\}$", r"\1", value) for key, value in environment.items()}


def manifests() -> list[Any]:
    """Every object of the kustomize base."""
    files = yaml.safe_load((BASE / "kustomization.yaml").read_text(encoding="utf-8"))["resources"]
    return [each for file in files for each in yaml.safe_load_all((BASE / file).read_text(encoding="utf-8"))]


def deployments() -> dict[str, Any]:
    """Deployments of the kustomize base by name."""
    return {each["metadata"]["name"]: each for each in manifests() if each["kind"] == "Deployment"}


def containers() -> dict[str, tuple[Any, Any]]:
    """Containers of all deployments by name, each with the specification of its pod."""
    pods = [deployment["spec"]["template"]["spec"] for deployment in deployments().values()]
    return {container["name"]: (container, pod) for pod in pods for container in pod["containers"]}


def from_kubernetes() -> dict[str, Process]:
    """Processes of the Kubernetes manifests."""
    found = {}
    for name, (container, _) in containers().items():
        environment = {each["name"]: _without_secrets(each) for each in container["env"]}
        probe = container["readinessProbe"].get("exec")
        found[name] = Process(container["args"], environment, probe and probe["command"])
    return found


def _without_secrets(variable: dict[str, Any]) -> str:
    """Value of a container's variable where no secret was made: one that takes its value from a secret is off."""
    if "value" in variable:
        return str(variable["value"])
    assert variable["valueFrom"]["secretKeyRef"]["optional"], variable["name"]
    return ""


def environment_file() -> dict[str, str]:
    """Variables of the systemd environment file."""
    lines = ENVIRONMENT_FILE.read_text(encoding="utf-8").splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def unit_settings() -> dict[str, list[str]]:
    """Settings of the systemd unit; one may be given several times."""
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith("#"):
            key, value = line.split("=", 1)
            found.setdefault(key, []).append(value)
    return found


def started_by_unit(instance: str, host: str, program: str) -> list[str]:
    """Command that systemd runs for an instance, by its rules for % and $, with `program` in place of ours."""
    (line,) = unit_settings()["ExecStart"]
    for specifier, value in (("%%", "\0"), ("%i", instance), ("%l", host), ("\0", "%"), ("$$", "$")):
        line = line.replace(specifier, value)
    return shlex.split(line.replace("/opt/cogradar/.venv/bin/cogradar", program))
