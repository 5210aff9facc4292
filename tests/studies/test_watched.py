"""Runs that are watched, against runs alone."""

import multiprocessing
import threading

import pytest

from cogradar.services import kernels
from cogradar.services.errors import Interrupted, RunFailed
from studies.processes import watched
from studies.processes.http_clients import KINDS

PAIRS, DWELLS = 1, 150


@pytest.mark.nightly
@pytest.mark.zenoh
def test_clients_are_served_and_frozen_ones_end_no_run() -> None:
    kernels.compile_all(lambda _: None)
    kinds = (next(iter(KINDS)), watched.FROZEN_METRICS)
    notified: list[str] = []
    clients, frozen = watched.measure(PAIRS, DWELLS, notified.append, threading.Event(), kinds)
    assert notified == [f"pair 1 of 1: {kind}" for kind in kinds]
    assert (clients.by, frozen.by) == kinds
    assert min(clients.served["answers"], clients.served["events"]) >= 1.0  # they run at the lowest priority
    for row in (clients, frozen):
        assert 0.0 < row.low <= row.ratio <= row.high
        assert row.alone_hz > 0.0
    assert [row["by"] for row in watched.table([clients, frozen]).rows] == list(kinds)


def test_clients_that_die_end_the_bench() -> None:
    """Also those that do not answer: whoever asks for a stop need not wait for them."""
    kind, others, stop = next(iter(KINDS)), multiprocessing.active_children(), threading.Event()
    died = pytest.raises(RunFailed, match="the process of these clients died")
    with died, watched.clients(kind, "http://127.0.0.1:1", "nobody", stop):
        (process,) = set(multiprocessing.active_children()) - set(others)
        process.kill()
    stop.set()
    with pytest.raises(Interrupted), watched.clients(kind, "http://127.0.0.1:1", "nobody", stop):
        pass
    assert multiprocessing.active_children() == others
