"""The highest rate in real time that this machine holds, by bisection with the real processes, kept for all probes."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.metrics.client import ask_service
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.fields import MAX_RATE_HZ
from cogradar.shared.protocol.messages import Message, Plan, RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.wire.runner import serve
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from studies.processes.many_targets import many_targets

SEED = 1
N_TARGET, N_PLANNER = (1, 3, 10, 30), (1, 2)
TOLERATED = 0.01  # of the plans late, and of the waveforms stale: below it a rate is held
DWELLS = 150  # tracking dwells that are counted
LOCKSTEP_DWELLS = 40  # of the run without a clock that says where to begin
SETTLE_S = 1.0  # ... after so long
PROBES, FINE = 5, 1.08  # of one cell of the table, at most; enough if the bracket is as narrow as this ratio
STEP = 1.6  # from rate to rate until there is a bracket
BUDGET_S = 440.0  # of all probes; a cell whose share is used up keeps the bracket it has
CONNECT_WITHIN_S = 15.0


@dataclass(frozen=True)
class Probe:
    """A run in real time."""

    rate_hz: float
    achieved_hz: float  # dwells that the emulator transmitted per second; less than rate_hz if it did not keep up
    late: float  # share of the plans, mean over the targets
    stale: float  # share of the waveforms
    searched: float  # simulations made, share of those that the scenario asks for

    @property
    def held(self) -> bool:
        """Whether the rate was held."""
        slow = self.achieved_hz < (1.0 - TOLERATED) * self.rate_hz
        return self.late < TOLERATED and self.stale < TOLERATED and not slow


@dataclass(frozen=True)
class Cell:
    """What was found for some targets and planners."""

    n_target: int
    n_planner: int
    lockstep_hz: float  # dwells per second without a clock, every search complete
    best: Probe | None  # the highest rate held, None: none of those tried
    above_hz: float  # the lowest that was not held; infinity: all were

    def as_json(self) -> dict[str, Any]:
        """One element of what `python -m studies realtime --json` prints."""
        cell = {"targets": self.n_target, "planners": self.n_planner, "lockstep_hz": round(self.lockstep_hz, 3)}
        above = None if math.isinf(self.above_hz) else round(self.above_hz, 3)
        best = {key: round(value, 4) for key, value in asdict(self.best).items()} if self.best else {"rate_hz": None}
        return cell | best | {"not_held_hz": above}


def highest_rate(
    probe: Callable[[float], Probe], first_hz: float, may_go_on: Callable[[], bool]
) -> tuple[Probe | None, float]:
    """The highest rate held among those tried, and the lowest not held: steps until there is a bracket, then halves it.

    probe : plays a run at a rate; first_hz : where to begin; may_go_on : asked before each probe but the first
    """
    best: Probe | None = None
    above, rate_hz = math.inf, first_hz
    for i in range(PROBES):
        if i and not may_go_on():
            break
        found = probe(rate_hz)
        if found.held:
            best = found
        else:
            above = rate_hz
        if best is None:
            rate_hz = above / STEP
        elif math.isinf(above):
            rate_hz = min(best.rate_hz * STEP, MAX_RATE_HZ)
        elif above < best.rate_hz * FINE:
            break
        else:
            rate_hz = math.sqrt(best.rate_hz * above)
    return best, above


def bench(report: Callable[[str], None], stop: threading.Event) -> list[Cell]:
    """Fill the table; `report` is told before each probe."""
    cells: list[Cell] = []
    ends = time.monotonic() + BUDGET_S
    for n_planner in N_PLANNER:
        with (
            Launcher(LocalProcesses(n_planner), stop) as launcher,
            _Listening(launcher) as plans,
        ):
            distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
            for n_target in N_TARGET:
                left = len(N_PLANNER) * len(N_TARGET) - len(cells)
                until = time.monotonic() + (ends - time.monotonic()) / left
                site = _Site(launcher, plans, many_targets(n_target), n_planner, report, stop)
                lockstep_hz = site.lockstep()
                best, above = highest_rate(site.probe, lockstep_hz, partial(_is_before, until))
                cells.append(Cell(n_target, n_planner, lockstep_hz, best, above))
    return cells


def _is_before(until: float) -> bool:
    return time.monotonic() < until


class _Plans:
    """Hears the plans of the run that is played: when they came, and how many simulations are behind each."""

    def __init__(self) -> None:
        self._tracking: list[tuple[int, int, float]] = []  # (k, n_sim, s)

    def clear(self) -> None:
        """Forget the last run."""
        self._tracking = []

    def handle(self, event: Event) -> Sequence[Message]:
        """Note a plan, and say nothing."""
        if isinstance(event, Plan) and event.status == "tracking":
            self._tracking.append((event.k, event.n_sim, time.perf_counter()))
        return ()

    def of_last(self, dwells: int) -> tuple[float, float]:
        """Dwells per second and mean number of simulations of a plan, over the last so many dwells."""
        last = max(k for k, _, _ in self._tracking)
        k, n_sim, stamp = np.array([plan for plan in self._tracking if plan[0] >= last - dwells]).T
        return float((k[-1] - k[0]) / max(stamp[-1] - stamp[0], 1e-6)), float(n_sim.mean())


class _Listening:
    """Listens as a second allocator would, as a context."""

    def __init__(self, launcher: Launcher) -> None:
        self._stop = threading.Event()
        self._plans = _Plans()
        session = open_session([launcher.endpoint], CONNECT_WITHIN_S, launcher.check)
        self._bus = ZenohBus(session, Role.ALLOCATOR, "bench")
        self._thread = threading.Thread(target=lambda: serve(self._plans, self._bus, self._stop, self._bus.meter))

    def __enter__(self) -> _Plans:
        self._thread.start()
        return self._plans

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.close()


@dataclass(frozen=True)
class _Site:
    """Running processes and a scenario to play on them."""

    launcher: Launcher
    plans: _Plans
    scenario: Scenario
    n_planner: int
    report: Callable[[str], None]
    stop: threading.Event

    def lockstep(self) -> float:
        """Dwells per second without a clock."""
        self._play(LOCKSTEP_DWELLS, 0.0, "in lockstep")
        return self.plans.of_last(LOCKSTEP_DWELLS)[0]

    def probe(self, rate_hz: float) -> Probe:
        """Play a run at a rate and count what was late; a dwell that is not in the store counts as such."""
        settle = math.ceil(SETTLE_S * rate_hz)
        run = self._play(settle + DWELLS, rate_hz, f"at {rate_hz:.1f} Hz")
        asked = {"run": run, "dwells": f"{settle + 1}:{settle + DWELLS}"}
        rows = ask_service(self.launcher.endpoint, "summary", asked)
        scored = sum(row["n"] for row in rows) / (len(rows) * DWELLS)
        late, stale = (1.0 - scored + scored * sum(row[key] for row in rows) / len(rows) for key in ("late", "stale"))
        achieved_hz, n_sim = self.plans.of_last(DWELLS)
        return Probe(rate_hz, achieved_hz, late, stale, n_sim / self.scenario.radar.planner.n_sim)

    def _play(self, dwells: int, rate_hz: float, how: str) -> str:
        """Play a run; its name."""
        self.report(f"{self.scenario.radar.tracks} targets, {self.n_planner} planners, {how}")
        self.plans.clear()
        start = RunStart.of(self.scenario, Strategy.POWER_AWARE, SEED, dwells, rate_hz)
        distributed.play_on(self.launcher.endpoint, start, report=lambda _: None, notify=lambda _: None, stop=self.stop)
        return start.run


def table(cells: Sequence[Cell]) -> Table:
    """One row per number of targets and planners."""
    columns = (
        *(
            Column("targets", "{targets}", left=True),
            Column("planners", "{planners}", left=True),
            Column("rate Hz", "{rate_hz:.1f}", left=True),
        ),
        *(Column("not held", "{not_held_hz:.1f}"), Column("late %", "{late:.2f}"), Column("stale %", "{stale:.2f}")),
        *(Column("searched %", "{searched:.2f}"), Column("tracks x Hz", "{tracks_hz:.0f}")),
        Column("lockstep Hz", "{lockstep_hz:.1f}"),
    )
    rows = []
    for row in map(Cell.as_json, cells):
        percent = {key: row.get(key) and 100.0 * row[key] for key in ("late", "stale", "searched")}
        rows.append(row | percent | {"tracks_hz": row["rate_hz"] and row["targets"] * row["rate_hz"]})
    title = f"highest rate with under {100 * TOLERATED:g} % late plans and stale waveforms, paper's radar"
    return Table(title, columns, rows)


def remark(cells: Sequence[Cell]) -> str:
    """What one planner carries at most, among the rates that one planner held."""
    held = [(cell.n_target * cell.best.rate_hz, cell) for cell in cells if cell.n_planner == 1 and cell.best]
    if not held:
        return "one planner held no rate"
    most, cell = max(held, key=lambda pair: pair[0])
    share = 100.0 * cell.best.searched if cell.best else 0.0
    return (
        f"one planner carries up to {most:.0f} tracks a second ({cell.n_target} targets), with {share:.0f} % of the "
        "simulations: a search ends at its deadline"
    )
