"""A system under all that it is for, at once and for long: what its processes hold must not grow.

Six runs at a time, one after the other, some with aircraft that come and go; processes that are killed; pages and
askers; a journal that keeps the last runs. Router, recorder, metrics and a planner live through it and are measured.
"""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput, Interrupted, RunFailed, check_stop
from cogradar.services.runs import cluster
from cogradar.services.runs.chaos import Chaos
from cogradar.services.runs.launcher import Launcher, LocalProcesses, scratch
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from studies.soak.clients import Served, serve

RUNS, PAGES, ASKERS, PLANNERS = 6, 20, 50, 2
SCENARIOS = ("paper", "traffic")  # the second one with births and deaths
DWELLS = 60
KEPT_RUNS = "12"
KILLED = ("emulator-0", "allocator-0", "planner-1")
KILLS_PER_MIN = 2.0
SAMPLE_S, POLL_S = 2.0, 0.25
# From the middle third to the last one, by their medians: a share, or so much.
GROWTH = 0.05
SLACK = {"MiB": 8.0, "descriptors": 4.0, "threads": 2.0}


@dataclass(frozen=True)
class Held:
    """What somebody holds of something."""

    process: str
    what: str
    before: float  # median of the middle third of the time,
    after: float  # ... and of the last one
    most: float

    @property
    def is_flat(self) -> bool:
        """Whether it has not grown."""
        return self.after <= max(self.before * (1.0 + GROWTH), self.before + SLACK[self.what])


@dataclass(frozen=True)
class Soaked:
    """What came of it."""

    minutes: float
    held: list[Held]
    runs: int  # that came to their end
    killed: int
    served: Served

    @property
    def p99_ms(self) -> float:
        """Of the questions."""
        return 1e3 * float(np.quantile(self.served.answers_s, 0.99)) if self.served.answers_s else 0.0

    @property
    def faults(self) -> list[str]:
        """What is not as it should be."""
        grown = [
            f"{one.process}: {one.what} {one.before:.1f}, then {one.after:.1f}" for one in self.held if not one.is_flat
        ]
        return grown + self.served.failed

    def as_json(self) -> dict[str, Any]:
        """The same as a document."""
        rows = [asdict(one) | {"flat": one.is_flat} for one in self.held]
        of_all = {"minutes": self.minutes, "runs": self.runs, "killed": self.killed, "held": rows}
        served = {"answers": len(self.served.answers_s), "failed": len(self.served.failed), "p99_ms": self.p99_ms}
        return of_all | served | {"events": self.served.events}


def table(found: Soaked) -> Table:
    """A row for all that is held."""
    columns = [
        Column("process", "{process}", left=True),
        Column("holds", "{what}", left=True),
        Column("middle third", "{before:.1f}"),
        Column("last third", "{after:.1f}"),
        Column("most", "{most:.1f}"),
        Column("", "{verdict}", left=True),
    ]
    rows = [asdict(one) | {"verdict": "flat" if one.is_flat else "grows"} for one in found.held]
    return Table(f"medians over {found.minutes:g} min", columns, rows)


def remark(found: Soaked) -> str:
    """A line on what else there was."""
    served = found.served
    return (
        f"{found.runs} runs came to their end, {found.killed} processes were killed; {len(served.answers_s)} questions"
        f" answered, 99 % within {found.p99_ms:.0f} ms, {len(served.failed)} not; {served.events} events"
    )


class _SomeOnly(Chaos):
    """What ends every process of the run."""

    def victim(self, names: Sequence[str], now_s: float) -> str | None:
        return super().victim([name for name in names if name in KILLED], now_s)


