"""Campaigns on a Dask cluster of two worker processes come to the results of local ones, bit for bit."""

import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pytest
from distributed import Client

from cogradar.services.campaigns import campaign as campaigns
from cogradar.services.campaigns import dask_pool
from cogradar.services.campaigns.campaign import Campaign, Tally, results_digest
from cogradar.services.campaigns.pool import LocalPool
from cogradar.services.errors import BadInput, Interrupted, RunFailed, check_stop
from cogradar.services.metrics.store import Store, in_memory
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.session import free_port
from tests.services.loop import SMOKE

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[3]
ASKED = Campaign((SMOKE,), (Strategy.UNIFORM, Strategy.POWER_AWARE), runs=4, first_seed=5, dwells=6)


@pytest.fixture(scope="module")
def reference() -> str:
    store = in_memory()
    campaigns.play(ASKED, store, LocalPool(2), stop=threading.Event())
    return results_digest(store)


@dataclass
class Cluster:
    """A scheduler, and workers that are processes of their own."""

    folder: Path
    address: str = field(default_factory=lambda: f"tcp://127.0.0.1:{free_port()}")
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, role: str, *arguments: str, sources: Path = REPOSITORY) -> subprocess.Popen[bytes]:
        """Start a process that runs these sources."""
        command = [sys.executable, "-m", f"distributed.cli.dask_{role}", *arguments, "--no-dashboard"]
        with (self.folder / "log").open("ab") as log:
            environment = os.environ | {"PYTHONPATH": str(sources)}
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=sources, env=environment))
        return self.processes[-1]

    def start_worker(self, *arguments: str, sources: Path = REPOSITORY) -> subprocess.Popen[bytes]:
        """Start a worker; one thread if not told otherwise."""
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny", *arguments, sources=sources)

    def wait_for_workers(self, n: int) -> None:
        """Wait until so many are there."""
        with Client(self.address, timeout=30.0, set_as_default=False) as client:
            deadline = time.monotonic() + 30.0
            while len(client.scheduler_info(n_workers=-1)["workers"]) != n:
                assert time.monotonic() < deadline
                time.sleep(0.1)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with two workers."""
    started = Cluster(tmp_path_factory.mktemp("dask"))
    try:
        started.start("scheduler", "--host", "127.0.0.1", "--port", started.address.rpartition(":")[2])
        for _ in range(2):
            started.start_worker()
        started.wait_for_workers(2)
        yield started
    finally:
        for process in reversed(started.processes):
            process.kill()
            process.wait()


def _play(
    address: str, store: Store, report: Callable[[Tally], None] = lambda _: None, stop: threading.Event | None = None
) -> None:
    stop = stop or threading.Event()
    trial, check = ASKED.starts()[0], partial(check_stop, stop)
    with dask_pool.cluster(address, trial, notify=lambda _: None, check=check) as pool:
        campaigns.play(ASKED, store, pool, report=report, stop=stop)


def test_workers_that_are_not_fit_are_named_and_refused(cluster: Cluster, tmp_path: Path) -> None:
    shutil.copytree(REPOSITORY / "cogradar", tmp_path / "cogradar", ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / "cogradar/services/planner/decision.py").open("a") as source:
        source.write("# another version\n")
    others = [
        cluster.start_worker("--name", "stale", sources=tmp_path),
        cluster.start_worker("--nthreads", "2", "--name", "busy"),
    ]
    cluster.wait_for_workers(4)
    with pytest.raises(BadInput) as refused:
        _play(cluster.address, in_memory())
    for other in others:
        other.kill()
    cluster.wait_for_workers(2)
    lines = sorted(re.sub(r"tcp://\S+ ", "", line) for line in str(refused.value).splitlines())
    assert lines == [
        "worker (busy): makes 2 runs in one process; start it with --nthreads 1",
        "worker (stale): has another version of the program, of its libraries or of Python",
    ]


def test_an_interrupted_campaign_goes_on_and_a_killed_worker_costs_nothing_but_time(
    cluster: Cluster, reference: str
) -> None:
    store, stop, stopped_s = in_memory(), threading.Event(), list[float]()

    def interrupt(now: Tally) -> None:
        if now.played == 1:
            stop.set()
            stopped_s.append(time.monotonic())

    with pytest.raises(Interrupted, match="--resume"):
        _play(cluster.address, store, interrupt, stop)
    assert time.monotonic() - stopped_s[0] < 3.0
    with Client(cluster.address, set_as_default=False) as client:
        assert sum(map(len, client.processing().values())) <= 2  # what was begun; the rest is cancelled

    def kill(now: Tally) -> None:
        if now.played == 1:
            cluster.processes[1].kill()

    _play(cluster.address, store, kill)
    assert results_digest(store) == reference
    cluster.wait_for_workers(1)


def test_nobody_or_nothing_there_is_one_line(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_pool, "CONNECT_WITHIN_S", 1.0)
    for address in (f"tcp://127.0.0.1:{free_port()}", "nonsense://x", "127.0.0.1"):
        with pytest.raises(RunFailed, match="no Dask scheduler at") as failed:
            _play(address, in_memory())
        assert "\n" not in str(failed.value)
    for worker in cluster.processes[1:]:
        worker.kill()
    cluster.wait_for_workers(0)
    with pytest.raises(RunFailed, match="has no workers"):
        _play(cluster.address, in_memory())
