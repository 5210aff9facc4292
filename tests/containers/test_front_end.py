"""The receiver by UDP of the manual as the front end of the emulator's container, and its device in another one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.services.errors import NoMetrics
from cogradar.services.metrics.client import ask_service
from cogradar.shared.wire.session import free_port
from tests.containers.engine import IMAGE, PROJECT, ROOT, docker, wait_for

pytestmark = pytest.mark.docker

RADAR = f"{PROJECT}-front-end"
DEVICE = f"{RADAR}-device"
NETWORK = f"{RADAR}_device"
PORT = free_port()
FILES = ("--file", "docker-compose.yml", "--file", "deploy/front-end/compose.yml")
TARGETS = [[40.0, 0.010, -30.0, 0.005], [50.0, -0.005, 20.0, 0.010]]  # as the device moves them: km, km per dwell
ANSWERING = (
    f"from udp_device import Device; Device(16, 70.0, {TARGETS}, 0.1, (), ('0.0.0.0', 7000)).__enter__();"
    " __import__('threading').Event().wait()"
)


def _compose(*arguments: str, **environment: str) -> str:
    given = {"COGRADAR_PORT": str(PORT), "COGRADAR_FRONT_END": "/front-ends/udp_receiver.py:UdpReceiver"}
    return docker("compose", "--project-name", RADAR, *FILES, *arguments, **given | environment)


def _rows(metric: str, **parameters: str) -> Any:
    try:
        return ask_service(f"tcp/127.0.0.1:{PORT}", metric, parameters)
    except NoMetrics:
        return []


@pytest.fixture
def radar(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[None]:
    """All services up, the emulator with the receiver and its device, and a run without an end."""
    request.getfixturevalue("image")
    smoke = (ROOT / "deploy/scenarios/smoke.toml").read_text(encoding="utf-8")
    mine = smoke.partition("[world")[0].replace("dt_s = 1.0", "dt_s = 0.1")
    (tmp_path / "mine.toml").write_text(mine, encoding="utf-8")
    tmp_path.chmod(0o755)  # containers have a user of their own
    scenario = {"COGRADAR_SCENARIOS": str(tmp_path), "COGRADAR_SCENARIO": "/scenarios/mine.toml", "COGRADAR_RATE": "5"}
    endless = {"COGRADAR_DWELLS": "unlimited", "RADAR_DEVICE": "device:7000"}
    mounted = ("--volume", f"{ROOT}/tests/udp_device.py:/x/udp_device.py:ro", "--workdir", "/x")
    try:
        _compose("up", "--detach", "--no-build", **scenario, **endless)
        joined = ("--network", NETWORK, "--network-alias", "device")
        detached = ("run", "--detach", "--rm", "--name", DEVICE)
        docker(*detached, *joined, *mounted, "--entrypoint", "python", IMAGE, "-c", ANSWERING)
        yield
    finally:
        docker("rm", "--force", DEVICE)
        _compose("down", "--volumes", "--timeout", "5")


@pytest.mark.usefixtures("radar")
def test_a_device_behind_a_network_of_the_emulators_own_is_tracked() -> None:
    run = wait_for("30 dwells", lambda: next((row for row in _rows("runs") if row["t"] >= 30), None))
    docker("exec", f"{RADAR}-emulator-1", "healthy", "emulator")
    there = docker("network", "inspect", NETWORK, "--format", "{{range .Containers}}{{.Name}} {{end}}")
    assert set(there.split()) == {DEVICE, f"{RADAR}-emulator-1"}
    rows = _rows("tracks", run=run["run"])
    assert np.mean([row["detected"] == 1 for row in rows]) > 0.5
    for row in rows[-2:]:
        x, vx, y, vy = TARGETS[row["target"] - 1]
        off = np.arctan2(row["y_hat"], row["x_hat"]) - np.arctan2(y + row["k"] * vy, x + row["k"] * vx)
        assert abs(np.degrees(off)) < 8.0  # a bin

    docker("kill", DEVICE)
    wait_for("what is wrong", lambda: next((row for row in _rows("runs") if row["fault"]), None))
