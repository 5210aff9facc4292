"""Compose, Kubernetes and systemd say of every role what the program says, and are equally hard."""

import re
import shutil
import subprocess
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
import yaml

from cogradar.services.cli.app import app
from cogradar.services.cli.console import CONNECT_VARIABLE, FRONT_END_VARIABLE
from cogradar.services.topology import SERVICES
from cogradar.services.web.address import COMMAND_VARIABLE, HOSTS_VARIABLE
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.plugins.kinds import OF_RUN
from cogradar.shared.scenario.plugins.sources import VARIABLE
from tests.containers.deployments import (
    BASE,
    ENVIRONMENT_FILE,
    ROOT,
    UNIT,
    Process,
    compose_file,
    containers,
    deployments,
    environment_file,
    from_compose,
    from_kubernetes,
    manifests,
    started_by_unit,
    unit_settings,
)
from tests.containers.engine import compose_is_there, docker

OLDEST, NEWEST = "1.29", "1.37"  # Kubernetes releases that the manifests are checked against
WAYS = {"compose": from_compose, "kubernetes": from_kubernetes}
USER = 10001
SCRATCH_VARIABLE = "SQLITE_TMPDIR"
OWN_VARIABLES = {
    Role.RECORDER: tuple(f"COGRADAR_KEEP_{name}" for name in ("RUNS", "DAYS", "HOURS", "BYTES")),
    Role.METRICS: (HOSTS_VARIABLE, COMMAND_VARIABLE, SCRATCH_VARIABLE),
    Role.OPERATOR: ("COGRADAR_SCENARIO", "COGRADAR_DWELLS", "COGRADAR_RATE"),
}


def test_every_way_runs_every_role_and_no_other() -> None:
    roles = {role.value for role in SERVICES}
    assert {way: set(processes()) for way, processes in WAYS.items()} == dict.fromkeys(WAYS, roles)


@pytest.mark.parametrize(("way", "role"), [(way, role) for way in WAYS for role in SERVICES])
def test_the_command_line_takes_what_each_way_gives_it(way: str, role: Role) -> None:
    process = WAYS[way]()[role]
    assert _parsed(process.arguments)["role"] == role
    assert process.environment[CONNECT_VARIABLE].startswith("tcp/")
    assert set(process.environment) == {CONNECT_VARIABLE, *OWN_VARIABLES.get(role, ())}
    assert set(process.environment) - {HOSTS_VARIABLE, COMMAND_VARIABLE, SCRATCH_VARIABLE} <= set(
        _variables_of_service()
    )


@pytest.mark.parametrize("role", SERVICES)
def test_both_ways_start_a_role_alike(role: Role) -> None:
    in_compose, in_kubernetes = from_compose()[role], from_kubernetes()[role]
    assert in_compose.arguments == in_kubernetes.arguments
    assert in_compose.environment == in_kubernetes.environment


def test_nobody_commands_until_tokens_are_given_to_metrics_alone_as_the_manual_says() -> None:
    """Each way has a place for tokens, which is empty, and never in a file that all processes or people read."""
    services, found = compose_file()["services"], containers()
    assert {name for name, one in services.items() if COMMAND_VARIABLE in one.get("environment", {})} == {Role.METRICS}
    assert services[Role.METRICS]["environment"][COMMAND_VARIABLE] == f"${{{COMMAND_VARIABLE}-}}"
    (secret,) = (
        (role, each["valueFrom"]["secretKeyRef"])
        for role, (container, _) in found.items()
        for each in container["env"]
        if each["name"] == COMMAND_VARIABLE
    )
    assert secret == (Role.METRICS, {"name": "cogradar-commanders", "key": "tokens", "optional": True})
    assert COMMAND_VARIABLE not in environment_file()
    assert "-/etc/cogradar-%i.env" in unit_settings()["EnvironmentFile"]
    manual = (ROOT / "docs/howto/deploy.md").read_text(encoding="utf-8")
    for told in (f"{COMMAND_VARIABLE}=", "/etc/cogradar-metrics.env", "secret generic cogradar-commanders"):
        assert told in manual


def test_health_is_asked_about_the_right_role() -> None:
    asked = [p.health for way in WAYS.values() for p in _without_socket_probe(way())]
    assert len(asked) == 2 * len(SERVICES) - 1
    expected = {role.value: ["healthy", role.value] for role in SERVICES}
    assert all(command == expected[command[-1]] for command in asked if command)
    assert {command[-1] for command in asked if command} == set(expected)


