"""How old a track is where it arrives: ASTERIX by UDP, a crowded sky in real time, with planners and all processes.

The front end is the simulated one with a receiver's clock. It states when a dwell is measured, because simulating the
echoes of a crowd takes longer than a receiver does; the table says how long. All processes, the feed and the other
system are on one machine, and so on one clock.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.emulator.front_end import FrontEndError, ScanData, Settings, Transmission
from cogradar.services.errors import RunFailed
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses, scratch
from cogradar.services.runs.run import as_played
from cogradar.services.skies.make import Asked, write
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins.kinds import SIGNAL
from cogradar.shared.scenario.plugins.resolver import resolve
from cogradar.shared.scenario.radar_config import Strategy

SEED, PLANNERS = 1, 2
MINUTES, RANGE_KM = 3, 100.0
SETTLED = 30  # dwells that are not counted: by then all aircraft are found
GOAL_MS, GOAL_SHARE = 200.0, 0.99
SKY = "COGRADAR_STUDY_SKY"  # variable: the scenario whose world the front end simulates
SITE = "48.35,11.79,450,60"
DAY_S = 86_400.0
DRAIN_S = 1.0  # for datagrams that are on their way when the run is over
MAX_DATAGRAM = 2048
OVER = "080"  # item of a track's status


class Clocked:
    """The simulated sky, with a receiver that knows the time."""

    def __init__(self, settings: Settings) -> None:
        """The world of the file that SKY names, as it was when the run began."""
        world = load(os.environ[SKY]).world
        if world is None:
            raise FrontEndError(f"{os.environ[SKY]}: has no [world]")
        self._scene = resolve(SIGNAL, world.signal)(world, settings.radar, SEED, 0)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Let the aircraft fly until t, and measure. The time is that of the last sample."""
        began_s = time.time()
        while self._scene.t < t:
            self._scene.move()
        measured = self._scene.observe(k, waveform.isotropic, waveform.factor, waveform.looks)
        utc_s = time.time()
        with _durations().open("a", encoding="ascii") as file:
            file.write(f"{1e3 * (utc_s - began_s)}\n")
        return replace(ScanData.of_looks(measured), utc_s=utc_s)

    def close(self) -> None:
        """There is nothing to switch off."""


def _durations() -> Path:
    """Where the front end notes how long it simulates, ms a dwell."""
    return Path(os.environ[SKY]).with_name("durations")


@dataclass(frozen=True)
class Ages:
    """What came of one run."""

    aircraft: int
    rate_hz: float
    dwells: int  # that count
    pictures: int  # of them that arrived
    tracks: float  # reported in a picture, mean
    p50_ms: float
    p99_ms: float
    most_ms: float
    simulated_ms: float  # that the echoes of a dwell took, median: before it is measured
    load: float  # of the machine meanwhile, its mean

    @classmethod
    def of(cls, asked: tuple[int, float, int], arrived: "Arrived", simulated_ms: Sequence[float], load: float) -> Self:
        """Of the reports of the last dwells; `asked` are aircraft, rate and dwells."""
        dwells = asked[2]
        times = list(dict.fromkeys(at_s for _, at_s in arrived))[-dwells:]  # a day may have ended in between
        counted = set(times)
        ages_ms = [1e3 * ((came_s - at_s) % DAY_S) for came_s, at_s in arrived if at_s in counted]
        if not ages_ms:
            raise RunFailed("no track has arrived")
        p50, p99 = np.quantile(ages_ms, (0.5, GOAL_SHARE)).tolist()
        n = len(times)
        return cls(*asked, n, len(ages_ms) / n, p50, p99, max(ages_ms), float(np.median(simulated_ms)), load)

    @property
    def is_met(self) -> bool:
        """Whether tracks are as young as they are to be."""
        return self.p99_ms < GOAL_MS


Arrived = Sequence[tuple[float, float]]  # when a report came and the time that it states, s of the UTC day


