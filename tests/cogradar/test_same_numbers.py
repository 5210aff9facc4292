"""However a question is asked, the numbers are the same: on the command line, over Zenoh and HTTP, in Python."""

import csv
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import cogradar
from cogradar.services.metrics.client import ask_service
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.wire.session import free_port

DWELLS = 20
COGRADAR = [sys.executable, "-m", "cogradar"]
Rows = list[dict[str, Any]]
Ask = Callable[[str, str, dict[str, str]], Rows]  # (endpoint, metric, parameters) -> rows
HTTP = f"127.0.0.1:{free_port()}"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("store") / "runs.db")
    store = Store(Journal(path))
    for strategy in (cogradar.Strategy.UNIFORM, cogradar.Strategy.POWER_AWARE):
        in_process.play(RunStart.of(cogradar.load("smoke"), strategy, 3, DWELLS), store=store)
    store.close()
    return path


@pytest.fixture(scope="module")
def endpoint(file: str) -> Iterator[str]:
    """A router behind which metrics answers for the store."""
    address = f"tcp/127.0.0.1:{free_port()}"
    commands = [["router", "--listen", address], ["metrics", "--connect", address, "--store", file, "--http", HTTP]]
    running = [subprocess.Popen([*COGRADAR, "service", *command], stderr=subprocess.DEVNULL) for command in commands]
    deadline = time.monotonic() + 30.0
    while True:
        try:
            cogradar.connect(address).runs()
            break
        except cogradar.NoMetrics:
            assert time.monotonic() < deadline
    yield address
    for process in running:
        process.terminate()
    assert [process.wait(timeout=10) for process in running] == [0, 0]


def _options(parameters: dict[str, str]) -> list[str]:
    return [part for name, value in parameters.items() for part in (f"--{name}", value)]


def _command_line(endpoint: str, metric: str, parameters: dict[str, str]) -> Rows:
    command = [*COGRADAR, "query", metric, *_options(parameters), "--connect", endpoint, "--json"]
    rows: Rows = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return rows


def _in_python(runs: cogradar.Runs, metric: str, parameters: dict[str, str]) -> Rows:
    asked: dict[str, Any] = {name: int(value) if value.isdecimal() else value for name, value in parameters.items()}
    if "dwells" in asked:
        asked["dwells"] = tuple(map(int, asked["dwells"].split(":")))
    rows: Rows = getattr(runs, metric)(**asked)
    return rows


def _python(endpoint: str, metric: str, parameters: dict[str, str]) -> Rows:
    return _in_python(cogradar.connect(endpoint), metric, parameters)


def _http(_: str, metric: str, parameters: dict[str, str]) -> Rows:
    """A run is part of the address there: the newest, if none is named, is the last of the list."""
    asked = dict(parameters)
    path = "/runs"
    if metric != "runs":
        listed = httpx.get(f"http://{HTTP}/api/v1/runs", params=asked).json()["rows"] if "run" not in asked else []
        path = f"/runs/{asked.pop('run', None) or listed[-1]['run']}/{metric}"
    rows: Rows = httpx.get(f"http://{HTTP}/api/v1{path}", params=asked).raise_for_status().json()["rows"]
    return rows


WAYS: dict[str, Ask] = {"command line": _command_line, "Zenoh": ask_service, "HTTP": _http, "Python": _python}


@pytest.mark.zenoh
@pytest.mark.parametrize("way", WAYS)
def test_answers_are_those_of_the_store(way: str, endpoint: str, file: str) -> None:
    with cogradar.open(file) as runs:
        newest = runs.runs(strategy="uniform")[0]["run"]
        questions: list[tuple[str, dict[str, str]]] = [
            ("runs", {"seed": "3", "limit": "1", "offset": "1"}),
            ("tracks", {"run": newest, "target": "2", "dwells": "4:9"}),
            ("tracks", {"run": "all", "limit": "7", "offset": "38"}),
            ("p_d", {"run": "all", "scenario": "smoke"}),
            ("rmse", {"strategy": "uniform"}),
            ("summary", {}),
            ("picture", {"run": "all", "strategy": "uniform"}),
        ]
        for metric, parameters in questions:
            expected = _in_python(runs, metric, parameters)
            assert expected
            assert WAYS[way](endpoint, metric, parameters) == expected


@pytest.mark.zenoh
def test_a_run_over_zenoh_is_the_run_in_the_store(endpoint: str, file: str, tmp_path: Path) -> None:
    """Arrays, and what is written of them."""
    here, there = cogradar.open(file), cogradar.connect(endpoint).result()
    stored = here.result()
    for name in ("true_states", "estimates", "covariance", "statistics", "alpha_hat", "factors", "shares", "bins", "t"):
        assert np.array_equal(getattr(there, name), getattr(stored, name), equal_nan=True), name
    assert np.array_equal(there.particles(2, DWELLS), stored.particles(2, DWELLS))
    assert there.digest == stored.digest
    for i, source in enumerate((["--connect", endpoint], ["--store", file])):
        subprocess.run([*COGRADAR, "export", *source, "--out", str(tmp_path / f"{i}.csv")], check=True)
    assert (tmp_path / "0.csv").read_bytes() == (tmp_path / "1.csv").read_bytes()
    rows = list(csv.DictReader(io.StringIO((tmp_path / "0.csv").read_text())))
    assert [float(row["x_hat"]) for row in rows] == stored.estimates[..., 0].ravel().tolist()
    replayed = subprocess.run([*COGRADAR, "replay", "--connect", endpoint, "--to", "allocator"], check=False)
    assert replayed.returncode == 0
    here.close()


@pytest.mark.zenoh
@pytest.mark.parametrize(
    ("metric", "parameters", "words"),
    [
        ("p_d", {"target": "3"}, "target = 3"),
        ("tracks", {"dwells": "1:99"}, "dwells = 99"),
        ("rmse", {"seed": "4"}, "seed = 4"),
    ],
)
def test_what_makes_no_sense_is_said_in_the_same_words(
    metric: str, parameters: dict[str, str], words: str, endpoint: str
) -> None:
    for ask in (ask_service, _python):
        with pytest.raises(cogradar.BadInput, match=words):
            ask(endpoint, metric, parameters)
    command = [*COGRADAR, "query", metric, *_options(parameters), "--connect", endpoint]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
