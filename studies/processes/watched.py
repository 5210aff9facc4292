"""What it costs a run to be watched: its dwell rate beside clients and frozen readers, in turn with runs alone."""

import multiprocessing
import signal
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.connection import Connection
from statistics import fmean, median
from typing import Any

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import RunFailed, check_stop
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.errors import bootstrap_interval
from cogradar.shared.wire.session import open_session
from studies.processes.http_clients import KINDS, serve
from studies.processes.timestamps import ask_timestamps

PAIRS = 10
DWELLS = 300
PLANNERS = 2
GOAL = 0.95  # of the rate of a run alone
FROZEN_METRICS = "metrics, frozen"
ALL_KINDS = (*KINDS, FROZEN_METRICS)
FREEZE = 1.5  # of the time of the run before
WITHIN_S = 10.0
POLL_S = 0.2  # how often a stop is looked for


@dataclass(frozen=True)
class Watched:
    """Runs watched in one way, against runs alone."""

    by: str
    ratio: float  # of the dwell rates: mean over pairs
    low: float  # 95 % interval of it, over pairs
    high: float
    alone_hz: float  # dwells per second
    served: dict[str, float]  # in a run


def measure(
    pairs: int, dwells: int, notify: Callable[[str], None], stop: threading.Event, kinds: Sequence[str] = ALL_KINDS
) -> list[Watched]:
    """Pairs of runs with and without each kind of watchers. Raises RunFailed, Interrupted."""
    ratios, alone = defaultdict[str, list[float]](list), list[float]()
    served = defaultdict[str, list[dict[str, int]]](list)
    with Launcher(LocalProcesses(PLANNERS, http="127.0.0.1:0"), stop) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        for pair in range(pairs):
            for kind in kinds:
                notify(f"pair {pair + 1} of {pairs}: {kind}")
                rates = {}
                for is_watched in (pair % 2 == 0, pair % 2 == 1):  # neither gains by going first
                    start = RunStart.of(load("paper"), Strategy.POWER_AWARE, pair + 1, dwells)
                    watching = _watchers(kind, launcher, start.run, dwells / median(alone or [10.0]), stop)
                    if is_watched:
                        with watching as counts:
                            rates[True] = _rate(launcher, start, stop)
                        served[kind].append(counts)
                    else:
                        rates[False] = _rate(launcher, start, stop)
                alone.append(rates[False])
                ratios[kind].append(rates[True] / rates[False])
    hz = median(alone)
    return [_watched(kind, values, hz, served[kind]) for kind, values in ratios.items()]


def _watched(kind: str, ratios: list[float], alone_hz: float, served: list[dict[str, int]]) -> Watched:
    low, high = bootstrap_interval(ratios, generator(0, Purpose.BOOTSTRAP, 0, 0))
    of_a_run = {name: median(counts[name] for counts in served) for name in served[0]}
    return Watched(kind, fmean(ratios), float(low), float(high), alone_hz, of_a_run)


def _rate(launcher: Launcher, start: RunStart, stop: threading.Event) -> float:
    """Dwells per second of a run: of its scans after the acquisition."""
    cluster.play_on(launcher.endpoint, start, report=lambda _: None, notify=lambda _: None, stop=stop)
    session = open_session([launcher.endpoint], WITHIN_S, partial(check_stop, stop))
    with session:
        found = ask_timestamps(session, start.run, WITHIN_S)
    sent = sorted((row.k, row.begun) for rows in found.values() for row in rows.sent if row.topic == "scan")
    times = [begun for _, begun in sent[-start.dwells :]]
    return (len(times) - 1) / (times[-1] - times[0])


@contextmanager
def _watchers(
    kind: str, launcher: Launcher, run: str, expected_s: float, stop: threading.Event
) -> Iterator[dict[str, int]]:
    """Watchers of a run while it is played; how often they were served is known afterwards."""
    if kind == FROZEN_METRICS:
        with _frozen(launcher, FREEZE * expected_s):
            yield {}
    else:
        with clients(kind, str(launcher.url), run, stop) as counts:
            yield counts


@contextmanager
def clients(kind: str, address: str, run: str, stop: threading.Event) -> Iterator[dict[str, int]]:
    """Clients of one kind in a process of their own; how often they were served is known afterwards.

    Raises RunFailed if they failed, or their process died; Interrupted.
    """
    counts: dict[str, int] = {}
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=serve, args=(kind, address, run, theirs), daemon=True)
    process.start()
    theirs.close()  # or the end of the process would not be the end of the pipe
    try:
        _received(kind, ours, stop)
        yield counts
        with suppress(OSError):  # no process is there, which the answer says
            ours.send(None)
        found, faults = _received(kind, ours, stop)
        if faults:
            raise RunFailed(f"{kind}: {faults[0]}")
        counts.update(found)
    finally:
        process.terminate()
        process.join()
        ours.close()


def _received(kind: str, pipe: Connection, stop: threading.Event) -> Any:
    """What comes next from a process of clients. Raises RunFailed if it died, Interrupted."""
    try:
        check_stop(stop)
        while not pipe.poll(POLL_S):
            check_stop(stop)
        return pipe.recv()
    except (EOFError, OSError):
        raise RunFailed(f"{kind}: the process of these clients died") from None


@contextmanager
def _frozen(launcher: Launcher, for_s: float) -> Iterator[None]:
    """Metrics does nothing for so long."""
    launcher.signal("metrics-0", signal.SIGSTOP)
    thaw = threading.Timer(for_s, launcher.signal, ("metrics-0", signal.SIGCONT))
    thaw.start()
    try:
        yield
    finally:
        thaw.cancel()
        launcher.signal("metrics-0", signal.SIGCONT)


def table(measured: Sequence[Watched]) -> Table:
    """A row per kind of watchers."""
    rows = [
        asdict(row) | {"of_a_run": ", ".join(f"{n:.0f} {name}" for name, n in row.served.items()) or None}
        for row in measured
    ]
    columns = [
        Column("watched by", "{by}", left=True),
        Column("rate", "{ratio:.3f}"),
        Column("95 %", "{low:.3f} {high:.3f}"),
        Column("goal", f"{GOAL:.2f}"),
        Column("served in a run", "{of_a_run}", left=True),
    ]
    return Table("dwell rate of a watched run, relative to a run alone", columns, rows)


def as_json(measured: Sequence[Watched]) -> list[dict[str, Any]]:
    """The same as a document."""
    return [asdict(row) for row in measured]
