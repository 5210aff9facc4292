"""How long one dwell of a whole run takes, in one process and over Zenoh; their difference is the transport's.

And how long its scores take afterwards.
"""

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import MEMORY
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.messages import RunStart, Waveform
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.runner import serve
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus

SEED = 1
DWELLS = 60  # tracking dwells of the run
CONNECT_WITHIN_S = 15.0


def paper_run() -> RunStart:
    """The run whose dwells the two cases time."""
    return RunStart.of(load("paper"), Strategy.POWER_AWARE, SEED, DWELLS)


class _TimedJournal(Journal):
    """A journal that notes when each waveform comes: one marks every dwell."""

    def __init__(self) -> None:
        super().__init__(MEMORY)
        self.stamps: dict[int, float] = {}

    def add_message(self, run: str, k: int, topic: str, item: int, payload: bytes) -> bool:
        if topic == "waveform":
            self.stamps[k] = time.perf_counter()
        return super().add_message(run, k, topic, item, payload)


class _TimingCore:
    """Notes when each waveform comes, and sends nothing."""

    def __init__(self) -> None:
        self.stamps: dict[int, float] = {}

    def handle(self, event: Event) -> Sequence[Any]:
        """Take the time."""
        if isinstance(event, Waveform):
            self.stamps[event.k] = time.perf_counter()
        return ()


def _dwell_times(stamps: dict[int, float], dwells: int) -> list[float]:
    """Times from waveform to waveform over the tracking dwells, ms. The acquisition, which tests all cells, comes
    before. The first tracking waveform is the last answer to an acquisition scan.
    """
    tracking = [stamps[k] for k in sorted(stamps)][-dwells - 1 :]
    return [1e3 * (after - before) for before, after in pairwise(tracking)]


def in_one_process(start: RunStart, stop: threading.Event | None = None) -> list[float]:
    """Times of the tracking dwells of a run with all cores in this process, ms."""
    journal = _TimedJournal()
    in_process.play(start, store=Store(journal), stop=stop)
    return _dwell_times(journal.stamps, start.dwells)


def over_zenoh(start: RunStart) -> list[float]:
    """Times of the tracking dwells of a run with a process per role, ms; a second emulator receives its waveforms."""
    core, stop = _TimingCore(), threading.Event()
    with Launcher(LocalProcesses(1), stop) as launcher:
        distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        bus = ZenohBus(open_session([launcher.endpoint], CONNECT_WITHIN_S, launcher.check), Role.EMULATOR, "bench")
        listener = threading.Thread(target=serve, args=(core, bus, stop, bus.meter))
        listener.start()
        try:
            distributed.play_on(launcher.endpoint, start, report=lambda _: None, notify=lambda _: None, stop=stop)
        finally:
            stop.set()
            listener.join()
            bus.close()
    return _dwell_times(core.stamps, start.dwells)


def scoring(start: RunStart, repeat: Callable[[Callable[[int], object]], list[float]]) -> list[float]:
    """Times that the scores of a stored run take, for each of its tracking dwells, ms."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "runs.db")
        with closing(Store(Journal(path))) as store:
            in_process.play(start, store=store)

        def derive(_: int) -> None:
            with closing(Store(Journal(path, read_only=True))) as reader:
                reader.derive()

        return [took / start.dwells for took in repeat(derive)]
