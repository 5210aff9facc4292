"""The machine room: every process, how fast it is, and which tracks it owns."""

import math
import time
from collections import deque
from functools import lru_cache
from http import HTTPStatus
from typing import Any, NamedTuple

from anyio import CapacityLimiter
from pydantic_core import to_json
from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Counts, Gathered, Process, counts
from cogradar.services.metrics.queries import running
from cogradar.services.planner.ownership import owner_of, owners
from cogradar.services.web.parameters import asked
from cogradar.services.web.problem_documents import Problem
from cogradar.services.web.run_answers import core_of
from cogradar.services.web.shared import Shared
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.codec import fields
from cogradar.shared.wire.pool.live_names import LiveNames

FOR_S = 1.0  # how long an answer is given again
WINDOW_S = 10.0  # that rates and percentiles are over
GONE_S = 60.0  # without a token or an answer, also where no router answers that could have hidden them
MAX_RUNS = 20  # whose owners are told
_DWELLS = {  # what a role's dwells are counted by: a sample, and its topic
    Role.EMULATOR: ("cogradar_dwell_seconds_count", ""),
    Role.PLANNER: ("cogradar_messages_received_total", "scan"),
    Role.ALLOCATOR: ("cogradar_messages_sent_total", "waveform"),
    Role.RECORDER: ("cogradar_dwells_total", ""),
}
_TOTALS = {  # of an answer, and the sample that is summed over all topics
    "late": "cogradar_plans_late_total",
    "stale": "cogradar_waveforms_stale_total",
    "redelivered": "cogradar_messages_redelivered_total",
    "dropped": "cogradar_messages_dropped_total",
    "full": "cogradar_journal_full",
    "certificate_days": "cogradar_certificate_days",
    "cpu_seconds": "process_cpu_seconds_total",
    "rss_bytes": "process_resident_memory_bytes",
}
_PLANS = ("cogradar_messages_sent_total", "plan", "")
_BEGAN = ("process_start_time_seconds", "", "")


async def processes(request: Request) -> Response:
    """Every process, and which tracks of the running runs it owns; once for all requests within a second."""
    asked(request, ())
    machines: Machines = request.app.state.machines
    if core_of(request).gather is None:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not connected to a router: there are no processes to ask")
    return Response(await machines.answer(), headers={"Cache-Control": "no-store"}, media_type="application/json")


class _Reading(NamedTuple):
    """What all processes had counted at a time."""

    at_s: float
    counts: dict[Process, Counts]


class Machines:
    """What all processes count: now, and WINDOW_S ago as far as somebody asked."""

    def __init__(self, core: MetricsCore) -> None:
        self._core = core
        self._shared = Shared(FOR_S, CapacityLimiter(1))
        self._readings: deque[_Reading] = deque()
        self._live = LiveNames()  # role and name of all, as the planners know each other

    async def answer(self) -> bytes:
        """All of it as JSON."""
        found: bytes = await self._shared.get(None, self._read)
        return found

    def _read(self) -> bytes:
        gather = self._core.gather
        gathered = Gathered({}, set()) if gather is None else gather()
        now = _Reading(time.monotonic(), {process: counts(text) for process, text in gathered.answers.items()})
        while len(self._readings) > 1 and self._readings[1].at_s <= now.at_s - WINDOW_S:
            self._readings.popleft()
        before = self._readings[0] if self._readings and self._readings[0].at_s > now.at_s - 2 * WINDOW_S else None
        self._readings.append(now)
        live = self._there(gathered, now.at_s)
        found = self._owners(tuple(sorted(name for role, name in live if role == Role.PLANNER)))
        busy = {name for tracks in found.values() for name in tracks.values()}
        rows = [
            _row((role, name), now, before)
            | {"starting": role == Role.PLANNER and name in busy and not counted.get(_PLANS)}
            for (role, name), counted in now.counts.items()
        ]
        rows += [_without_numbers(process) for process in live - now.counts.keys()]
        missing = {role for role, name in gathered.silent if not name} - {role for role, _ in live}
        rows += [_without_numbers((role, "")) for role in missing]
        document = {
            "utc_s": time.time(),
            "window_s": None if before is None else now.at_s - before.at_s,
            "processes": sorted(rows, key=lambda row: (list(Role).index(row["role"]), row["name"])),
            "owners": found,
        }
        return to_json(document, inf_nan_mode="null")

    def _there(self, gathered: Gathered, now_s: float) -> set[Process]:
        """Processes that are there: they answer, or their tokens are there, or were a moment ago.

        A process that computes may be too busy to answer; a thread of its own keeps its token alive. A token is missed
        for a moment where the link, or this process, has a hiccup: the rule is the one of the planners.
        """
        present = {f"{role}/{name}" for role, name in gathered.answers.keys() | gathered.silent if name}
        for name in present:
            self._live.appear(name)
        for name in set(self._live.names) - present - self._live.absent.keys():
            self._live.disappear(name, now_s)
        for name in [name for name, since_s in self._live.absent.items() if now_s - since_s > GONE_S]:
            self._live.forget(name)
        self._live.expire(now_s, is_connected=any(role == Role.ROUTER for role, _ in gathered.answers))
        return {(role, name) for role, _, name in (one.partition("/") for one in self._live.names)}

    def _owners(self, planners: tuple[str, ...]) -> dict[str, dict[int, str]]:
        """Planner of each track, counted from 1, of each run that goes on.

        It is what the planners work out themselves, from the live planners.
        """
        runs = running(self._core.store, MAX_RUNS)
        return {row["run"]: _of_run(row, planners) if planners else {} for row in runs}


