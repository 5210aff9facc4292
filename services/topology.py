"""Who runs: every process of the system on one page."""

from collections.abc import Callable
from dataclasses import dataclass

from shared.topics import Role
from shared.wire.runner import Core

# A factory imports its role's module itself: the router needs no compiler, the planner no database.


def _emulator(name: str, store: str) -> Core:  # noqa: ARG001 - one signature for all
    from services.emulator import EmulatorCore

    return EmulatorCore()


def _planner(name: str, store: str) -> Core:  # noqa: ARG001
    from services.planner import PlannerCore

    return PlannerCore(name)


def _allocator(name: str, store: str) -> Core:  # noqa: ARG001
    from services.allocator import AllocatorCore

    return AllocatorCore()


def _metrics(name: str, store: str) -> Core:  # noqa: ARG001
    from services.metrics import MetricsCore
    from services.store import Store

    return MetricsCore(Store(store))


@dataclass(frozen=True)
class Service:
    """One kind of process."""

    role: Role
    purpose: str
    core: Callable[[str, str], Core] | None  # (name, store file) -> core; None: the router, which has none
    scalable: bool = False  # any number may run; of the others exactly one
    kernels: bool = False  # runs compiled kernels


TOPOLOGY = (
    Service(Role.ROUTER, "passes messages between all others", None),
    Service(Role.METRICS, "stores every message, scores targets, answers queries", _metrics),
    Service(Role.EMULATOR, "moves the targets, makes echoes and the receiver's statistic", _emulator, kernels=True),
    Service(Role.PLANNER, "holds a belief per target and searches for its next bin", _planner, True, kernels=True),
    Service(Role.ALLOCATOR, "splits the transmit power over the planned bins", _allocator, kernels=True),
)

SERVICES = {service.role: service for service in TOPOLOGY}