def test_only_what_may_run_in_numbers_is_scaled() -> None:
    scaled = {
        each["spec"]["scaleTargetRef"]["name"] for each in manifests() if each["kind"] == "HorizontalPodAutoscaler"
    }
    assert scaled == {"planner"}
    for name, deployment in deployments().items():
        alone = deployment["spec"].get("replicas") == 1 and deployment["spec"]["strategy"]["type"] == "Recreate"
        assert alone != SERVICES[Role(name)].scalable, name


@pytest.fixture(scope="module")
def kubernetes_validate() -> ModuleType:
    """Importing it takes seconds, which every process of the tests would spend to collect this file."""
    return import_module("kubernetes_validate")


@pytest.mark.parametrize("version", [OLDEST, NEWEST])
@pytest.mark.parametrize("manifest", manifests(), ids=lambda m: f"{m['kind']}-{m['metadata']['name']}")
def test_the_manifests_are_valid(kubernetes_validate: ModuleType, manifest: Any, version: str) -> None:
    assert kubernetes_validate.validate(manifest, version, strict=True).startswith(version)


def test_the_validator_notices_a_misspelt_key(kubernetes_validate: ModuleType) -> None:
    wrong = yaml.safe_load((BASE / "emulator.yaml").read_text(encoding="utf-8"))
    wrong["spec"]["template"]["spec"]["containers"][0]["readynessProbe"] = {}
    with pytest.raises(kubernetes_validate.ValidationError, match="readynessProbe"):
        kubernetes_validate.validate(wrong, NEWEST, strict=True)


@pytest.mark.parametrize("role", SERVICES)
def test_kubernetes_is_as_hard_as_compose(role: Role) -> None:
    compose, (container, pod) = compose_file()["services"][role.value], containers()[role.value]
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": "no-new-privileges=true" not in compose["security_opt"],
        "readOnlyRootFilesystem": compose["read_only"],
        "capabilities": {"drop": compose["cap_drop"]},
    }
    assert pod["securityContext"] == {
        "runAsNonRoot": True,
        "runAsUser": USER,
        "runAsGroup": USER,
        "fsGroup": USER,
        "seccompProfile": {"type": "RuntimeDefault"},
    }
    assert not pod["automountServiceAccountToken"]
    assert f"{pod['terminationGracePeriodSeconds']}s" == compose["stop_grace_period"]
    assert container["resources"]["limits"]["memory"].removesuffix("i").lower() == compose["mem_limit"]


def test_recorder_and_metrics_have_one_file_system() -> None:
    """SQLite's readers share memory with its writer: both must be on one machine, with one volume."""
    both = (Role.RECORDER, Role.METRICS)
    services, found = compose_file()["services"], containers()
    assert services[both[0]]["volumes"] == services[both[1]]["volumes"]
    assert found[both[0]][1] is found[both[1]][1], "one pod"
    mounts = [{m["mountPath"]: m["name"] for m in found[role][0]["volumeMounts"]} for role in both]
    assert mounts[0]["/data"] == mounts[1]["/data"]
    assert mounts[0]["/tmp"] != mounts[1]["/tmp"]  # noqa: S108 - inside the containers
    stores = [_parsed(WAYS[way]()[role].arguments)["store"] for way in WAYS for role in both]
    assert {Path(store).parent for store in stores} == {Path("/data")}
    assert len(set(stores)) == 1


def test_selectors_find_the_pods_and_claims_exist() -> None:
    claims = {each["metadata"]["name"] for each in manifests() if each["kind"] == "PersistentVolumeClaim"}
    for deployment in deployments().values():
        template = deployment["spec"]["template"]
        assert deployment["spec"]["selector"]["matchLabels"] == template["metadata"]["labels"]
        wanted = {
            v["persistentVolumeClaim"]["claimName"] for v in template["spec"]["volumes"] if "persistentVolumeClaim" in v
        }
        assert wanted <= claims
    (service,) = (each for each in manifests() if each["kind"] == "Service")
    assert service["spec"]["selector"] == deployments()["router"]["spec"]["template"]["metadata"]["labels"]


