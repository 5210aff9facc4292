"""What runs: every process of the system on one page."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.wire.runner import Core


@dataclass(frozen=True)
class Start:
    """What a process is told when it starts."""

    name: str
    store: str = ""  # journal, for recorder and metrics: a file, or an address of PostgreSQL
    resume: bool = False  # recorder: go on with the unfinished runs of the journal
    keep_runs: int | None = None  # recorder: how many ended runs the journal keeps at most,
    keep_days: float | None = None  # ... and for how long
    keep_hours: float | None = None  # ... of a run without an end, by the run's clock,
    keep_bytes: int | None = None  # ... and how much of it; None: as `Retention` has it
    stands_by: bool = True  # recorder: while another process has the journal; False: it is an error
    front_end: str = "simulated"  # emulator: a name of `cogradar.services.front_ends`
    scenario: Scenario | None = None  # operator: of its runs; None: it begins none
    rate_hz: float = 0.0  # operator: their dwells per second
    http: str = ""  # metrics: where it serves HTTP (`cogradar.services.web.address`); empty: nowhere
    connect: str = ""  # endpoints of the router; empty: there is none
    check: Callable[[], None] = lambda: None  # raises Interrupted when the process is to end

    @property
    def is_spread(self) -> bool:
        """Whether runs may be shared out over several emulators: a receiver is led by one, and the others stand by."""
        return self.front_end == Start.front_end


# A factory imports its role's module itself: the router needs no compiler, the planner no database.


def _emulator(start: Start) -> Core:
    from cogradar.services.emulator.core import EmulatorCore
    from cogradar.services.front_ends import open_front_end

    return EmulatorCore(open_front_end(start.front_end, start.connect, start.check))


def _planner(start: Start) -> Core:
    from cogradar.services.planner.core import PlannerCore

    return PlannerCore(start.name)


def _allocator(start: Start) -> Core:
    from cogradar.services.allocator.core import AllocatorCore

    return AllocatorCore(start.name)


def _recorder(start: Start) -> Core:
    from cogradar.services.recorder.full_disk import Recorder
    from cogradar.services.recorder.journal import Journal, Retention

    keep = Retention(start.keep_runs, start.keep_days, start.keep_hours)
    if start.keep_bytes is not None:
        keep = replace(keep, bytes_of_run=start.keep_bytes)
    return Recorder(Journal(start.store, owner=start.name), resume=start.resume, keep=keep, beside=_in_thread)


def _in_thread(work: Callable[[], None]) -> None:
    threading.Thread(target=work, name="beside", daemon=True).start()


def _metrics(start: Start) -> Core:
    from cogradar.services.web.server import ServedMetrics

    return ServedMetrics(start.store, start.http)


def _operator(start: Start) -> Core:
    from cogradar.services.operator.core import OperatorCore

    return OperatorCore(start.scenario, start.rate_hz)


@dataclass(frozen=True)
class Service:
    """One kind of process."""

    role: Role
    core: Callable[[Start], Core] | None  # None: the router, which has none
    scalable: bool = False  # any number may run; of the others exactly one, which a second one is told at its start
    kernels: bool = False  # runs compiled kernels
    yields: bool = False  # to the other processes, which a run waits for

    def number(self, planners: int, pool: int = 1) -> int:
        """How many of them there are, with so many planners and so many processes of each other role that is a pool."""
        if not self.scalable:
            return 1
        return planners if self.role is Role.PLANNER else pool


# What a run needs.
TOPOLOGY = (
    Service(Role.ROUTER, None),
    Service(Role.RECORDER, _recorder),
    Service(Role.METRICS, _metrics, yields=True),
    Service(Role.EMULATOR, _emulator, scalable=True, kernels=True),
    Service(Role.PLANNER, _planner, scalable=True, kernels=True),
    Service(Role.ALLOCATOR, _allocator, scalable=True, kernels=True),
)

OPERATOR = Service(Role.OPERATOR, _operator)  # begins runs of its own; any other run does without it
SERVICES = {service.role: service for service in (*TOPOLOGY, OPERATOR)}
