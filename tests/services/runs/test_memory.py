"""Services that stay up keep nothing of runs that are over."""

import threading
from pathlib import Path

import pytest

from services import kernels
from services.campaigns import connected as campaign_connected
from services.campaigns.campaign import Campaign, Tally, open_store
from services.runs import cluster as distributed
from services.runs.launcher import Launcher
from shared.scenario.radar_config import Strategy
from tests.services.conftest import service_processes
from tests.services.loop import SMOKE

FIRST, LAST = 60, 160  # runs played before the first look, and before the last
MOST_KB = 300  # that the router may grow by in between; with a key per run it grew by 70 kB with each


def _own_kb(name: str) -> int:
    """Memory that a service shares with nobody."""
    (pid,) = (pid for pid, command in service_processes().items() if f"--name {name} " in command)
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private"))


@pytest.mark.zenoh
@pytest.mark.slow
def test_the_router_does_not_grow_with_the_runs(tmp_path: Path) -> None:
    asked = Campaign(SMOKE, (Strategy.ORTHOGONAL,), runs=LAST, first_seed=1, dwells=2)
    store, seen, stop = open_store(str(tmp_path / "c.db"), asked, resume=False), dict[int, int](), threading.Event()

    def report(tally: Tally) -> None:
        if tally.done in {FIRST, LAST}:
            seen[tally.done] = _own_kb("router-0")

    kernels.compile_all(lambda _: None)
    with Launcher(1, str(tmp_path / "m.db"), stop) as launcher:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        campaign_connected.play(asked, store, launcher.endpoint, 4, report=report, stop=stop)
    assert seen[LAST] - seen[FIRST] < MOST_KB
