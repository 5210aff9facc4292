"""The cores of one run, driven by hand: what the services' tests feed and compare."""

from collections.abc import Sequence

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.front_end import OpenFrontEnd
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    Lead,
    Message,
    Plan,
    RunStart,
    Scan,
    Waveform,
)
from cogradar.shared.protocol.orders import Order
from cogradar.shared.protocol.topics import Role, topics_read_by
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.runner import Core

SMOKE = load("smoke")


def smoke_start(strategy: Strategy = Strategy.POWER_AWARE, seed: int = 1, dwells: int = 4, run: str = "r") -> RunStart:
    return RunStart.of(SMOKE, strategy, seed, dwells).model_copy(update={"run": run})


def checkpoint(start: RunStart, k: int = 0, t: int = 0, **flags: int) -> EmulatorCheckpoint:
    """Checkpoint of a run of which dwells 0 .. k-1 are acknowledged; with the world, so that all cores can be fed."""
    settings = {name: getattr(start, name) for name in ("run", "strategy", "dwells", "rate_hz")}
    settings |= {
        "radar": start.scenario["radar"],
        "seed": radar_seed(start.seed),
        "k": k,
        "t": t,
        "revision": k,
        "leads": [Lead(epoch=flags["epoch"], revision=0)] if "epoch" in flags else [],
        **flags,
    }
    return EmulatorCheckpoint(**settings, world=start.scenario["world"], world_seed=start.seed)


def checkpoints(start: RunStart, k: int = 0, t: int = 0, **flags: int) -> list[Message]:
    """The same as the recorder sends it: without the world to the radar's processes, with it to the emulator."""
    full = checkpoint(start, k, t, **flags)
    return [Checkpoint(**{name: getattr(full, name) for name in Checkpoint.model_fields}), full]


def smoke_begin(strategy: Strategy = Strategy.POWER_AWARE, dwells: int = 4) -> EmulatorCheckpoint:
    """The first checkpoint of a run, with which it begins for all but the recorder."""
    return checkpoint(smoke_start(strategy, dwells=dwells))


def play(
    start: RunStart, open_front_end: OpenFrontEnd = SimulatedFrontEnd.open, orders: Sequence[Order] = ()
) -> list[Message]:
    """Every message of a run under these orders, in the order sent: emulator, one planner, allocator."""
    cores: dict[Role, Core] = {
        Role.EMULATOR: EmulatorCore(open_front_end),
        Role.PLANNER: PlannerCore("p"),
        Role.ALLOCATOR: AllocatorCore(),
    }
    reads = {role: tuple(topic.message for topic in topics_read_by(role)) for role in cores}
    said: list[Message] = [start, checkpoint(start).model_copy(update={"orders": list(orders)})]
    for message in said:  # grows while it is read
        for role, core in cores.items():
            if isinstance(message, reads[role]):
                said.extend(answer for answer in core.handle(message) if isinstance(answer, Message))
    return said


def scans(said: list[Message]) -> list[Scan]:
    return [message for message in said if isinstance(message, Scan)]


def plans(said: list[Message]) -> list[Plan]:
    return [message for message in said if isinstance(message, Plan)]


def waveforms(said: list[Message]) -> list[Waveform]:
    return [message for message in said if isinstance(message, Waveform)]