class Receiver:
    """Another system: hears datagrams, and notes when each came."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.1)
        self._came: list[tuple[float, bytes]] = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._hear)

    @property
    def address(self) -> str:
        """Where a feed sends to."""
        return f"udp://127.0.0.1:{self._socket.getsockname()[1]}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._socket.close()

    def _hear(self) -> None:
        while not self._closing.is_set():
            try:
                data = self._socket.recv(MAX_DATAGRAM)
            except TimeoutError:
                continue
            self._came.append((time.time(), data))

    def reports(self) -> Arrived:
        """Each report of a track that goes on, as a decoder reads it that is not ours."""
        return [(came_s % DAY_S, at_s) for came_s, data in self._came for at_s in times_of_tracks(data)]


def times_of_tracks(data: bytes) -> Iterator[float]:
    """The times, s of the UTC day, of the records of category 062 in a datagram whose tracks go on."""
    from asterix import base, generated

    for block in base.RawDatablock.parse(base.Bits.from_bytes(data)):
        if block.get_category() == 62:
            for record in generated.Cat_062_1_20.cv_uap.parse(block.get_raw_records()):
                status = record.get_item(OVER).variation
                is_over = status.get_item("TSE") is not None and status.get_item("TSE").variation.as_uint()
                if not is_over:
                    yield float(record.get_item("070").variation.content.as_quantity("s"))


@contextmanager
def _feeding(endpoint: str, where: str, log: Path) -> Iterator[None]:
    """`cogradar feed`, as a process."""
    command = [sys.executable, "-m", "cogradar", "feed", "--to", "asterix", "--out", where, "--site", SITE]
    with log.open("wb") as output:
        process = subprocess.Popen([*command, "--connect", endpoint], stdout=output, stderr=output)  # noqa: S603
        try:
            yield
            if process.poll() is not None:
                raise RunFailed(f"the feed ended: {log.read_text(errors='replace').strip()}")
        finally:
            process.terminate()
            process.wait()


def measure(aircraft: int, rate_hz: float, dwells: int, notify: Callable[[str], None], stop: threading.Event) -> Ages:
    """Play a sky of so many aircraft within the minutes, and hear its tracks. Raises RunFailed, Interrupted."""
    notify(f"{aircraft} aircraft, {dwells} dwells at {rate_hz:g} Hz")
    loads: list[float] = []
    with scratch() as folder, Receiver() as receiver:
        sky = Path(folder) / "crowd.toml"
        write(Asked(str(aircraft), MINUTES, SEED, None, None, 0.0, RANGE_KM), sky, force=True)
        os.environ[SKY] = str(sky)
        front_end = f"{Path(__file__).resolve()}:{Clocked.__name__}"
        scenario = as_played(load(str(sky), ["radar.max_tracks=300"]), front_end)
        start = RunStart.of(scenario, Strategy.POWER_AWARE, SEED, SETTLED + dwells, rate_hz)
        with Launcher(LocalProcesses(PLANNERS, front_end=front_end), stop) as launcher:
            cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
            with _feeding(launcher.endpoint, receiver.address, Path(folder) / "feed.log"):
                cluster.play_on(
                    launcher.endpoint,
                    start,
                    report=lambda _: loads.append(os.getloadavg()[0]),
                    notify=lambda _: None,
                    stop=stop,
                )
                time.sleep(DRAIN_S)
        spent = [float(line) for line in _durations().read_text(encoding="ascii").split()][-dwells:]
    return Ages.of((aircraft, rate_hz, dwells), receiver.reports(), spent, float(np.mean(loads)))


def table(found: Ages) -> Table:
    """How old tracks were, beside the goal."""
    columns = [
        Column("tracks", "{tracks:.0f}"),
        Column("dwells / s", "{rate_hz:g}"),
        Column("pictures, of", "{pictures} of {dwells}"),
        Column("age ms, median", "{p50_ms:.0f}"),
        Column("99 %", "{p99_ms:.0f}"),
        Column("most", "{most_ms:.0f}"),
        Column("echoes ms", "{simulated_ms:.0f}"),
    ]
    title = f"age of a track at a receiver, {PLANNERS} planners; goal: {GOAL_SHARE:.0%} below {GOAL_MS:.0f} ms"
    return Table(title, columns, [asdict(found)])


def as_json(found: Ages) -> dict[str, Any]:
    """The same as a document."""
    return asdict(found) | {"met": found.is_met}
