"""What it costs to be distributed: the dwell rate of the same runs in one process and over Zenoh, and where time goes.

Runs are played on services started here, with different numbers of planners, in turn with runs in this process, so that
a machine whose speed drifts treats all alike. Latency is split along the chain of messages that each dwell waits for:
waveform k-1, scan k, the plan that comes last, waveform k.
"""

import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from cogradar.services.bench.dwell import in_one_process
from cogradar.services.campaigns.pool import n_core
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.timestamps import Received
from studies.processes.many_targets import many_targets
from studies.processes.timestamps import RunTimestamps, ask_timestamps

SEED = 1
REPEATS = 3  # of every run, in turn
DWELLS = {3: 150, 30: 40}  # tracking dwells, by number of targets
PLANNERS = (1, 2, 4, 8)
RANGES_KM = (25.0, 35.0)  # of the thirty targets, in turn
WITHIN_S = 15.0
SINGLE = (Role.EMULATOR, Role.ALLOCATOR, Role.METRICS, Role.ROUTER)  # roles of which one process runs


@dataclass(frozen=True)
class Latency:
    """A dwell's time, ms, medians over dwells: from waveform to waveform, and what it is made of."""

    total: float
    emulator: float
    planner: float
    allocator: float
    queueing: float  # arrived, not yet taken
    transport: float  # three messages, from one core to the other's queue, encoded in between


@dataclass(frozen=True)
class Measured:
    """Runs of one kind."""

    n_target: int
    planners: int  # 0: in one process
    dwell_ms: float  # median over dwells, median over repeats
    latency: Latency | None = None
    cpu_ms: Mapping[str, float] | None = None  # per dwell, by role, with the transport's threads
    n_byte: Mapping[str, float] | None = None  # per dwell, by topic


def scenario(n_target: int) -> Scenario:
    """The paper's scenario, or its radar with another number of targets."""
    paper = load("paper")
    return paper if n_target == paper.radar.tracks else many_targets(n_target)


def planner_counts() -> tuple[int, ...]:
    """Numbers of planners worth trying here: no more than cores, but two in any case."""
    return tuple(n for n in PLANNERS if n <= max(2, n_core()))


def measure(notify: Callable[[str], None], stop: threading.Event) -> list[Measured]:
    """Every kind of run, `REPEATS` times in turn. Raises RunFailed, Interrupted."""
    found: defaultdict[tuple[int, int], list[Measured]] = defaultdict(list)
    for repeat in range(REPEATS):
        for planners in planner_counts():
            for n_target in DWELLS:
                notify(f"{repeat + 1} of {REPEATS}: {n_target} targets in one process")
                times = in_one_process(_start(n_target), stop)
                found[n_target, 0].append(Measured(n_target, 0, median(times)))
            with Launcher(LocalProcesses(planners), stop) as launcher:
                distributed.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
                for n_target in DWELLS:
                    notify(f"{repeat + 1} of {REPEATS}: {n_target} targets over Zenoh, {planners} planners")
                    found[n_target, planners].append(_over_zenoh(n_target, planners, launcher, stop))
    return [middle(found[key]) for key in sorted(found)]


def middle(runs: Sequence[Measured]) -> Measured:
    """The run whose dwells took the middle time, whole: its parts belong together."""
    return sorted(runs, key=lambda run: run.dwell_ms)[len(runs) // 2]


def _start(n_target: int) -> RunStart:
    return RunStart.of(scenario(n_target), Strategy.POWER_AWARE, SEED, DWELLS[n_target])


def _over_zenoh(n_target: int, planners: int, launcher: Launcher, stop: threading.Event) -> Measured:
    start, cpu_s = _start(n_target), list[tuple[int, dict[str, float]]]()
    session = open_session([launcher.endpoint], WITHIN_S, launcher.check)

    def note(now: Progress) -> None:
        """CPU time at the first and the last look at the tracking dwells; what comes before and after is no dwell."""
        if 0 < now.t < now.dwells and (not cpu_s or now.t > cpu_s[-1][0]):
            found = ask_timestamps(session, "", WITHIN_S)
            cpu_s[1:] = [(now.t, {name: process.cpu_s for name, process in found.items()})]

    try:
        distributed.play_on(launcher.endpoint, start, report=note, notify=lambda _: None, stop=stop)
        found = ask_timestamps(session, start.run, WITHIN_S)
    finally:
        session.close()
    latencies = split(found, DWELLS[n_target])
    typical = Latency(*(median(values) for values in zip(*latencies, strict=True)))
    return Measured(
        n_target, planners, typical.total, typical, _cpu_ms(cpu_s), bytes_per_dwell(found, DWELLS[n_target])
    )


def _cpu_ms(cpu_s: Sequence[tuple[int, dict[str, float]]]) -> dict[str, float]:
    """CPU time per dwell and role between two looks; nothing if there were no two."""
    if len(cpu_s) < 2:
        return {}
    (t, before), (until, after) = cpu_s
    spent: defaultdict[str, float] = defaultdict(float)
    for name in after.keys() & before.keys():
        spent[_role(name)] += 1e3 * (after[name] - before[name]) / (until - t)
    return dict(spent)


def _role(name: str) -> str:
    return name.partition("-")[0]


def bytes_per_dwell(processes: Mapping[str, RunTimestamps], dwells: int) -> dict[str, float]:
    """Bytes sent per tracking dwell, by topic."""
    sent = [row for process in processes.values() for row in process.sent]
    newest = max(row.k for row in sent if row.topic == "scan")
    total: Counter[str] = Counter()
    for row in sent:
        if newest - dwells < row.k <= newest and row.topic in {"scan", "truth", "plan", "waveform"}:
            total[row.topic] += row.n_byte
    return {topic: n / dwells for topic, n in total.items()}


def split(processes: Mapping[str, RunTimestamps], dwells: int) -> list[tuple[float, ...]]:
    """Per tracking dwell but the first: the fields of Latency."""
    sent = {(s.topic, s.k, s.item): (name, s.begun) for name, process in processes.items() for s in process.sent}
    received = {
        (name if _role(name) == Role.PLANNER else _role(name), r.topic, r.k, r.item): r
        for name, process in processes.items()
        for r in process.received
    }
    items = {item for topic, _, item in sent if topic == "plan"}
    newest = max(k for topic, k, _ in sent if topic == "scan")
    return [_chain(sent, received, items, k) for k in range(newest - dwells + 2, newest + 1)]


def _chain(
    sent: Mapping[tuple[str, int, int], tuple[str, float]],
    received: Mapping[tuple[str, str, int, int], Received],
    items: set[int],
    k: int,
) -> tuple[float, ...]:
    last = max(items, key=lambda item: received[Role.ALLOCATOR, "plan", k, item].taken)
    planner, planned = sent["plan", k, last]
    hops = (  # when a message was sent; how it was received; when it was answered
        (sent["waveform", k - 1, 0][1], received[Role.EMULATOR, "waveform", k - 1, 0], sent["scan", k, 0][1]),
        (sent["scan", k, 0][1], received[planner, "scan", k, 0], planned),
        (planned, received[Role.ALLOCATOR, "plan", k, last], sent["waveform", k, 0][1]),
    )
    emulator, planner_s, allocator = (answered - hop.taken for _, hop, answered in hops)
    queueing = sum(hop.taken - hop.arrived for _, hop, _ in hops)
    transport = sum(hop.arrived - begun for begun, hop, _ in hops)
    total = hops[-1][-1] - hops[0][0]
    return tuple(1e3 * value for value in (total, emulator, planner_s, allocator, queueing, transport))
