"""What a run waits for planners that join it: its longest dwells meanwhile, beside those before."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import RunFailed
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.session import open_session
from studies.processes.timestamps import RunTimestamps, ask_timestamps
from studies.scaling.runs import SEED, WITHIN_S, scenario

REPEATS = 3
JOINING = 5  # planners, all at once, of a run that one plans
JOINED_AT = {3: 300, 30: 40}  # tracking dwell, by number of targets
DWELLS = {3: 3000, 30: 250}
SETTLED = 10  # dwells at the begin that are no measure


@dataclass(frozen=True)
class Joins:
    """A run that planners join, medians over repeats."""

    n_target: int
    joining: int
    dwell_ms: float  # median before they join
    before: float  # longest dwell before, in medians
    meanwhile: float  # ... and from then on
    moved: float  # share of the tracks that they plan for at the end


def measure(notify: Callable[[str], None], stop: threading.Event) -> list[Joins]:
    """A run of each number of targets, `REPEATS` times. Raises RunFailed, Interrupted."""
    found: dict[int, list[Joins]] = {n: [] for n in DWELLS}
    for repeat in range(REPEATS):
        for n, measured in found.items():
            notify(f"{repeat + 1} of {REPEATS}: {JOINING} planners join a run of {n} targets")
            measured.append(_joined(n, stop))
    return [_middle(measured) for measured in found.values()]


def table(measured: Sequence[Joins]) -> Table:
    """A row for each number of targets."""
    columns = (
        *(Column("targets", "{n_target}"), Column("joining", "{joining}"), Column("dwell ms", "{dwell_ms:.1f}")),
        *(Column("longest before", "{before:.1f}"), Column("longest then", "{meanwhile:.1f}")),
        Column("tracks moved", "{moved:.0%}"),
    )
    rows = [vars(one) for one in measured]
    return Table("Planners join a run of one: longest dwells, in medians of those before", columns, rows)


def _middle(measured: Sequence[Joins]) -> Joins:
    fields = zip(*(vars(one).values() for one in measured), strict=True)
    n_target, joining, *rest = (median(values) for values in fields)
    return Joins(int(n_target), int(joining), *rest)


def _joined(n_target: int, stop: threading.Event) -> Joins:
    start = RunStart.of(scenario(n_target), Strategy.POWER_AWARE, SEED, DWELLS[n_target])
    joined_at: list[int] = []

    with Launcher(LocalProcesses(1), stop) as launcher:

        def note(now: Progress) -> None:
            if now.t >= JOINED_AT[n_target] and not joined_at:
                joined_at.append(now.t)
                for _ in range(JOINING):
                    launcher.add_planner()

        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        cluster.play_on(launcher.endpoint, start, report=note, notify=lambda _: None, stop=stop)
        with open_session([launcher.endpoint], WITHIN_S, launcher.check) as session:
            processes = ask_timestamps(session, start.run, WITHIN_S)
    if not joined_at or joined_at[0] >= start.dwells - SETTLED:
        raise RunFailed(f"a run of {n_target} targets was over before planners could join it")
    return summary(processes, n_target, start.dwells, joined_at[0])


def summary(processes: Mapping[str, RunTimestamps], n_target: int, dwells: int, joined_at: int) -> Joins:
    """What the time stamps of a run say, which others joined after a number of tracking dwells."""
    scans = {row.k: row.begun for rows in processes.values() for row in reversed(rows.sent) if row.topic == "scan"}
    newest = sorted(scans)[-dwells:]
    times = [1e3 * (scans[k] - scans[k - 1]) for k in newest[1:]]
    # Progress is told now and then: the run may have been some dwells further when they were started.
    before, meanwhile = times[SETTLED : joined_at - 1], times[joined_at - 1 :]
    last = {
        row.item: name
        for name, rows in processes.items()
        for row in rows.sent
        if row.topic == "plan" and row.k == newest[-2]
    }
    moved = sum(name != "planner-0" for name in last.values()) / n_target
    typical = median(before)
    return Joins(n_target, JOINING, typical, max(before) / typical, max(meanwhile) / typical, moved)
