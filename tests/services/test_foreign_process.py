"""The front ends of deploy/front-end as processes of their own: killed and started again; the same run as simulated."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zenoh

from cogradar.services import kernels
from cogradar.services.errors import BadInput, RunFailed, StoreFailed
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.runs.continuity import continuity
from cogradar.shared.protocol.front_ends.messages import Opening, Transmit
from cogradar.shared.protocol.messages import RunStart, Scan, roster_of
from cogradar.shared.protocol.topics import DWELL, OPENING, Exchange
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.session import free_port, open_session
from tests.samples import sample

REPOSITORY = Path(__file__).resolve().parents[2]
SCENARIO = (REPOSITORY / "deploy/scenarios/smoke.toml").read_text(encoding="utf-8")
EXAMPLES = REPOSITORY / "deploy/front-end"
RATE_HZ = 5
BEFORE, BETWEEN = 30, 20  # dwells: until the first kill, and from one to the next


@contextmanager
def _front_end(endpoint: str, *options: str, example: str = "zenoh_front_end.py") -> Iterator[None]:
    """The process, until it is killed."""
    command = [sys.executable, str(EXAMPLES / example), "roof", "--listen", endpoint, *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        assert "is there" in process.stderr.readline()
        yield
    finally:
        process.kill()
        process.communicate()


def _dwells(store: Path) -> int:
    try:
        with closing(Journal(str(store), read_only=True)) as journal:
            return int(journal.read("SELECT COUNT(*) AS n FROM message WHERE topic = 'scan'", [])[0]["n"])
    except (BadInput, StoreFailed):
        return 0


def _wait_for(dwells: int, store: Path, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120.0
    while _dwells(store) < dwells:
        assert time.monotonic() < deadline
        assert run.poll() is None
        time.sleep(0.1)


def _asked(run: str) -> bytes:
    """A dwell of 16 x 16 channels and 1000 range cells: 2 MB of Y."""
    asked = sample(Transmit)
    cells = {"run": run, "factor": np.zeros((16, 1), np.complex64), "range_cells": np.arange(1000, dtype=np.int32)}
    return encode(asked.model_copy(update=cells))


@pytest.mark.parametrize("megabytes", ["0", "1", "16"])
def test_each_run_has_its_answers_or_is_told_to_open_again(megabytes: str) -> None:
    endpoint, radar = f"tcp/127.0.0.1:{free_port()}", load("smoke").radar.model_dump()
    with (
        _front_end(endpoint, "--shared-memory", megabytes),
        closing(open_session([endpoint], 9.0, lambda: None, shares_memory=True)) as session,
    ):

        def ask(exchange: Exchange, payload: bytes) -> zenoh.Reply:
            (reply,) = session.get(exchange.key_of("roof"), payload=payload, timeout=9.0)
            return reply

        for run in "ab":
            assert ask(OPENING, encode(Opening(run=run, radar=radar, dwells=9, rate_hz=0.0))).ok is not None
        for _ in range(20):  # sixteen fill the memory
            answer = ask(DWELL, _asked("b")).ok
            assert answer is not None
            assert len(answer.payload) == 8 * 1000 * 16 * 16
        refused = ask(DWELL, _asked("a")).err
        assert refused is not None
        assert refused.payload.to_string() == "run a is not open"


@pytest.mark.parametrize(
    ("seed", "dwells"), [(3, 5), *(pytest.param(seed, 300, marks=pytest.mark.nightly) for seed in (1, 2, 3))]
)
def test_the_world_of_paper_has_one_digest_in_numpy_and_simulated(seed: int, dwells: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    start = RunStart.of(load("paper"), Strategy.POWER_AWARE, seed, dwells)
    with _front_end(endpoint, "--seed", str(seed), example="paper_world.py"):
        no_world = start.model_copy(update={"scenario": start.scenario | {"world": None}})
        foreign = in_process.play(no_world, front_end=f"zenoh:roof@{endpoint}")
    assert foreign.run["digest"] == in_process.play(start).run["digest"]


def test_the_world_of_paper_refuses_a_radar_that_is_not_its_own() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    start = RunStart.of(load("smoke", ["radar.receiver.cells=steered"]), Strategy.POWER_AWARE, 1, 5)
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    with _front_end(endpoint, example="paper_world.py"), pytest.raises(RunFailed, match="cells must be bins"):
        in_process.play(start, front_end=f"zenoh:roof@{endpoint}")


def test_an_exception_of_a_front_end_reaches_the_run_with_file_and_line(tmp_path: Path) -> None:
    endpoint, world = f"tcp/127.0.0.1:{free_port()}", tmp_path / "mine.py"
    lines = [
        "import sys",
        f"sys.path.insert(0, {str(EXAMPLES)!r})",
        "from zenoh_front_end import World, serve",
        "class Mine(World):",
        "    def receive(self, dwell):",
        "        return super().receive(dwell) / (1 // 0)",
        "serve(Mine)",
    ]
    world.write_text("\n".join(lines))
    start = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, 5)
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    with (
        _front_end(endpoint, example=str(world)),
        pytest.raises(RunFailed, match=r"roof: mine\.py:6: ZeroDivisionError: .*by zero"),
    ):
        in_process.play(start, front_end=f"zenoh:roof@{endpoint}")


@pytest.mark.slow
@pytest.mark.zenoh
@pytest.mark.parametrize("kills", [2, pytest.param(10, marks=pytest.mark.nightly)])
def test_a_front_end_that_is_killed_and_started_again_ends_no_track(kills: int, tmp_path: Path) -> None:
    kernels.compile_all(lambda _: None)
    scenario, store, endpoint = tmp_path / "mine.toml", tmp_path / "mine.db", f"tcp/127.0.0.1:{free_port()}"
    scenario.write_text(SCENARIO[: SCENARIO.index("[world")])
    settings = ("radar.tracks=unknown", "radar.receiver.cells=steered", f"radar.motion.dt_s={1.0 / RATE_HZ}")
    command = [sys.executable, "-m", "cogradar", "run", str(scenario), "--front-end", f"zenoh:roof@{endpoint}"]
    command += ["--pace", "realtime", "--rate", str(RATE_HZ), "--dwells", str(BEFORE + kills * BETWEEN)]
    command += [part for one in settings for part in ("--set", one)] + ["--store", str(store), "--http", "off"]
    run: subprocess.Popen[str] | None = None
    for n in range(kills):
        with _front_end(endpoint):
            run = run or subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            _wait_for(BEFORE + n * BETWEEN, store, run)
    assert run is not None
    with _front_end(endpoint):
        said = run.communicate(timeout=120)[0]
    assert run.returncode == 0, said
    with closing(Journal(str(store), read_only=True)) as journal:
        (name,) = (row["run"] for row in journal.read("SELECT run FROM run", []))
        start = journal.start(name)
        assert isinstance(start, RunStart)
        found = continuity(journal, start, None)
        messages = [decode(payload) for _, _, payload in journal.dwells(name, ("scan", "plan"))]
    scans = [message for message in messages if isinstance(message, Scan)]
    rosters = [roster_of(scan) for scan in scans]
    confirmed = [set(roster.ids[roster.confirmed == 1].tolist()) for roster in rosters]
    outages = [scan.fault for before, scan in pairwise(scans) if before.fault is None and scan.fault is not None]
    assert len(outages) >= kills
    assert found.ended == 0
    assert confirmed[BEFORE - 1] & confirmed[-1]
    assert len(confirmed[-1]) >= 2
