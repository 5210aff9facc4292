"""Planner worker: holds the belief of every (run, track) it owns, answers each scan with a plan.

Ownership is a hint, not a lock: two owners publish the same plan twice and the allocator takes one; a new owner
rebuilds the track from the scans, which every worker keeps for the runs in progress.
"""

import hashlib
import logging
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shared.messages import Event, Members, Message, Plan, Refused, RunEnd, RunStart, Scan
from shared.scenario import Scenario
from shared.track import Track, confirmed_bins

log = logging.getLogger(__name__)

MAX_EARLY = 1000  # scans kept of runs whose start has not been heard yet
MAX_ENDED = 10_000  # names kept of runs that ended, whose late or repeated messages mean nothing


def owner(run: str, target: int, workers: Sequence[str]) -> str:
    """Worker that holds a track: rendezvous hashing, so only the tracks of a leaving worker move."""
    return max(workers, key=lambda worker: hashlib.blake2b(f"{run}/{target}/{worker}".encode()).digest())


class _Run:
    """What a worker knows of one run: the scans so far, and its own tracks."""

    def __init__(self, start: RunStart) -> None:
        self._start = start
        self.scenario = Scenario.model_validate(start.scenario)
        self._scans: list[Scan] = []  # gapless from k = 0
        self._ahead: dict[int, Scan] = {}  # heard before one of their predecessors
        self._bins: NDArray[np.int64] | None = None  # of the confirmed targets
        self._n_acquisition = 0
        self._tracks: dict[int, tuple[Track, int]] = {}  # target -> track, number of scans it has seen

    def hear(self, scan: Scan) -> bool:
        """Take a scan; true if it extends the gapless history."""
        n_bin, n_target = self.scenario.array.n_bin, self.scenario.n_target
        complete = scan.bins.size == n_bin
        if scan.bins[-1] >= n_bin or scan.beams.size != n_target or (scan.t == 0 and not complete):
            raise Refused(f"scan of {scan.bins.size} cells up to {scan.bins[-1]} with {scan.beams.size} beams")
        if scan.t > 0 and (scan.beams < 0).any():
            raise Refused("scan without a beam for every track")
        if scan.k >= len(self._scans):
            self._ahead[scan.k] = scan
        before = len(self._scans)
        while (k := len(self._scans)) in self._ahead:
            self._scans.append(self._ahead.pop(k))
            if self._bins is None:
                self._bins = confirmed_bins(self.scenario, self._scans)
                self._n_acquisition = len(self._scans)
        return len(self._scans) > before

    def plan(self, target: int) -> Plan | None:
        """Plan of a track after the newest scan, rebuilding the track from the history where needed."""
        if not self._scans:
            return None
        now = self._scans[-1]
        if self._bins is None:
            return Plan(run=now.run, k=now.k, t=now.t, target=target, status="searching")
        start, first = self._start, self._n_acquisition
        track, seen = self._tracks.get(target, (None, 0))
        if track is None:
            bin_ = int(self._bins[target])
            track, seen = Track(self.scenario, start.strategy, start.seed, target, bin_, self._scans[:first]), first
        for scan in self._scans[seen:]:
            track.observe(scan)
        self._tracks[target] = (track, len(self._scans))
        decision = track.decide()
        return Plan(
            run=now.run,
            k=now.k,
            t=now.t,
            target=target,
            status="tracking",
            bin=decision.bin,
            range_km=decision.range_km,
            estimate=decision.estimate,
            detected=decision.detected,
            depleted=decision.depleted,
        )


class PlannerCore:
    """Scan k in, plan k out for each track this worker owns."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._workers: tuple[str, ...] = (name,)
        self._runs: dict[str, _Run] = {}
        self._early: list[Scan] = []
        self._ended: deque[str] = deque(maxlen=MAX_ENDED)

    def handle(self, event: Event) -> Sequence[Message]:
        """Hear a scan and plan; on a change of membership, plan for the tracks that became ours."""
        match event:
            case RunStart() if event.run not in self._runs and event.run not in self._ended:
                self._runs[event.run] = _Run(event)
                early, self._early = self._early, []
                return [answer for scan in early for answer in self._replay(scan)]
            case Scan() if event.run in self._runs:
                run = self._runs[event.run]
                return self._plans(event.run, self._workers) if run.hear(event) else ()
            case Scan() if event.run not in self._ended:
                self._early = [*self._early, event][-MAX_EARLY:]
            case RunEnd():
                self._ended.append(event.run)
                self._runs.pop(event.run, None)
            case Members():
                before, self._workers = self._workers, tuple(sorted({*event.names, self._name}))
                return [plan for run in self._runs for plan in self._plans(run, self._workers, but_not=before)]
            case _:
                pass
        return ()

    def _replay(self, scan: Scan) -> Sequence[Message]:
        """Handle a scan that came before its run's start; one that is refused must not take the start with it."""
        try:
            return self.handle(scan)
        except Refused as refusal:
            log.warning("dropping an early scan of %s: %s", scan.run, refusal)
            return ()

    def _plans(self, run: str, workers: Sequence[str], but_not: Sequence[str] = ()) -> list[Message]:
        """Newest plans of the tracks that are ours among `workers`, without those ours among `but_not` already."""
        mine = [m for m in range(self._runs[run].scenario.n_target) if owner(run, m, workers) == self._name]
        if but_not:
            mine = [m for m in mine if owner(run, m, but_not) != self._name]
        return [plan for m in mine if (plan := self._runs[run].plan(m)) is not None]
