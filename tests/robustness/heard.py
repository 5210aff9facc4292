"""What each core hears in short runs in simulated time, and a core that hears it again up to some moment."""

import sqlite3
from collections import defaultdict
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery.invariant import Checked
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.simulation.cluster import Cluster
from cogradar.services.simulation.disk import Disk
from cogradar.services.simulation.front_end import ReceiverFaults, WatchedFrontEnd
from cogradar.services.simulation.process import Process
from cogradar.services.simulation.schedule import Fault, Kind, Schedule
from cogradar.services.simulation.simulator import Simulator
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.protocol.messages import Checkpoint, Message
from cogradar.shared.protocol.recovery import History
from cogradar.shared.protocol.topics import TOPICS, Role
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.runner import Closing, Core
from tests.samples import sample

Heard = tuple[float, Event]  # when, by the process's own clock, and what

# Planners and the emulator come and go, so that something is recalled and tracks change hands.
_FAULTS = {
    0.0: ((Kind.LEAVE, "planner-1", 0.02), (Kind.CRASH, "emulator-0", 0.05)),
    10.0: ((Kind.LEAVE, "planner-1", 0.25), (Kind.CRASH, "emulator-0", 0.55)),
}
SCHEDULE = Schedule(0, "known", 1, 0.0, 2, 1, 2, 2, prepares=False, faults=())
SKIES = [(sky, rate_hz) for sky in ("known", "unknown") for rate_hz in _FAULTS]
ROLES = (Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.RECORDER, Role.METRICS)
# The operator compares names, and no more.
PAIRS = [(topic, role) for topic in TOPICS for role in topic.readers if role in ROLES]


@dataclass(frozen=True)
class Run:
    """A run as its processes heard it."""

    sky: str
    rate_hz: float
    heard: dict[Role, tuple[str, list[Heard]]]  # of the process of a role that heard most
    said: dict[str, list[bytes]]  # by topic
    store: Path  # what metrics reads

    def core(self, role: Role, n: int) -> "Replayed":
        """The core of a role that has heard the first n events."""
        core = Replayed(self, role)
        for heard in self.heard[role][1][:n]:
            core.hear(heard)
        return core


class Replayed:
    """A core, with the clock of the process that it had."""

    def __init__(self, run: Run, role: Role) -> None:
        self.now_s = 0.0
        self.core = _core(run, role, self)

    def hear(self, heard: Heard) -> list[bytes]:
        """Handle an event; what it sends."""
        self.now_s, event = heard
        return [encode(answer) for answer in self.core.handle(event) if isinstance(answer, Message)]

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        if isinstance(self.core, Checked):
            self.core.validate()

    def close(self) -> None:
        """Close its files."""
        if isinstance(self.core, Closing):
            self.core.close()


class _Journal(Journal):
    """Of a recorder that no other one follows, whatever epoch a mutant has: it would end, as it must. All are alike."""

    def _now_us(self) -> int:
        return MAX_EPOCH - 1


def _core(run: Run, role: Role, replayed: Replayed) -> Core:
    match role:
        case Role.EMULATOR:
            return EmulatorCore(lambda checkpoint: WatchedFrontEnd(checkpoint, lambda *_: None, ReceiverFaults()))
        case Role.PLANNER:
            return PlannerCore(run.heard[role][0], lambda: replayed.now_s)
        case Role.ALLOCATOR:
            return AllocatorCore()
        case Role.RECORDER:
            return Recorder(_Journal(":memory:"))
        case _:
            return MetricsCore(str(run.store))


class _Listening(Cluster):
    """A cluster that notes what each process handles."""

    def __init__(self, seed: int, disk: Disk) -> None:
        super().__init__(seed, disk)
        self.heard: defaultdict[Process, list[Heard]] = defaultdict(list)

    def _handle(self, process: Process, event: Event) -> None:
        self.heard[process].append((process.clock.read(self.now_s), event))
        super()._handle(process, event)


def record(sky: str, rate_hz: float, folder: Path) -> Run:
    """Play a run, and keep what was heard. Checkpoints and snapshots are frequent while `often` says so."""
    faults = tuple(Fault(kind, at_s, at_s + 0.02, who, n=n) for n, (kind, who, at_s) in enumerate(_FAULTS[rate_hz]))
    schedule = replace(SCHEDULE, sky=sky, rate_hz=rate_hz, faults=faults)
    disk = Disk(generator(0, Purpose.FAULT, -1, 2))
    simulator, cluster = Simulator(schedule, disk), _Listening(0, disk)
    simulator._cluster = cluster
    outcome = simulator.play()
    assert outcome.violation == "", outcome.violation
    said: defaultdict[str, list[bytes]] = defaultdict(list)
    for payload, message in cluster.said.items():
        said[type(message).__name__.lower()].append(payload)
    for topic in TOPICS:
        name = next(iter(simulator._starts)).run
        said[topic.name] += [] if said[topic.name] else [encode(sample(topic.message, run=name))]
    for name, to in (("scan", "planner-0"), ("snapshot", "planner-0"), ("waveform", "emulator")):
        recalled = {"to": to, "topic": name, "k": 0, "payloads": said[name][:3]}
        said["history"].append(encode(sample(History, run=decode(said["scan"][0]).run, **recalled)))
    longest: dict[Role, tuple[str, list[Heard]]] = {}
    for process, heard in cluster.heard.items():
        if len(heard) > len(longest.get(process.role, ("", []))[1]):
            longest[process.role] = process.name, heard
    checkpoints = [heard for heard in longest[Role.ALLOCATOR][1] if isinstance(heard[1], Checkpoint | Tick)]
    longest[Role.METRICS] = "metrics-0", checkpoints
    store = folder / f"{sky}-{rate_hz:g}.db"
    with closing(sqlite3.connect(store)) as copy, closing(sqlite3.connect(disk.path)) as journal:
        journal.backup(copy)
    disk.close()
    return Run(sky, rate_hz, longest, dict(said), store)
