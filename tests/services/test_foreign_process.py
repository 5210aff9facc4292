"""The front end of deploy/front-end as a process of its own: killed and started again while the radar goes on."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from cogradar.services import kernels
from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs.continuity import continuity
from cogradar.shared.protocol.messages import RunStart, Scan, roster_of
from cogradar.shared.wire.codec import decode
from cogradar.shared.wire.session import free_port

REPOSITORY = Path(__file__).resolve().parents[2]
SCENARIO = (REPOSITORY / "deploy/scenarios/smoke.toml").read_text(encoding="utf-8")
EXAMPLE = REPOSITORY / "deploy/front-end/zenoh_front_end.py"
RATE_HZ = 5
BEFORE, BETWEEN = 30, 20  # dwells: until the first kill, and from one to the next


@contextmanager
def _front_end(endpoint: str) -> Iterator[None]:
    """The process, until it is killed."""
    command = [sys.executable, str(EXAMPLE), "roof", "--listen", endpoint]
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
