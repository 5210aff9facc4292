"""What a crowded sky costs: processor and memory of the processes, in real time and as fast as they go."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.campaigns.pool import n_core
from cogradar.services.errors import RunFailed, check_stop
from cogradar.services.metrics.processes import MAX_BYTES, counts, read
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses, scratch
from cogradar.services.runs.run import Progress
from cogradar.services.skies.make import Asked, write
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import MAX_TRACKS
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.queries import ask_expositions
from cogradar.shared.wire.session import Session, open_session

SEED = 1
PLANNERS = 2
SETTLED = 30  # dwells that are not counted: by then all are found
MINUTES, RANGE_KM = 3, 100.0
SPARE_GOAL = 0.3  # of the machine, in real time, with as many tracks as there may be
WITHIN_S = 10.0
MB = 1e6


@dataclass(frozen=True)
class Kind:
    """A run to measure."""

    aircraft: int  # that come within three minutes; most are there at the start
    rate_hz: float  # 0: as fast as it goes
    dwells: int


KINDS = tuple(Kind(n, 1.0, 120) for n in (128, 370, 1230))  # some 100, 300 and 1000 tracks at a time


@dataclass(frozen=True)
class Crowd:
    """What a run took."""

    rate_hz: float  # of the dwells
    paced: bool
    tracks: float  # confirmed, when the counting began and when it ended: the mean
    late: float  # share of the plans, mean over the targets
    stale: float  # share of the waveforms
    spare: float  # share of the machine's processors that this run left
    cpu_ms: Mapping[str, float]  # of a dwell, by role
    megabytes: Mapping[str, float]  # resident at the end, by role


@dataclass(frozen=True)
class _Look:
    """What all processes had used, and how far the run was."""

    t: int
    tracks: int
    at_s: float
    cpu_s: dict[str, float]
    megabytes: dict[str, float]


def measure(notify: Callable[[str], None], stop: threading.Event, kinds: Sequence[Kind] = KINDS) -> list[Crowd]:
    """Play each kind of run on services of its own. Raises RunFailed, Interrupted."""
    found = []
    for kind in kinds:
        pace = f"at {kind.rate_hz:g} Hz" if kind.rate_hz else "in lockstep"
        notify(f"{kind.aircraft} aircraft, {kind.dwells} dwells {pace}")
        with scratch() as folder, Launcher(LocalProcesses(PLANNERS), stop) as launcher:
            cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
            found.append(_crowd(kind, Path(folder), launcher.endpoint, stop))
    return found


def _crowd(kind: Kind, folder: Path, endpoint: str, stop: threading.Event) -> Crowd:
    sky = folder / "crowd.toml"
    write(Asked(str(kind.aircraft), MINUTES, SEED, None, None, 0.0, RANGE_KM), sky, force=True)
    scenario = load(str(sky), [f"radar.max_tracks={MAX_TRACKS}"])
    start = RunStart.of(scenario, Strategy.POWER_AWARE, SEED, kind.dwells, kind.rate_hz)
    looks: list[_Look] = []
    latest: Progress | None = None
    tracks = 0
    session = open_session([endpoint], WITHIN_S, partial(check_stop, stop))

    def note(now: Progress) -> None:
        nonlocal latest, tracks
        latest = now
        if now.confirmed is not None:  # a run that is over has no tracks
            tracks = now.confirmed
        if not looks and SETTLED <= now.t < kind.dwells:
            looks.append(_look(session, now.t, tracks))

    with session:
        done = cluster.play_on(endpoint, start, report=note, notify=lambda _: None, stop=stop)
        if not looks or latest is None:
            raise RunFailed("the run was over before anybody could look at it")
        before, after = looks[0], _look(session, latest.t, tracks)
    passed, dwells = after.at_s - before.at_s, after.t - before.t
    cpu_s = {role: after.cpu_s[role] - before.cpu_s[role] for role in after.cpu_s}
    n = sum(row["n"] for row in done.targets)
    late, stale = (sum(row["n"] * (row[key] or 0.0) for row in done.targets) / n for key in ("late", "stale"))
    return Crowd(
        dwells / passed,
        kind.rate_hz > 0.0,
        (before.tracks + after.tracks) / 2.0,
        *(late, stale),
        1.0 - sum(cpu_s.values()) / passed / n_core(),
        {role: 1e3 * spent / dwells for role, spent in cpu_s.items()},
        after.megabytes,
    )


def _look(session: Session, t: int, tracks: int) -> _Look:
    cpu_s, megabytes = defaultdict[str, float](float), defaultdict[str, float](float)
    for (role, _), text in ask_expositions(session, WITHIN_S, MAX_BYTES):
        counted = counts(read(text))
        cpu_s[role] += counted["process_cpu_seconds_total", "", ""]
        megabytes[role] += counted["process_resident_memory_bytes", "", ""] / MB
    return _Look(t, tracks, time.monotonic(), dict(cpu_s), dict(megabytes))


def tables(found: Sequence[Crowd]) -> list[Table]:
    """What the runs took as a whole, and by role."""
    whole = [
        Column("tracks", "{tracks:.0f}"),
        Column("pace", "{pace}", left=True),
        Column("dwells / s", "{rate_hz:.2f}"),
        Column("late %", "{late_percent:.2f}"),
        Column("stale %", "{stale_percent:.2f}"),
        Column("spare %", "{spare_percent:.0f}"),
        Column("CPU ms a track and dwell", "{track_ms:.2f}"),
        Column("of planners", "{planner_ms:.2f}"),
    ]
    rows = [
        asdict(one)
        | {
            "pace": "real time" if one.paced else "lockstep",
            "late_percent": 100.0 * one.late if one.paced else None,
            "stale_percent": 100.0 * one.stale if one.paced else None,
            "spare_percent": 100.0 * one.spare,
            "track_ms": sum(one.cpu_ms.values()) / one.tracks,
            "planner_ms": one.cpu_ms[Role.PLANNER] / one.tracks,
        }
        for one in found
    ]
    by_role = [
        {"tracks": one.tracks, "role": role, "cpu_ms": one.cpu_ms[role], "megabytes": one.megabytes[role]}
        for one in found
        for role in Role
        if role in one.cpu_ms
    ]
    columns = [Column("tracks", "{tracks:.0f}"), Column("role", "{role}", left=True)]
    columns += [Column("CPU ms a dwell", "{cpu_ms:.1f}"), Column("memory MB", "{megabytes:.0f}")]
    title = f"crowded skies, {PLANNERS} planners; goal at {MAX_TRACKS}: {SPARE_GOAL:.0%} spare"
    return [Table(title, whole, rows), Table("by role, all its processes together", columns, by_role)]


def as_json(found: Sequence[Crowd]) -> list[dict[str, Any]]:
    """The same as a document."""
    return [asdict(one) for one in found]
