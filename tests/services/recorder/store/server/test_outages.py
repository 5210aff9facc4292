"""A server that ends, or is away: what waits for it, and goes on when it answers again."""

import threading
import time
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from cogradar.services import process
from cogradar.services.errors import NoStoreYet
from cogradar.services.metrics import core as following
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import postgresql
from cogradar.services.recorder.store.address import shown
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.services.topology import Start
from cogradar.shared.protocol.events import Tick
from cogradar.shared.wire.queries import NotNow
from cogradar.shared.wire.runner import Core
from tests.postgresql import running
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

START = smoke_start(dwells=20)


@pytest.mark.parametrize("mode", ["fast", "immediate"])
def test_a_run_outlives_a_restart_of_the_server(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgresql, "RETRY_S", 0.0)  # here time passes in ticks, of which a second has thousands
    expected = in_process.play(START).run["digest"]
    with running() as server:
        url = server.url()
        journal = Journal(url)
        network = FaultyNetwork(START, 2, np.random.default_rng(1), journal=journal)
        network.store = Store(Journal(url, read_only=True))

        def restart() -> None:
            server.stop(mode)
            recorder = network.processes["recorder-0"].core
            assert isinstance(recorder, Recorder)
            for i in range(3 * LOOK_TICKS):
                recorder.handle(Tick(100.0 + i))
            assert "all runs are held" in recorder.trouble
            server.start()

        assert play(network, {60: restart, 150: restart}) == expected
        network.store.close()
        journal.close()


def test_one_that_stands_by_outlives_a_restart_of_the_server_and_takes_over(caplog: pytest.LogCaptureFixture) -> None:
    with running() as server:
        first, looks = Journal(server.url("runs")), count()

        def check() -> None:
            look = next(looks)
            if look == 0:
                server.stop()
            elif look == 1:
                server.start()
                first.close()

        start = Start("recorder-1", store=server.url("runs"), check=check)
        cast("Journal", process._made(lambda start: cast("Core", Journal(start.store)), start)).close()
        with pytest.raises(NoStoreYet):  # who has not begun to stand by is refused
            process._made(
                lambda start: cast("Core", Journal(start.store)), replace(start, store=server.url() + "&port=1")
            )
    assert "stands by until it answers again" in caplog.text


@pytest.mark.slow
@pytest.mark.zenoh
def test_real_processes_outlive_a_restart_of_the_server_with_the_same_digest() -> None:
    """Metrics, which asks for progress, and the recorder are cut off; no password is on a command line."""
    start = smoke_start(dwells=200)
    expected = in_process.play(start).run["digest"]
    with running() as server:
        url = server.url().replace("radar@", "radar:hunter2@")
        restarts = iter([None])

        def report(now: Progress) -> None:
            if now.t > 10 and next(restarts, now) is None:
                server.stop("immediate")
                server.start()
                for file in Path("/proc").glob("[0-9]*/cmdline"):
                    with suppress(OSError):  # it ended meanwhile
                        assert b"hunter2" not in file.read_bytes()

        played = cluster.play(
            start, LocalProcesses(2, url), report=report, notify=lambda _: None, stop=threading.Event()
        )
        assert played.run["digest"] == expected
        assert next(restarts, "done") == "done"


def test_a_server_that_is_away_at_first_is_told_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "RETRY_S", 0.0)
    with running() as server:
        url = server.url()
        server.stop()
        core = MetricsCore(url)
        for i in range(3):
            core.handle(Tick(1.0 * i))
        assert caplog.text.count("there is no journal yet") == 1
        server.start()
        Journal(url).close()
        core.handle(Tick(9.0))
        assert (core.trouble, core.is_open) == ("", True)
        core.close()


def test_metrics_says_that_a_server_is_away_and_goes_on_when_it_is_back() -> None:
    with running() as server:
        url = server.url()
        Journal(url).close()
        core = MetricsCore(url)
        core.handle(Tick(0.0))
        assert (core.trouble, core.answer("runs", {})) == ("", b"[]")
        server.stop()
        core.handle(Tick(1.0))
        assert core.trouble.startswith(f"held: {shown(url)}: ")
        with pytest.raises(NotNow):
            core.answer("runs", {})
        assert "journal_bytes" not in core.measures()
        server.start()
        time.sleep(0.5)  # until it is asked again
        core.handle(Tick(2.0))
        assert (core.trouble, core.answer("runs", {})) == ("", b"[]")
        assert core.measures()["journal_bytes"]
        core.close()
