"""What a run opens ends with it: a process has as many files, sockets and threads after many runs as after one."""

import gc
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import cogradar

RUNS, DWELLS = 25, 2
OPEN = Path("/dev/fd")  # of Linux and macOS


@pytest.fixture
def uncollected() -> Iterator[None]:
    """Things in circles are kept: nothing that is open may wait until they are found."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("uncollected")
@pytest.mark.skipif(not OPEN.exists(), reason="the system does not show what a process has open")
@pytest.mark.parametrize("kind", ["in memory", "stored", "replayed", "given up"])
def test_many_runs_leave_no_more_open_than_one(kind: str, tmp_path: Path) -> None:
    store = tmp_path / "runs.db"
    cogradar.run("smoke", dwells=DWELLS, store=store)
    kinds: dict[str, dict[str, Any]] = {"stored": {"store": store}, "replayed": {"front_end": f"recorded:{store}"}}
    counts = []
    for seed in range(1, RUNS + 1):
        if kind == "given up":
            next(cogradar.play("smoke", seed=seed, dwells=DWELLS, store=store))
        else:
            result = cogradar.run("smoke", seed=seed, dwells=DWELLS, **kinds.get(kind, {}))
            assert len(result.t) == DWELLS
            del result
        counts.append((len(list(OPEN.iterdir())), threading.active_count()))
    assert counts[-1] == counts[0]
