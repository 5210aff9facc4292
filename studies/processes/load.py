"""What shared services bear: runs per minute and the time of a dwell with several at once; what certificates cost."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.certs import authority
from cogradar.services.certs.names import SETTINGS
from cogradar.services.errors import check_stop
from cogradar.services.runs import cluster
from cogradar.services.runs.cluster import CONNECT_WITHIN_S
from cogradar.services.runs.launcher import Launcher, LocalProcesses, scratch
from cogradar.services.topology import TOPOLOGY
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.errors import bootstrap_interval
from cogradar.shared.wire.session import CONFIG_VARIABLE, open_session
from studies.processes.timestamps import ask_timestamps

CERTIFICATES_GOAL = 1.05  # of the time of a dwell without them
RUNS_EACH = 2  # one after the other, by each that plays
WITHIN_S = 10.0


@dataclass(frozen=True)
class Load:
    """Services under so many runs at once."""

    at_once: int
    runs_per_min: float
    dwells_per_s: float  # of all runs together
    dwell_ms: float  # from scan to scan of a run: median
    dwell_99_ms: float


def measure(
    endpoint: str,
    scenario: Scenario,
    dwells: int,
    at_once: Sequence[int],
    notify: Callable[[str], None],
    stop: threading.Event,
) -> list[Load]:
    """Load the services behind a router with so many runs at once, one number after the other.

    Raises RunFailed if a role is missing or a run fails, Interrupted; the runs on their way are cancelled.
    """
    found = []
    for n in at_once:
        notify(f"{n} at once, {RUNS_EACH} runs each")
        found.append(_measure(endpoint, scenario, dwells, n, stop))
    return found


def _measure(endpoint: str, scenario: Scenario, dwells: int, n: int, stop: threading.Event) -> Load:
    starts = [RunStart.of(scenario, Strategy.POWER_AWARE, seed, dwells) for seed in range(1, n * RUNS_EACH + 1)]
    play = partial(cluster.play_on, endpoint, report=lambda _: None, notify=lambda _: None, stop=stop)
    began = time.monotonic()
    with ThreadPoolExecutor(n) as players:
        waiting = [players.submit(play, start) for start in starts]
        try:
            for player in waiting:
                player.result()
        except BaseException:
            stop.set()  # the others have nothing to compare with
            raise
    wall_s = time.monotonic() - began
    times_ms = _dwell_times_ms(endpoint, starts, stop)
    return Load(
        n,
        60.0 * len(starts) / wall_s,
        dwells * len(starts) / wall_s,
        float(np.median(times_ms)),
        float(np.quantile(times_ms, 0.99)),
    )


def _dwell_times_ms(endpoint: str, starts: Sequence[RunStart], stop: threading.Event) -> list[float]:
    """From one scan to the next of each run; the acquisition, which tests all cells, comes before."""
    session = open_session(endpoint.split(","), CONNECT_WITHIN_S, partial(check_stop, stop))
    times: list[float] = []
    with session:
        for start in starts:
            found = ask_timestamps(session, start.run, WITHIN_S)
            sent = sorted((row.k, row.begun) for rows in found.values() for row in rows.sent if row.topic == "scan")
            times += [1e3 * (after - before) for (_, before), (_, after) in pairwise(sent[-start.dwells :])]
    return times


def table(loads: Sequence[Load]) -> Table:
    """A row per number of runs at once."""
    columns = [
        Column("runs at once", "{at_once}"),
        Column("runs / min", "{runs_per_min:.1f}"),
        Column("dwells / s", "{dwells_per_s:.1f}"),
        Column("dwell ms", "{dwell_ms:.1f}"),
        Column("99 % ms", "{dwell_99_ms:.1f}"),
    ]
    return Table("shared services under load", columns, [asdict(load) for load in loads])


def as_json(loads: Sequence[Load]) -> list[dict[str, Any]]:
    """The same as a document."""
    return [asdict(load) for load in loads]


@dataclass(frozen=True)
class Secured:
    """Runs on services with certificates and access control, against those without."""

    plain_ms: float  # a dwell: median of the runs' medians
    secured_ms: float
    ratio: float  # of a pair's dwells: mean over the pairs
    low: float  # 95 % interval of it, over pairs
    high: float


def secured(
    scenario: Scenario, dwells: int, pairs: int, notify: Callable[[str], None], stop: threading.Event
) -> Secured:
    """What certificates cost: pairs of runs, in turn. Raises RunFailed, Interrupted."""
    times: dict[bool, list[float]] = {False: [], True: []}
    with scratch() as folder:
        certificates = Path(folder) / "certs"
        authority.create(certificates, 2)
        names = [f"{role}.0" for role in (*(service.role for service in TOPOLOGY), Role.OPERATOR)]
        authority.issue(certificates, names, ["127.0.0.1"], 1)
        own = certificates / f"{Role.OPERATOR}.0" / SETTINGS
        with (
            Launcher(LocalProcesses(1), stop) as plain,
            Launcher(LocalProcesses(1), stop).with_certificates(certificates) as with_certificates,
            _told(str(own)),
        ):
            launchers = {False: plain, True: with_certificates}
            for launcher in launchers.values():
                cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
            for pair in range(pairs):
                notify(f"pair {pair + 1} of {pairs}")
                for has in (pair % 2 == 0, pair % 2 == 1):  # neither gains by going first
                    start = RunStart.of(scenario, Strategy.POWER_AWARE, pair + 1, dwells)
                    endpoint = launchers[has].endpoint
                    cluster.play_on(endpoint, start, report=lambda _: None, notify=lambda _: None, stop=stop)
                    times[has].append(median(_dwell_times_ms(endpoint, [start], stop)))
    ratios = [after / before for before, after in zip(times[False], times[True], strict=True)]
    low, high = bootstrap_interval(ratios, generator(0, Purpose.BOOTSTRAP, 0, 0))
    return Secured(median(times[False]), median(times[True]), fmean(ratios), float(low), float(high))


@contextmanager
def _told(file: str) -> Iterator[None]:
    """Let the sessions of this process have a file of settings; a router without TLS does not ask for any."""
    before = os.environ.get(CONFIG_VARIABLE, "")
    os.environ[CONFIG_VARIABLE] = file
    try:
        yield
    finally:
        os.environ[CONFIG_VARIABLE] = before


def table_of_secured(found: Secured) -> Table:
    """A dwell without and with certificates."""
    columns = [
        Column("dwell ms", "{plain_ms:.2f}"),
        Column("with certificates", "{secured_ms:.2f}"),
        Column("ratio", "{ratio:.3f}"),
        Column("95 %", "{low:.3f} {high:.3f}"),
    ]
    return Table(f"certificates and access control; goal: at most {CERTIFICATES_GOAL:g}", columns, [asdict(found)])
