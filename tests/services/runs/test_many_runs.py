"""More runs at once than a system of one process a role used to take: all are the runs that they are alone."""

import pytest

from cogradar.services.metrics.store import in_memory
from cogradar.services.runs import in_process
from cogradar.services.topology import Start
from cogradar.shared.wire.bus import LocalNetwork
from tests.services.loop import smoke_start

RUNS = 300


@pytest.mark.nightly
def test_three_hundred_runs_at_once() -> None:
    starts = [smoke_start(dwells=1, seed=1 + i % 3, run=f"run-{i:03d}") for i in range(RUNS)]
    store, network = in_memory(), LocalNetwork()
    endpoints = in_process._endpoints(network, starts[0], store, 1, Start(""))
    for start in starts:
        network.deliver(start)
    while sum(in_process._take_turn(core, bus, None) for core, bus in endpoints):
        pass
    rows = store.journal.read("SELECT run, status, digest FROM run ORDER BY run")
    assert [row["status"] for row in rows] == ["complete"] * RUNS
    assert [row["digest"] for row in rows[-3:]] == [in_process.play(start).run["digest"] for start in starts[-3:]]