def soak(minutes: float, seed: int, notify: Callable[[str], None], stop: threading.Event) -> Soaked:
    """Let everything happen for so long. Raises RunFailed if a run does not come to its end, Interrupted, BadInput."""
    if not Path("/proc/self/status").exists():
        raise BadInput("soak reads /proc, which this system does not have")
    chaos, over, samples = _SomeOnly(KILLS_PER_MIN, seed), threading.Event(), list[dict[tuple[str, str], float]]()
    with scratch() as folder, ExitStack() as closing:
        closing.callback(os.environ.pop, "COGRADAR_KEEP_RUNS", None)
        os.environ["COGRADAR_KEEP_RUNS"] = KEPT_RUNS
        store = Path(folder) / "runs.db"
        processes = LocalProcesses(PLANNERS, str(store), chaos, http="127.0.0.1:0")
        launcher = closing.enter_context(Launcher(processes, stop))
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        launcher.under_fire = True
        players, seeds = closing.enter_context(ThreadPoolExecutor(RUNS)), count(seed)
        closing.callback(over.set)
        playing = [players.submit(_play, launcher.endpoint, seeds, i, over) for i in range(RUNS)]
        with _clients(str(launcher.url), stop) as pipe:
            began = time.monotonic()
            while (passed_s := time.monotonic() - began) < 60.0 * minutes:
                launcher.check()
                if passed_s >= SAMPLE_S * len(samples):
                    samples.append(_sample(launcher.processes, store))
                    notify(f"{passed_s / 60.0:.1f} of {minutes:g} min, {chaos.killed} killed")
                if failed := [player for player in playing if player.done()]:
                    failed[0].result()
                time.sleep(POLL_S)
            pipe.send(None)
            served: Served = _received(pipe, stop)
        over.set()
        played = sum(player.result() for player in playing)
    return Soaked(minutes, _held(samples), played, chaos.killed, served)


def _play(endpoint: str, seeds: Iterator[int], place: int, over: threading.Event) -> int:
    """Play one run after the other until it is over; how many came to their end."""
    n = 0
    scenario = load(SCENARIOS[place % len(SCENARIOS)])
    while not over.is_set():
        start = RunStart.of(scenario, Strategy.POWER_AWARE, next(seeds), DWELLS)
        try:
            cluster.play_on(endpoint, start, report=lambda _: None, notify=lambda _: None, stop=over)
        except Interrupted:
            break
        n += 1
    return n


def _sample(processes: dict[str, int], store: Path) -> dict[tuple[str, str], float]:
    files = [file for end in ("", "-wal") if (file := Path(f"{store}{end}")).exists()]
    found = {("the journal", "MiB"): sum(file.stat().st_size for file in files) / 2**20}
    for name, process in processes.items():
        folder = Path("/proc") / str(process)
        try:
            lines = (line.split(":") for line in (folder / "status").read_text(encoding="utf-8").splitlines())
            status = dict(lines)
            found[name, "MiB"] = int(status["VmRSS"].split()[0]) / 1024
            found[name, "threads"] = int(status["Threads"])
            found[name, "descriptors"] = len(list((folder / "fd").iterdir()))
        except (OSError, KeyError):
            continue  # it was killed
    return found


def _held(samples: Sequence[dict[tuple[str, str], float]]) -> list[Held]:
    third, found = len(samples) // 3, list[Held]()
    for process, what in sorted({key for sample in samples for key in sample}):
        if process in KILLED or third == 0:
            continue
        values = [
            [s[process, what] for s in lot if (process, what) in s] for lot in (samples[third:-third], samples[-third:])
        ]
        if all(values):
            found.append(Held(process, what, median(values[0]), median(values[1]), max(map(max, values))))
    return found


@contextmanager
def _clients(address: str, stop: threading.Event) -> Iterator[Connection]:
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=serve, args=(address, PAGES, ASKERS, theirs), daemon=True
    )
    process.start()
    theirs.close()
    try:
        _received(ours, stop)
        yield ours
    finally:
        process.terminate()
        process.join()
        ours.close()


def _received(pipe: Connection, stop: threading.Event) -> Served:
    try:
        while not pipe.poll(POLL_S):
            check_stop(stop)
        found: Served = pipe.recv()
    except EOFError:
        raise RunFailed("the process of the pages and askers died") from None
    return found
