"""Services that stay up keep nothing of runs that are over."""

import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from services import kernels
from services.runs import cluster as distributed
from services.runs.launcher import Launcher
from shared.protocol.messages import RunStart
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
    starts = [RunStart.of(SMOKE, Strategy.ORTHOGONAL, seed, 2) for seed in range(1, LAST + 1)]
    seen, stop = dict[int, int](), threading.Event()
    kernels.compile_all(lambda _: None)
    with Launcher(1, str(tmp_path / "m.db"), stop) as launcher, ThreadPoolExecutor(4) as players:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        play = partial(distributed.play_on, launcher.endpoint, report=lambda _: None, notify=lambda _: None, stop=stop)
        for n, _ in enumerate(players.map(play, starts), 1):
            if n in {FIRST, LAST}:
                seen[n] = _own_kb("router-0")
    assert seen[LAST] - seen[FIRST] < MOST_KB
