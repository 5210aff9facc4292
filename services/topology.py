"""Who runs: every process of the system on one page."""

from collections.abc import Callable
from dataclasses import dataclass

from shared.protocol.topics import Role
from shared.wire.runner import Core


@dataclass(frozen=True)
class Start:
    """What a process is told when it starts."""

    name: str
    store: str = ""  # file of the journal, for recorder and metrics
    resume: bool = False  # recorder: go on with the unfinished runs of the journal


# A factory imports its role's module itself: the router needs no compiler, the planner no database.


def _emulator(_: Start) -> Core:
    from services.emulator.core import EmulatorCore

    return EmulatorCore()


def _planner(start: Start) -> Core:
    from services.planner.core import PlannerCore

    return PlannerCore(start.name)


def _allocator(_: Start) -> Core:
    from services.allocator.core import AllocatorCore

    return AllocatorCore()


def _recorder(start: Start) -> Core:
    from services.recorder.core import RecorderCore
    from services.recorder.journal import Journal

    return RecorderCore(Journal(start.store, owner=start.name), resume=start.resume)


def _metrics(start: Start) -> Core:
    from services.metrics.core import MetricsCore

    return MetricsCore(start.store)


@dataclass(frozen=True)
class Service:
    """One kind of process."""

    role: Role
    core: Callable[[Start], Core] | None  # None: the router, which has none
    scalable: bool = False  # any number may run; of the others exactly one
    kernels: bool = False  # runs compiled kernels
    yields: bool = False  # to the other processes, which a run waits for


TOPOLOGY = (
    Service(Role.ROUTER, None),
    Service(Role.RECORDER, _recorder),
    Service(Role.METRICS, _metrics, yields=True),
    Service(Role.EMULATOR, _emulator, kernels=True),
    Service(Role.PLANNER, _planner, scalable=True, kernels=True),
    Service(Role.ALLOCATOR, _allocator, kernels=True),
)

SERVICES = {service.role: service for service in TOPOLOGY}
