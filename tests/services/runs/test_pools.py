"""Real processes, two of each role that is a pool: runs are spread over them, and whichever is killed, they are the
same runs.
"""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from cogradar.services import kernels
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import Checkpoint, RunStart
from cogradar.shared.protocol.topics import Role, shard_of
from cogradar.shared.wire.queries import ask_expositions
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.loop import smoke_start

RUNS, DWELLS, WITHIN_S = 5, 120, 120.0
VICTIMS = ("emulator-0", "allocator-1", "emulator-1", "allocator-0")

pytestmark = pytest.mark.zenoh


class _Followed:
    """How far runs are, as checkpoints say."""

    def __init__(self, bus: ZenohBus, launcher: Launcher, starts: list[RunStart]) -> None:
        self._bus, self._launcher = bus, launcher
        self.k = {start.run: -1 for start in starts}
        self.ended: set[str] = set()
        self._until_s = time.monotonic() + WITHIN_S
        bus.publish(*starts)

    def follow(self) -> None:
        """The next checkpoint; what was killed is started again."""
        assert time.monotonic() < self._until_s, self.k
        self._launcher.check()
        event = self._bus.receive(0.1)
        if isinstance(event, Checkpoint) and event.run in self.k:
            self.k[event.run] = max(self.k[event.run], event.k)
            self.ended |= {event.run} if event.ended else set()


@contextmanager
def _system(store: Path) -> Iterator[tuple[Launcher, Session, ZenohBus]]:
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(1, str(store), pool=2), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        session = open_session([launcher.endpoint], 10.0, lambda: None)
        with closing(ZenohBus(session, Role.OPERATOR, "test")) as bus:
            yield launcher, session, bus


def _held(session: Session) -> dict[str, int]:
    """How many shards each process says that it serves."""
    held = {}
    for (_, name), text in ask_expositions(session, 5.0, 1 << 20):
        for line in text.decode().splitlines():
            if line.startswith("cogradar_shards_held "):
                held[name] = int(float(line.split()[1]))
    return held


def test_whichever_is_killed_they_are_the_same_runs(tmp_path: Path) -> None:
    starts = [smoke_start(seed=i, dwells=DWELLS, run=f"run-{i}") for i in range(RUNS)]
    with _system(tmp_path / "runs.db") as (launcher, session, bus):
        until_s = time.monotonic() + WITHIN_S
        while _held(session) != dict.fromkeys(VICTIMS, 8):
            assert time.monotonic() < until_s, _held(session)
        followed = _Followed(bus, launcher, starts)
        for victim in VICTIMS:
            at = sum(followed.k.values())
            while sum(followed.k.values()) < at + 32:
                followed.follow()
            launcher.signal(victim, signal.SIGKILL)
        while len(followed.ended) < RUNS:
            followed.follow()
        with closing(Journal(str(tmp_path / "runs.db"), read_only=True)) as journal:
            rows = journal.read("SELECT run, status, digest, conflicts FROM run ORDER BY run")
    assert len({shard_of(start.run) for start in starts}) > 1
    assert rows == [
        {"run": start.run, "status": "complete", "digest": in_process.play(start).run["digest"], "conflicts": 0}
        for start in starts
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("rate_hz", [0.0, 5.0])
def test_what_was_frozen_says_nothing_of_the_runs_that_others_took(rate_hz: float, tmp_path: Path) -> None:
    """In real time each dwell is transmitted by one of the two, before and after it wakes."""
    starts = [smoke_start(seed=i, dwells=100, run=f"run-{i}").model_copy(update={"rate_hz": rate_hz}) for i in range(4)]
    store = tmp_path / "runs.db"
    with _system(store) as (launcher, _, bus):
        followed = _Followed(bus, launcher, starts)
        while min(followed.k.values()) < 16:
            followed.follow()
        for victim in ("emulator-0", "allocator-1"):
            launcher.signal(victim, signal.SIGSTOP)
        woken_s = time.monotonic() + 6.0
        while time.monotonic() < woken_s:
            followed.follow()
        for victim in ("emulator-0", "allocator-1"):
            launcher.signal(victim, signal.SIGCONT)
        while len(followed.ended) < len(starts):
            followed.follow()
        for victim in ("emulator-0", "allocator-1"):
            while f"{victim} was away, and others may serve its runs" not in launcher._tail(victim):
                followed.follow()
        with closing(Journal(str(store), read_only=True)) as journal:
            rows = journal.read("SELECT run, status, conflicts, acknowledged_k AS k, digest FROM run ORDER BY run")
            scans = journal.read("SELECT COUNT(*) AS n FROM message WHERE topic = 'scan' GROUP BY run")
    assert [row["status"] for row in rows] == ["complete"] * len(starts)
    assert [row["conflicts"] for row in rows] == [0] * len(starts)
    if rate_hz:  # a lease, half a second, and some
        assert all(row["k"] - scan["n"] < 5.0 * rate_hz for row, scan in zip(rows, scans, strict=True))
    else:
        assert [row["digest"] for row in rows] == [in_process.play(start).run["digest"] for start in starts]