def _of_run(row: dict[str, Any], names: tuple[str, ...]) -> dict[int, str]:
    """Planner of each track that there is, and that somebody may plan for."""
    run = row["run"]
    if row["is_unknown"]:
        alive = [] if row["scan"] is None else fields(row["scan"])["roster"]["ids"].tolist()
        found = {track + 1: owner_of(run, track, names) for track in alive}
    else:
        found = dict(enumerate(_owners(run, row["n_track"], names), 1))
    return {track: planner for track, planner in found.items() if planner}


@lru_cache(maxsize=4 * MAX_RUNS)
def _owners(run: str, n_track: int, names: tuple[str, ...]) -> list[str]:
    return owners(run, n_track, names)


def _without_numbers(process: Process) -> dict[str, Any]:
    """Of a process that did not answer, or of a role without one."""
    _, name = process
    return _row(process, _Reading(0.0, {process: {}}), None) | {
        "alive": bool(name),
        "answers": False,
        "starting": False,
    }


def _row(process: Process, now: _Reading, before: _Reading | None) -> dict[str, Any]:
    (role, name), counted = process, now.counts[process]
    earlier = before.counts.get(process, {}) if before else {}
    if earlier.get(_BEGAN) != counted.get(_BEGAN):  # it was started again
        earlier = {}
    recent = {key: value - earlier.get(key, 0.0) for key, value in counted.items()}
    spent = {topic: value for (sample, topic, _), value in recent.items() if sample == "cogradar_handling_seconds_sum"}
    busiest = max(spent, key=lambda topic: spent[topic]) if any(spent.values()) else None
    sample, topic = _DWELLS.get(Role(role), ("", ""))
    n_dwell = recent.get((sample, topic, "")) if before and earlier else None
    return {
        "role": role,
        "name": name,
        "alive": True,
        "answers": True,
        "began_utc_s": counted.get(_BEGAN),
        "dwells_per_s": None if n_dwell is None or before is None else n_dwell / (now.at_s - before.at_s),
        **_percentiles("dwell", recent, "cogradar_dwell_seconds", "", (0.5, 0.99)),
        "handling_of": busiest,
        **_percentiles("handling", recent, "cogradar_handling_seconds", busiest or "", (0.5, 0.99)),
        **_percentiles("margin", recent, "cogradar_deadline_margin_seconds", "", (0.5, 0.01)),
        **_percentiles("front_end", recent, "cogradar_scan_seconds", "", (0.5, 0.99)),
        **{name: _total(counted, sample) for name, sample in _TOTALS.items()},
    }


def _total(counted: Counts, sample: str) -> float | None:
    """Sum of a sample over its topics; None if the process has no such."""
    found = [value for (name, _, _), value in counted.items() if name == sample]
    return sum(found) if found else None


def _percentiles(
    name: str, recent: Counts, family: str, topic: str, at: tuple[float, float]
) -> dict[str, float | None]:
    """The p50 and p99 of a histogram, in ms."""
    buckets = [(float(le), n) for (sample, of, le), n in recent.items() if (sample, of) == (f"{family}_bucket", topic)]
    p50, p99 = (quantile(sorted(buckets), share) for share in at)
    return {f"{name}_p50_ms": p50, f"{name}_p99_ms": p99}


def quantile(buckets: list[tuple[float, float]], share: float) -> float | None:
    """Quantile of a histogram of seconds, in ms: within its bucket as if the logarithms were spread evenly.

    buckets : upper edge, s, the last one infinity, and how many are below it; ascending
    returns : None if it is empty; the last finite edge if it is beyond that
    """
    if not buckets or buckets[-1][1] <= 0.0:
        return None
    rank, low, below = share * buckets[-1][1], buckets[0][0] / 2.0, 0.0
    for edge, n in buckets:
        if n >= rank and n > below:
            within = 1.0 if math.isinf(edge) else (rank - below) / (n - below)
            return 1e3 * (low if math.isinf(edge) else low * (edge / low) ** within)
        low, below = edge, n
    return 1e3 * low
