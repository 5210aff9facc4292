"""What it brings to ask for the accuracy of tracks: in how many dwells they have it, and what the others lose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

import numpy as np

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.delivery.accuracy import check_accuracies
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import check_stop
from cogradar.services.planner.core import PlannerCore
from cogradar.services.skies.make import Asked, write
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import (
    EmulatorCheckpoint,
    Message,
    Plan,
    Refused,
    RunStart,
    Truth,
    Waveform,
    roster_of,
)
from cogradar.shared.protocol.orders import Accuracy, Order
from cogradar.shared.protocol.topics import Role, topics_read_by
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import across_km
from cogradar.shared.wire.runner import Core

AIRCRAFT, MINUTES, RANGE_KM = 20, 3, 100.0
FROM, SETTLED = 30, 10  # the dwell of the orders, and dwells after it that are not counted
ASKED = 3  # tracks at a time
PARTS = (2.0 / 3.0, 0.5)  # of what they have without being asked for


@dataclass
class Played:
    """What a run was, by dwell and track."""

    km: dict[tuple[int, int], float] = field(default_factory=dict)  # sigma across the line of sight
    off: dict[tuple[int, int], float] = field(default_factory=dict)  # true error across, of the nearest target
    power: dict[tuple[int, int], float] = field(default_factory=dict)
    detected: dict[tuple[int, int], bool] = field(default_factory=dict)
    search: dict[int, float] = field(default_factory=dict)
    plans: dict[int, Plan] = field(default_factory=dict)  # after the dwell before the orders'
    confirmed: dict[int, set[int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Row:
    """A track that was asked for."""

    seed: int
    track: int
    part: float
    km: float
    refused: str
    met: float  # share of dwells
    nees: float  # mean squared true error across over its variance, 1 of honest beliefs
    usual_met: float  # the same without the order
    power: float  # mean of the array's
    usual_power: float
    others: float  # detections of the others per look,
    usual_others: float  # ... without any order
    search: float  # mean share of the power
    usual_search: float


def measure(seeds: Sequence[int], dwells: int, tell: Callable[[str], None], stop: Event) -> list[Row]:
    """Play a made-up sky of each seed without orders, and once for each part. Raises Interrupted."""
    found = []
    for seed in seeds:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "sky.toml"
            write(Asked(str(AIRCRAFT), MINUTES, seed, None, None, 0.0, RANGE_KM), file, force=True)
            start = RunStart.of(load(str(file)), Strategy.POWER_AWARE, seed, dwells)
        tell(f"seed {seed}")
        usual = _played(start, (), stop)
        counted = range(FROM + SETTLED, dwells)
        last = dwells - 1
        known = [m for m in sorted(usual.confirmed[FROM]) if m in usual.confirmed.get(last, ())]
        tracks = [known[i] for i in np.linspace(0, len(known) - 1, ASKED).astype(int).tolist()]
        for part in PARTS:
            km = {m: part * float(np.median([usual.km[k, m] for k in counted if (k, m) in usual.km])) for m in tracks}
            found += _asked(start, usual, {m: max(one, 1e-3) for m, one in km.items()}, part, counted, stop)
    return found


def _asked(
    start: RunStart, usual: Played, km: dict[int, float], part: float, counted: Sequence[int], stop: Event
) -> list[Row]:
    """The same run with the orders that a recorder grants."""
    radar = RadarConfig.model_validate(start.scenario["radar"])
    granted, refused = dict[int, float](), dict[int, str]()
    for track, one in km.items():
        try:
            check_accuracies(radar, start.strategy, 1.0, granted | {track: one}, track, usual.plans)
            granted[track] = one
        except Refused as error:
            refused[track] = str(error)
    orders = [Order(n=n, k=FROM, action=Accuracy(track=m, km=one)) for n, (m, one) in enumerate(granted.items(), 1)]
    run = _played(start, orders, stop)
    others = {m for _, m in usual.km} - set(granted)
    return [
        Row(
            seed=start.seed,
            track=track + 1,
            part=part,
            km=one,
            refused=refused.get(track, ""),
            met=_mean([run.km[k, track] <= one for k in counted if (k, track) in run.km]),
            nees=_mean([(run.off[k, track] / run.km[k, track]) ** 2 for k in counted if (k, track) in run.off]),
            usual_met=_mean([usual.km[k, track] <= one for k in counted if (k, track) in usual.km]),
            power=_mean([run.power.get((k, track), 0.0) for k in counted]),
            usual_power=_mean([usual.power.get((k, track), 0.0) for k in counted]),
            others=_detections(run, others, counted),
            usual_others=_detections(usual, others, counted),
            search=_mean([run.search[k] for k in counted if k in run.search]),
            usual_search=_mean([usual.search[k] for k in counted if k in usual.search]),
        )
        for track, one in km.items()
    ]


def _detections(run: Played, tracks: set[int], counted: Sequence[int]) -> float:
    return _mean([run.detected[k, m] for k in counted for m in tracks if m in run.confirmed.get(k, ())])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _played(start: RunStart, orders: Sequence[Order], stop: Event) -> Played:
    """A run under these orders, one process of each role."""
    cores: dict[Role, Core] = {
        Role.EMULATOR: EmulatorCore(SimulatedFrontEnd.open),
        Role.PLANNER: PlannerCore("p"),
        Role.ALLOCATOR: AllocatorCore(),
    }
    reads = {role: tuple(topic.message for topic in topics_read_by(role)) for role in cores}
    settings = {name: getattr(start, name) for name in ("run", "strategy", "dwells", "rate_hz")}
    settings |= {"radar": start.scenario["radar"], "seed": radar_seed(start.seed), "k": 0, "t": 0}
    world = {"world": start.scenario["world"], "world_seed": start.seed}
    waiting: list[Message] = [start, EmulatorCheckpoint(**settings, **world, orders=list(orders))]
    found, truths = Played(), dict[int, Truth]()
    while waiting:
        check_stop(stop)
        message = waiting.pop(0)
        for role, core in cores.items():
            if isinstance(message, reads[role]):
                waiting.extend(answer for answer in core.handle(message) if isinstance(answer, Message))
        match message:
            case Truth():
                truths[message.k] = message
            case Waveform():
                roster = roster_of(message)
                found.search[message.k + 1] = roster.search_share
                for track, share in zip(roster.ids.tolist(), message.shares.sum(axis=1).tolist(), strict=True):
                    found.power[message.k + 1, track] = share
            case Plan() if message.status == "tracking":
                _note(found, message, truths[message.k])
            case _:
                pass
    return found


def _note(found: Played, plan: Plan, truth: Truth) -> None:
    """What a plan says of its track, and how far it is off across the line of sight."""
    at, (mean, covariance) = (plan.k, plan.target), plan.in_plane
    found.km[at], found.detected[at] = across_km(mean, covariance), plan.detected
    if plan.confirmed:
        found.confirmed.setdefault(plan.k, set()).add(plan.target)
    if plan.k == FROM - 1:
        found.plans[plan.target] = plan
    off = truth.measured_states[truth.bins >= 0][:, ::2] - mean[::2]
    if off.size:
        nearest = off[np.argmin(np.hypot(off[:, 0], off[:, 1]))]
        found.off[at] = float(nearest @ np.array([-mean[2], mean[0]])) / float(np.hypot(mean[0], mean[2]))


def tables(rows: Sequence[Row]) -> list[Table]:
    """Each part: over all tracks that were granted, then over seeds and tracks."""
    columns = [
        Column("asked, of the usual sigma", "{part:.2f}"),
        Column("granted", "{granted} of {n}"),
        Column("dwells within it", "{met:.3f}"),
        Column("without orders", "{usual_met:.3f}"),
        Column("NEES across", "{nees:.2f}"),
        Column("power, times", "{times:.1f}"),
        Column("search's share", "{usual_search:.2f} -> {search:.2f}"),
        Column("others' detections", "{usual_others:.3f} -> {others:.3f}"),
    ]
    whole = []
    for part in PARTS:
        of = [row for row in rows if row.part == part]
        granted = [row for row in of if not row.refused]
        names = ("met", "usual_met", "nees", "search", "usual_search", "others", "usual_others")
        means = {name: _mean([getattr(row, name) for row in granted]) for name in names}
        times = float(np.median([row.power / row.usual_power for row in granted])) if granted else float("nan")
        whole.append({"part": part, "granted": len(granted), "n": len(of), "times": times, **means})
    each = [
        Column("seed", "{seed}"),
        Column("track", "{track}"),
        Column("asked km", "{km:.4f}"),
        Column("within", "{met:.3f}"),
        Column("without", "{usual_met:.3f}"),
        Column("NEES", "{nees:.2f}"),
        Column("power", "{usual_power:.3f} -> {power:.3f}"),
        Column("refused", "{refused}", left=True),
    ]
    title = f"{ASKED} tracks at a time of {AIRCRAFT} aircraft, from dwell {FROM + SETTLED} on"
    return [Table(title, columns, whole), Table("each track", each, [vars(row) for row in rows])]