def test_every_file_of_the_base_is_part_of_it() -> None:
    listed = yaml.safe_load((BASE / "kustomization.yaml").read_text(encoding="utf-8"))["resources"]
    assert sorted(listed) == sorted(file.name for file in BASE.glob("*.yaml") if file.name != "kustomization.yaml")


@pytest.mark.parametrize("instance", [*(role.value for role in SERVICES), "planner-2"])
def test_the_unit_starts_a_role_under_a_name_of_its_own(instance: str) -> None:
    done = subprocess.run(
        started_by_unit(instance, "host-b", program="/bin/echo"), capture_output=True, text=True, check=True
    )
    parsed = _parsed(done.stdout.split())
    assert parsed["role"] == instance.split("-", maxsplit=1)[0]
    assert parsed["name"] == f"{instance}-host-b"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
def test_the_unit_is_valid_and_hardened(tmp_path: Path) -> None:
    text = UNIT.read_text(encoding="utf-8").replace("/opt/cogradar/.venv/bin/cogradar", "/bin/true")
    unit = tmp_path / UNIT.name.replace("@", "@planner-1")
    unit.write_text(text, encoding="utf-8")
    for command in (["verify"], ["security", "--offline=true", "--threshold=25", "--no-pager"]):
        done = subprocess.run(["systemd-analyze", *command, unit], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert not done.stderr


def test_the_unit_has_the_limits_of_the_containers() -> None:
    compose, unit = compose_file()["services"]["planner"], unit_settings()
    assert unit["MemoryMax"][0].lower() == compose["mem_limit"]
    assert int(unit["TasksMax"][0]) == compose["pids_limit"]
    assert f"{unit['TimeoutStopSec'][0]}s" == compose["stop_grace_period"]


def test_systemd_sets_what_its_units_need_and_nothing_else() -> None:
    variables = environment_file()
    assert variables.pop(CONNECT_VARIABLE) == "tcp/HOST:7447"
    assert variables.pop("COGRADAR_LISTEN") == _parsed(from_compose()[Role.ROUTER].arguments)["listen"]
    for variable in (*OWN_VARIABLES[Role.RECORDER], *OWN_VARIABLES[Role.OPERATOR]):
        del variables[variable]
    assert not variables, ENVIRONMENT_FILE


def test_the_image_pins_kernels_of_each_architecture_and_no_arithmetic() -> None:
    """NumPy and OpenBLAS may take any code (ADR 42); kernels of the build must be usable on any machine."""
    pinned = dict(
        re.findall(r'^FROM \S+ AS base-(\w+)\nENV NUMBA_CPU_NAME=(\S+) NUMBA_CPU_FEATURES=""$', DOCKERFILE, re.M)
    )
    assert pinned == {"amd64": "x86-64-v3", "arm64": "generic"}
    assert "FROM base-${TARGETARCH:-amd64} AS base\n" in DOCKERFILE  # some builders do not say what they build for
    assert "ARG TARGETARCH" not in DOCKERFILE  # it would be empty then
    assert not re.search("OPENBLAS_CORETYPE|NPY_DISABLE", DOCKERFILE)


@pytest.mark.parametrize("role", [Role.RECORDER, Role.OPERATOR])
def test_systemd_sets_what_compose_sets(role: Role) -> None:
    wanted = {key: from_compose()[role].environment[key] for key in OWN_VARIABLES[role]}
    assert wanted.items() <= environment_file().items()


def test_the_front_end_of_the_manual_is_the_one_that_is_deployed() -> None:
    page = (ROOT / "docs/howto/front-end.md").read_text(encoding="utf-8")
    assert (FRONT_END / "udp_receiver.py").read_text(encoding="utf-8") in re.findall(r"```python\n(.*?)```", page, re.S)


def test_a_front_end_is_given_to_the_emulator_alone_with_a_way_to_its_device() -> None:
    found = yaml.safe_load((FRONT_END / "compose.yml").read_text(encoding="utf-8"))
    assert set(found["services"]) == {Role.EMULATOR}
    emulator, (network,) = found["services"][Role.EMULATOR], found["networks"]
    assert emulator["networks"] == [*compose_file()["services"][Role.EMULATOR]["networks"], network]
    assert not (found["networks"][network] or {}).get("internal")
    assert FRONT_END_VARIABLE in _variables_of_service()
    assert FRONT_END_VARIABLE in emulator["environment"]
    (mounted,) = emulator["volumes"]
    assert mounted.endswith(":/front-ends:ro")


def test_compose_mounts_plug_ins_where_they_are_loaded() -> None:
    """In each process that loads one, also for the page, and in those that begin runs.

    As Compose itself reads the files, if it is there.
    """
    found = yaml.safe_load((PLUGINS / "compose.yml").read_text(encoding="utf-8"))
    loading = {role for kind in OF_RUN for role in kind.loaded_by}
    assert set(found["services"]) == {*loading, "metrics", "operator", "cli"} <= set(compose_file()["services"])
    for name, service in found["services"].items():
        (mounted,) = service["volumes"]
        assert mounted.endswith(f":{service['environment'][VARIABLE]}:ro"), name
    if not compose_is_there():
        return
    files = ("-f", "docker-compose.yml", "-f", "deploy/plugins/compose.yml")
    read = yaml.safe_load(docker("compose", *files, "--profile", "*", "config", COGRADAR_OWN="/srv/mine"))["services"]
    for name in found["services"]:
        volumes = [(one["source"], one["target"], one.get("read_only")) for one in read[name]["volumes"]]
        assert ("/srv/mine", "/plugins", True) in volumes, name
        assert read[name]["environment"][VARIABLE] == "/plugins"
    assert not any(VARIABLE in (read[role]["environment"] or {}) for role in ("recorder", "router"))


def test_kubernetes_mounts_the_front_end_that_it_names(kubernetes_validate: ModuleType) -> None:
    made = yaml.safe_load((FRONT_END / "kustomization.yaml").read_text(encoding="utf-8"))
    assert (FRONT_END / made["resources"][0]).resolve() == BASE
    (patch,) = (yaml.safe_load((FRONT_END / one["path"]).read_text(encoding="utf-8")) for one in made["patches"])
    base = deployments()[patch["metadata"]["name"]]
    assert patch["spec"]["template"]["metadata"] == base["spec"]["template"]["metadata"]
    (container,), (volume,) = (patch["spec"]["template"]["spec"][name] for name in ("containers", "volumes"))
    assert container["name"] == Role.EMULATOR
    environment = {each["name"]: each["value"] for each in container["env"]}
    path = Path(environment[FRONT_END_VARIABLE].partition(":")[0])
    (mount,) = container["volumeMounts"]
    assert (mount["name"], mount["mountPath"]) == (volume["name"], str(path.parent))
    assert made["configMapGenerator"] == [{"name": volume["configMap"]["name"], "files": [path.name]}]
    assert (FRONT_END / path.name).is_file()
    policy = yaml.safe_load((FRONT_END / made["resources"][1]).read_text(encoding="utf-8"))
    assert kubernetes_validate.validate(policy, NEWEST, strict=True)
    assert policy["spec"]["podSelector"]["matchLabels"] == base["spec"]["template"]["metadata"]["labels"]
    ((to,), (port,)) = (policy["spec"]["egress"][0][name] for name in ("to", "ports"))
    assert environment["RADAR_DEVICE"] == f"{to['ipBlock']['cidr'].removesuffix('/32')}:{port['port']}"


def test_the_drop_in_opens_one_device_and_nothing_else() -> None:
    lines = (FRONT_END / "cogradar@emulator.conf").read_text(encoding="utf-8").splitlines()
    found = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    assert unit_settings()["PrivateDevices"] == ["yes"]
    assert found.pop("PrivateDevices") == "no"
    assert found.pop("DevicePolicy") == "closed"
    assert set(found) == {"DeviceAllow", "SupplementaryGroups"}


FRONT_END, PLUGINS = ROOT / "deploy" / "front-end", ROOT / "deploy" / "plugins"
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def _parsed(arguments: list[str]) -> dict[str, Any]:
    """Parameters that the command line reads from `arguments`; an unknown one is an error."""
    group: Any = typer.main.get_command(app)
    name, *rest = arguments
    parameters: dict[str, Any] = group.commands[name].make_context(name, rest).params
    return parameters


def _variables_of_service() -> list[str]:
    """Environment variables that `cogradar service` reads."""
    group: Any = typer.main.get_command(app)
    return [parameter.envvar for parameter in group.commands["service"].params if parameter.envvar]


def _without_socket_probe(processes: dict[str, Process]) -> list[Process]:
    """All but the router under Kubernetes, whose probe is its port."""
    return [process for process in processes.values() if process.health is not None]
