"""Many ask and many listen: answers come at once, and no run waits for them. It wants an idle machine."""

import os
import random
import statistics
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from services import kernels
from services.metrics.core import MetricsCore
from services.recorder.journal import Journal, Recording
from services.runs import cluster
from services.runs.launcher import Launcher
from services.web.address import listen, url
from services.web.server import Server
from shared.protocol.messages import Message, Plan, RunStart, Scan, Truth, Waveform
from shared.protocol.topics import BY_MESSAGE, Role
from shared.scenario.files import load
from shared.scenario.radar_config import Strategy
from shared.signal.array import angle_bin, spatial_frequency
from shared.wire.codec import encode
from shared.wire.session import open_session
from shared.wire.zenoh_bus import ZenohBus
from tests.samples import asked

RUNS = "/api/v1/runs"
pytestmark = [pytest.mark.nightly, pytest.mark.zenoh]


def _fill(path: Path, n_run: int, dwells: int) -> list[str]:
    """A store of finished runs with made-up scores; their names."""
    journal, paper, rng = Journal(str(path)), load("paper"), random.Random(1)  # noqa: S311 - a test's own numbers
    names = []
    for i in range(n_run):
        start = RunStart.of(paper, list(Strategy)[i % 3], i // 3 + 1, dwells)
        journal.add_run(start, paper.radar.tracks)
        journal.acknowledge(start.run, dwells + 10, dwells)
        (row,) = journal.read("SELECT * FROM run WHERE run = ?", [start.run])
        scores = [
            (
                *(start.run, t + 9, t, target, target, 5, rng.choice([4, 5, 5]), rng.random() < 0.9),
                *(rng.random() for _ in range(10)),
                *(1.0, 0, 0),
                *(True, 5, 0, "[[5,0.3]]"),
            )
            for t in range(1, dwells + 1)
            for target in range(1, paper.radar.tracks + 1)
        ]
        journal.write("DELETE FROM run WHERE run = ?", start.run)
        journal.add_recording(Recording(row | {"status": "complete", "digest": "0"}, scores, []), i + 1)
        names.append(start.run)
    journal.close()
    return names


@contextmanager
def _services(store: Path) -> Iterator[tuple[str, str]]:
    """Services that are up: endpoint of the router, address of HTTP."""
    kernels.compile_all(lambda _: None)
    with Launcher(2, str(store), threading.Event(), http="127.0.0.1:0") as launcher:
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
    core = MetricsCore(str(_long_run(tmp_path / "long.db", 20_000)))
    core.store.derive()  # metrics does so while nobody asks
    listener = listen("127.0.0.1:0")
    assert listener is not None
    server = Server(core, listener)
    dwells = [f"dwells?dwells={t}:{t}" for t in (1, 10_000, 14_999, 20_000, 257)]
    charts = ["timeline", "history?target=1", "history?target=2&dwells=19000:20000", "history?target=3&dwells=:9000"]
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


def _long_run(path: Path, dwells: int) -> Path:
    """A store with a finished run whose tracks never move; its messages are as long as those of the paper's."""
    journal, paper, acquisition = Journal(str(path)), load("paper"), 10
    start, radar = RunStart.of(paper, Strategy.POWER_AWARE, 1, dwells).model_copy(update={"run": "long"}), paper.radar
    states, tracks = paper.simulated.initial_states(), range(radar.tracks)
    journal.add_run(start, radar.tracks)
    bins = angle_bin(spatial_frequency(states), radar.array.n_bin).astype(np.int32)
    for k in range(dwells + acquisition):
        t = max(0, k - acquisition + 1)
        cells = bins if t else np.arange(radar.array.n_bin, dtype=np.int32)
        order, n, is_tracking = np.sort(cells), len(cells), k >= acquisition - 1
        head: dict[str, Any] = {"run": "long", "k": k}
        beams = (bins if is_tracking else np.full_like(bins, -1))[:, np.newaxis]
        said: list[Message] = [
            Scan(
                **head,
                t=t,
                bins=order,
                statistic=np.full(n, 40.0),
                alpha_hat=np.ones(n, dtype=np.complex64),
                sigma_hat=np.ones(n),
                signature_power=np.full(n, 100.0),
                beams=(bins if t else np.full_like(bins, -1))[:, np.newaxis],
            ),
            Truth(**head, t=t, states=states, bins=bins, snr_db=np.full(len(bins), -14.0), waveform_k=k - 1),
            Waveform(
                **head,
                tracking=is_tracking,
                isotropic=0.0,
                factor=np.ones((radar.array.n_tx, len(bins)), dtype=np.complex64),
                beams=beams,
                shares=np.full((len(bins), 1), 0.3),
                status="optimal" if is_tracking else "acquisition",
                late=np.zeros_like(bins),
            ),
        ]
        for m in tracks:
            status: Any = "tracking" if is_tracking else "searching"
            wanted = asked(int(bins[m])) if is_tracking else {}
            said.append(Plan(**head, t=t, target=m, status=status, **wanted, estimate=states[m] + 0.1))
        for message in said:
            item = message.target + 1 if isinstance(message, Plan) else 0
            journal.add_message("long", k, BY_MESSAGE[type(message)].name, item, encode(message))
    journal.acknowledge("long", dwells + acquisition, dwells)
    journal.write("UPDATE run SET status = 'complete', digest = '0'")
    journal.close()
    return path


def _time(client: httpx.Client, path: str) -> float:
    began = time.monotonic()
    client.get(path)
    return time.monotonic() - began


def _wait_until(done: Any) -> None:
    deadline = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.2)


def test_50_clients_who_ask_and_listen_slow_no_run_by_more_than_5_percent(tmp_path: Path) -> None:
    """Runs with and without them, in turns; the clients are at the lowest priority, as if on another machine."""
    ratios = []
    with _services(tmp_path / "runs.db") as (endpoint, address):
        play = partial(cluster.play_on, report=lambda _: None, notify=lambda _: None, stop=threading.Event())
        for seed in range(1, 7):
            rates = {}
            for crowd in (seed % 2 == 0, seed % 2 == 1):
                start = RunStart.of(load("paper"), Strategy.POWER_AWARE, seed, 300)
                with _clients(50 if crowd else 0, address, start.run):
                    rates[crowd] = 300 / play(endpoint, start).elapsed_s
            ratios.append(rates[True] / rates[False])
    assert statistics.median(ratios) > 0.95, ratios


@contextmanager
def _clients(n: int, address: str, run: str) -> Iterator[None]:
    """So many clients of a run: each asks once a second, and listens. At the end all have had answers and events."""
    stop, had = threading.Event(), Counter[str]()

    def ask() -> None:
        with suppress(OSError):
            os.nice(19)  # this thread
        with httpx.Client(base_url=address, timeout=30.0) as client:
            while not stop.wait(1.0):
                had["answers"] += client.get(f"{RUNS}/{run}/summary").status_code == 200

    def listen() -> None:
        with suppress(OSError):
            os.nice(19)
        with httpx.Client(base_url=address, timeout=30.0) as client:
            while not stop.wait(0.1):
                with client.stream("GET", f"{RUNS}/{run}/events") as stream:
                    for line in stream.iter_lines():
                        had["events"] += line.startswith("id:")
                        if stop.is_set():
                            break

    threads = [threading.Thread(target=work) for _ in range(n) for work in (ask, listen)]
    for thread in threads:
        thread.start()
    yield
    stop.set()
    for thread in threads:
        thread.join()
    assert had["answers"] >= 2 * n
    assert had["events"] >= 10 * n
