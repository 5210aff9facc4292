"""Several machines: router and the single roles on one, a planner on each of two others, and the links between fail."""

import os
import shutil
import time
from collections.abc import Callable, Iterator

import pytest

from cogradar.services.planner.ownership import owners
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.containers.hosts import Hosts, namespaces

pytestmark = [
    pytest.mark.netns,
    pytest.mark.skipif(
        os.geteuid() != 0 or not shutil.which("ip") or not shutil.which("iptables"),
        reason="network namespaces need root, ip and iptables",
    ),
]

DWELLS = 600  # many seconds on any machine
CUT_S = 6.0
PLANNERS = ("planner-b", "planner-c")


@pytest.fixture(scope="module")
def digest() -> str:
    """Digest of one process."""
    return str(in_process.play(RunStart.of(load("paper"), Strategy.POWER_AWARE, 1, DWELLS)).run["digest"])


@pytest.fixture(scope="module")
def hosts(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    """Three hosts with every service up; the digest first, which compiles the kernels."""
    request.getfixturevalue("digest")
    with Hosts(tmp_path_factory.mktemp("hosts")) as up:
        assert len(namespaces()) == 4
        yield up
    assert not namespaces()


def test_three_hosts_give_the_digest_of_one_process(hosts: Hosts, digest: str) -> None:
    assert hosts.play("--dwells", str(DWELLS)).result()["digest"] == digest


@pytest.mark.parametrize("way", [pytest.param("unplugged", marks=pytest.mark.nightly), "silent"])
def test_a_link_cut_for_six_seconds_changes_no_digest(hosts: Hosts, digest: str, way: str) -> None:
    cut: Callable[[str], None] = (
        (lambda h: hosts.link(h, "down")) if way == "unplugged" else (lambda h: hosts.lose(h, "-i", "eth0"))
    )
    mend: Callable[[str], None] = (lambda h: hosts.link(h, "up")) if way == "unplugged" else hosts.lose
    run = hosts.play("--dwells", str(DWELLS))
    name = hosts.wait_until(10)
    victim = owners(name, 3, PLANNERS)[1].removeprefix("planner-")
    cut(victim)
    try:
        time.sleep(CUT_S)
        assert not run.done(), "the link was to be cut in the middle of the run"
    finally:
        mend(victim)
    assert run.result()["digest"] == digest


def test_one_packet_in_twenty_lost_changes_no_digest(hosts: Hosts, digest: str) -> None:
    hosts.lose("b", "-i", "eth0", "-m", "statistic", "--mode", "random", "--probability", "0.05")
    try:
        assert hosts.play("--dwells", str(DWELLS)).result()["digest"] == digest
    finally:
        hosts.lose("b")
