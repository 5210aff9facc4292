"""A server that comes back with an older state while its recorder waits: runs in lockstep are rewound."""

from contextlib import ExitStack, closing

import numpy as np
import pytest

from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import postgresql
from cogradar.services.runs import in_process
from cogradar.shared.protocol.events import Tick
from tests.postgresql import running
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

START = smoke_start(dwells=60)


def test_a_run_comes_to_the_same_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgresql, "RETRY_S", 0.0)
    with running() as server, ExitStack() as opened:
        url = server.url()
        journal = opened.enter_context(closing(Journal(url)))
        network = FaultyNetwork(START, 2, np.random.default_rng(1), journal=journal)
        network.store = opened.enter_context(closing(Store(Journal(url, read_only=True))))
        recorder = network.processes["recorder-0"].core
        assert isinstance(recorder, Recorder)

        def acknowledged() -> int:
            return max((row["k"] for row in network.store.read("SELECT acknowledged_k AS k FROM run")), default=-1)

        def go_on_until(k: int) -> None:
            while acknowledged() < k:
                if not network.step():
                    network.tick()

        def hold() -> None:
            for i in range(3 * LOOK_TICKS):
                for message in recorder.handle(Tick(100.0 + i)):
                    network.publish("recorder-0", message)
            assert recorder.trouble

        go_on_until(16)
        server.stop()
        hold()
        server.back_up()
        server.start()
        go_on_until(48)
        server.stop()
        hold()
        server.restore()
        server.start()
        assert acknowledged() < 48
        assert play(network, {}) == in_process.play(START).run["digest"]
