"""Commands to a run on real processes, by the command line and over HTTP; what it was is played again to the bit."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from cogradar.services import kernels
from cogradar.services.analysis.replay import replay
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.client import open_store
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import command as commanding
from cogradar.services.runs.command import command_on
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.web.address import COMMAND_VARIABLE
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.cli.here import here
from tests.skies import small_sky

TOWERS = "c0mmander-of-the-tower"
RATE_HZ = 10.0


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Launcher, Path]]:
    """Services with HTTP and one commander, and the store that they keep."""
    monkeypatch.setenv(COMMAND_VARIABLE, f"tower:{TOWERS}")
    kernels.compile_all(lambda _: None)
    store = tmp_path / "runs.db"
    with Launcher(LocalProcesses(1, str(store), http="127.0.0.1:0"), threading.Event()) as launcher:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        yield launcher, store


def _until(condition: Callable[[], bool], within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _command(run: str, action: str, endpoint: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "cogradar", "command", run, *action.split(), "--connect", endpoint]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False, env=os.environ)


@pytest.mark.parametrize("run", ["", "a b", "--"])
def test_what_is_no_name_of_a_run_is_said(run: str) -> None:
    with pytest.raises(BadInput, match=f"run = {run!r}: "):
        command_on("tcp/127.0.0.1:1", run, ["end"])


@pytest.mark.parametrize(
    ("at", "told"),
    [("861", ", the first that can still obey: dwell 861 is too soon\n"), ("863", "\n"), ("0", "\n")],
)
def test_a_command_that_comes_later_than_it_was_asked_for_says_so(
    at: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commanding, "command_on", lambda *_: {"action": "pause", "k": 863})
    assert here("command", "r", "pause", "--at", at).stdout == f"r: pause from dwell 863 on{told}"


@pytest.mark.zenoh
def test_a_run_is_commanded_ends_by_a_command_and_is_played_again(system: tuple[Launcher, Path]) -> None:
    launcher, store = system
    start = RunStart.of(small_sky("radar.search.beams=4"), Strategy.POWER_AWARE, 1, 100_000, RATE_HZ)
    run = start.run
    distributed.start_on(launcher.endpoint, start, notify=lambda _: None, stop=threading.Event())
    assert launcher.url is not None
    with httpx.Client(base_url=f"{launcher.url}/api/v1/runs", timeout=30.0) as web:

        def post(action: dict[str, Any]) -> httpx.Response:
            return web.post(f"{run}/commands", json={"action": action}, headers={"Authorization": f"Bearer {TOWERS}"})

        _until(lambda: web.get(run).json()["t"] > 5)
        granted = post({"kind": "power", "share": 0.5})
        assert (granted.status_code, granted.json()["by"]) == (201, "tower")
        done = _command(run, "sector blank -90 -5", launcher.endpoint)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(f"{run}: sector blank -90 -5 from dwell ")
        assert post({"kind": "look", "bearing_deg": 30.0, "dwells": 5, "share": 0.2}).status_code == 201
        refused = _command(run, "drop 5000", launcher.endpoint)
        assert refused.returncode == 2
        said = rf"{run}: refused: there is no track 5000; those that are there: [\d, ]+( and \d+ more)?\n"
        assert re.fullmatch(said, refused.stderr)
        last = web.get(f"{run}/commands").json()["rows"][2]["k"] + 10
        _until(lambda: web.get(run).json()["k"] > last)

        def states() -> list[str]:
            return [row["state"] for row in web.get(f"{run}/commands").json()["rows"]]

        _until(lambda: states() == ["in force", "in force", "over", "refused"])  # on a busy machine waveforms are late
        assert post({"kind": "end"}).status_code == 201
        _until(lambda: web.get(run).json()["status"] == "complete")
        late = _command(run, "power 0.5", launcher.endpoint)
        assert (late.returncode, late.stderr) == (2, f"run = '{run}': has ended already (complete)\n")
        rows = web.get(f"{run}/commands").json()["rows"]
    assert [row["by"] for row in rows][::2] == ["tower"] * 3
    opened = open_store(str(store))
    try:
        ask = partial(answer, opened)
        ended = rows[4]["k"]
        (row,) = ask("runs", {"run": run})
        assert row["k"] == ended - 1
        outcome = replay(StoredRun(ask, run), "allocator")
        assert outcome.difference is None
        assert outcome.agreed > ended // 3  # on a busy machine many plans are late
    finally:
        opened.close()
