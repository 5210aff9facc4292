"""Much is asked: answers come at once. It wants an idle machine."""

import random
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from cogradar.services import kernels
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import Recording
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.web.address import listen, url
from cogradar.services.web.server import Server
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.scored import scores as scored
from tests.services.web.long_run import long_run

RUNS = "/api/v1/runs"
pytestmark = [pytest.mark.nightly, pytest.mark.zenoh]


def _fill(path: Path, n_run: int, dwells: int) -> list[str]:
    """A store of finished runs with made-up scores; their names."""
    journal, paper, rng = Journal(str(path)), load("paper"), random.Random(1)  # noqa: S311 - a test's own numbers
    names = []
    for i in range(n_run):
        start = RunStart.of(paper, list(Strategy)[i % 3], i // 3 + 1, dwells)
        journal.add_run(start)
        journal.acknowledge(start.run, dwells + 10, dwells, 0)
        (row,) = journal.read("SELECT * FROM run WHERE run = ?", [start.run])
        scores = [
            (
                *(start.run, t + 9, t, target, target, 5, rng.choice([4, 5, 5]), rng.random() < 0.9),
                *(rng.random() for _ in range(11)),
                *(1.0, 0, 0),
                *(True, 5, 0, *(5 * [None]), "[[5,0.3]]"),
            )
            for t in range(1, dwells + 1)
            for target in range(1, paper.radar.announced + 1)
        ]
        journal.write("DELETE FROM run WHERE run = ?", start.run)
        journal.add_recording(Recording(row | {"status": "complete", "digest": "0"}, scored(scores), [], []), i + 1)
        names.append(start.run)
    journal.close()
    return names


@contextmanager
def _services(store: Path) -> Iterator[tuple[str, str]]:
    """Services that are up: endpoint of the router, address of HTTP."""
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(2, str(store), http="127.0.0.1:0"), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        assert launcher.url is not None
        yield launcher.endpoint, launcher.url


def test_300_000_target_dwells_are_asked_in_200_ms_while_ten_runs_are_written(tmp_path: Path) -> None:
    names = _fill(tmp_path / "runs.db", 334, 300)
    with _services(tmp_path / "runs.db") as (endpoint, address):
        bus = ZenohBus(open_session([endpoint], 15.0, lambda: None), Role.OPERATOR, "operator-load", reads=False)
        for seed in range(10):
            bus.publish(RunStart.of(load("smoke"), Strategy.POWER_AWARE, seed + 1, 100_000, 10.0))
        paths = ["", *(f"/{run}/{metric}" for run in (names[7], "all") for metric in ("p_d", "rmse", "summary"))]
        paths += [f"/all/{metric}?dwells=1:250&scenario=paper" for metric in ("p_d", "rmse")]
        paths += ["/all/tracks", "/all/tracks?offset=150000", "/all/tracks?scenario=paper&offset=299600"]
        paths += [f"/{names[7]}/tracks", "/all/summary?offset=1", f"/{names[7]}/summary?dwells=7:290"]
        with httpx.Client(base_url=address, timeout=60.0) as client:
            _wait_until(lambda: sum(r["t"] > 0 for r in client.get(f"{RUNS}?scenario=smoke").json()["rows"]) == 10)
            for path in paths:  # the scores of the past, once
                assert client.get(f"{RUNS}{path}").status_code == 200
            took = {path: sorted(_time(client, f"{RUNS}{path}") for _ in range(9)) for path in paths}
            last = client.get(f"{RUNS}/all/tracks?scenario=paper&offset=299600").json()
            before = {r["run"]: r["t"] for r in client.get(f"{RUNS}?scenario=smoke").json()["rows"]}
            time.sleep(5.0)
            after = {r["run"]: r["t"] for r in client.get(f"{RUNS}?scenario=smoke").json()["rows"]}
        bus.close()
    assert len(last["rows"]) == 1000
    assert last["next"] is None
    assert all(after[run] - before[run] >= 40 for run in before)  # 10 Hz
    assert {path: times for path, times in took.items() if times[4] > 0.2} == {}


def test_any_dwell_of_a_stored_run_of_20_000_takes_100_ms_and_any_chart_200(tmp_path: Path) -> None:
    core = MetricsCore(str(long_run(tmp_path / "long.db", 20_000)))
    core.store.derive()  # metrics does so while nobody asks
    listener = listen("127.0.0.1:0")
    assert listener is not None
    server = Server(core, listener)
    dwells = [f"dwells?dwells={t}:{t}" for t in (1, 10_000, 14_999, 20_000, 257)]
    charts = ["timeline", "course?target=1", "course?target=2&dwells=19000:20000", "course?target=3&dwells=:9000"]
    took = {}
    with httpx.Client(base_url=f"{url(listener)}{RUNS}/long/", timeout=60.0) as client:
        assert client.get("dwells").status_code == 200
        for path in (*dwells, *charts):
            if path in charts:  # dwells are kept: the first answer counts
                assert client.get(path).status_code == 200
                time.sleep(0.6)  # answers of half a second ago are given again
            took[path] = _time(client, path)
    server.close()
    core.close()
    assert {path: s for path, s in took.items() if s > (0.1 if path in dwells else 0.2)} == {}


def _time(client: httpx.Client, path: str) -> float:
    began = time.monotonic()
    client.get(path)
    return time.monotonic() - began


def _wait_until(done: Any) -> None:
    deadline = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.2)
