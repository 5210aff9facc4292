"""Services that stay up keep nothing of runs that are over, and of a run no more than they need."""

import gc
import json
import threading
import time
from pathlib import Path

import pytest

from cogradar.services import kernels
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.queries import ask
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.conftest import service_processes
from tests.services.loop import SMOKE

AT_ONCE = 4
FIRST, LAST = 60, 160  # runs played before the first look, and before the last
MOST_KB = 300  # that the router may grow by in between; with a key per run it grew by 70 kB with each


def _own_kb(name: str) -> int:
    """Memory that a service shares with nobody."""
    (pid,) = (pid for pid, command in service_processes().items() if f"--name {name} " in command)
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private"))


@pytest.mark.zenoh
@pytest.mark.nightly
def test_the_router_does_not_grow_with_the_runs(tmp_path: Path) -> None:
    starts = [RunStart.of(SMOKE, Strategy.ORTHOGONAL, seed, 2) for seed in range(1, LAST + 1)]
    seen, stop = dict[int, int](), threading.Event()
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(1, str(tmp_path / "m.db")), stop) as launcher:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        session = open_session([launcher.endpoint], 10.0, launcher.check)
        bus = ZenohBus(session, Role.OPERATOR, "operator-test", reads=False)
        for n, start in enumerate(starts, 1):  # over one session: it is keys that must not be kept
            bus.publish(start)
            if n % AT_ONCE == 0:
                _wait_until_complete(session, n)
            if n in {FIRST, LAST}:
                seen[n] = _own_kb("router-0")
        bus.close()
    assert seen[LAST] - seen[FIRST] < MOST_KB


def _wait_until_complete(session: Session, n: int) -> None:
    """Wait until so many runs are complete."""
    deadline = time.monotonic() + 30.0
    while sum(run["status"] == "complete" for run in json.loads(ask(session, "runs", {"run": "all"}, 10.0))) < n:
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("scenario", ["traffic", "smoke"])
def test_what_a_dwell_is_made_of_is_freed_without_the_garbage_collector(scenario: str) -> None:
    playing = in_process.steps(RunStart.of(load(scenario), Strategy.POWER_AWARE, 1, 40))
    for _ in range(20):
        next(playing)
    gc.collect()
    gc.disable()
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        for _ in range(10):
            next(playing)
        gc.collect()
        left = {name for one in gc.garbage if (name := type(one).__module__).startswith("cogradar.")}
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
        playing.close()
    assert not left
