"""From measured dwells to many targets: cores and bandwidth.

Assumptions, stated with the table. Targets are spread over radars of thirty, each a run of its own. A role's CPU time
per dwell is as measured for thirty targets with one planner, with the transport's threads. It adds up over radars, and
over dwells with their rate. One process per system serves the emulator, the allocator, metrics and the router, so where
one of them needs more than a core, the radars are shared out over so many systems. Within a radar the planners share
the tracks evenly, and a dwell must end within its period.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE, Role
from studies.scaling.runs import SINGLE, Latency, Measured

TARGETS, RATES_HZ = (100, 1_000, 10_000), (1.0, 10.0)
USABLE = 0.8  # of a core: what queues need to stay short
READERS = {BY_MESSAGE[kind].name: len(BY_MESSAGE[kind].readers) for kind in (Scan, Truth, Plan, Waveform)}


@dataclass(frozen=True)
class Need:
    """What a number of targets takes at a rate."""

    targets: int
    rate_hz: float
    radars: int
    systems: int  # each with a router, emulator, allocator and metrics of its own
    planners: int | None  # processes, a core each, over all systems; None: the rate cannot be had with any number
    planner_cores: float
    other_cores: float
    megabytes_s: float  # through all routers, in and out
    dwell_ms: float  # with the planners that a radar has


def serial_ms(latency: Latency) -> float:
    """What of a dwell no planner shortens, ms."""
    return latency.emulator + latency.allocator + latency.queueing + latency.transport


def dwell_ms(latency: Latency, planners: int) -> float:
    """Time of a dwell, ms, whose tracks are shared by so many planners on cores of their own."""
    return serial_ms(latency) + latency.planner / planners


def speed_up(latency: Latency, planners: int) -> float:
    """The most that so many planners can gain over one (Amdahl): only the planners' part of a dwell is shared."""
    return dwell_ms(latency, 1) / dwell_ms(latency, planners)


def needs(measured: Iterable[Measured]) -> list[Need]:
    """Of every number of targets and rate, from the largest radar measured with one planner."""
    base = max((run for run in measured if run.planners == 1), key=lambda run: run.n_target)
    return [need(base, targets, rate_hz) for targets in TARGETS for rate_hz in RATES_HZ]


def need(base: Measured, targets: int, rate_hz: float) -> Need:
    """Of one number of targets and one rate."""
    if base.latency is None or not base.cpu_ms or not base.n_byte:
        raise ValueError("the model needs a run over Zenoh with its latency, CPU time and bytes")
    radars = math.ceil(targets / base.n_target)
    cores = {role: 1e-3 * rate_hz * ms for role, ms in base.cpu_ms.items()}  # of one radar
    busiest = max(cores[role] for role in SINGLE)
    systems = math.ceil(radars / max(1, math.floor(USABLE / busiest)))
    planners = _planners_per_radar(base.latency, cores[Role.PLANNER], rate_hz)
    shared = planners if planners and planners > 1 else cores[Role.PLANNER] / USABLE  # several slow radars share one
    n_byte = sum(n * (1 + READERS[topic]) for topic, n in base.n_byte.items())
    return Need(
        targets=targets,
        rate_hz=rate_hz,
        radars=radars,
        systems=systems,
        planners=None if planners is None else math.ceil(radars * shared),
        planner_cores=radars * cores[Role.PLANNER],
        other_cores=radars * sum(cores[role] for role in SINGLE),
        megabytes_s=1e-6 * radars * rate_hz * n_byte,
        dwell_ms=serial_ms(base.latency) if planners is None else dwell_ms(base.latency, planners),
    )


def _planners_per_radar(latency: Latency, cores: float, rate_hz: float) -> int | None:
    """Fewest planners with which a dwell ends in its period and none is busier than it may be; None: no number does."""
    left_ms = 1e3 / rate_hz - serial_ms(latency)
    if left_ms <= 0.0:
        return None
    return max(math.ceil(latency.planner / left_ms), math.ceil(cores / USABLE), 1)
