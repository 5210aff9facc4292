"""Planner worker: holds the belief of every (run, track) it owns, answers each scan with a plan.

Ownership is a hint, not a lock: two owners publish the same plan twice and the allocator takes one. A track is a
function of the scans, so a new owner rebuilds it: from the scans it kept, else from those that the store recalls,
which are those since the track's last snapshot.
"""

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from services.delivery.inactivity import Inactivity
from services.delivery.pending import Pending, decoded
from services.delivery.resend import ResendBuffer
from services.planner.owned_track import Held
from services.planner.ownership import owners
from services.planner.recall import Question
from shared.protocol.admission import check_dwell, check_scan, check_snapshot
from shared.protocol.messages import Checkpoint, Event, History, Membership, Message, Plan, Scan, Snapshot, Tick
from shared.scenario.radar_config import RadarConfig
from shared.tracking.track import Track, confirmed_bins, rehearse
from shared.wire.runner import Flush

SEARCH_SHARE = 0.4  # of a period, for the searches of all tracks; the allocator waits for half a period
PATIENCE_S = 1.0  # in real time: how long a track waits for a scan that is missing, while newer ones come
KEPT_SCANS = 512  # newest ones of each run, from which a track that becomes ours is rebuilt without the store


class _Run:
    """What a worker knows of one run: the newest scans, and its own tracks."""

    def __init__(self, start: Checkpoint, clock: Callable[[], float]) -> None:
        self._start = start
        self._clock = clock
        self._period_s = 1.0 / start.rate_hz if start.rate_hz else 0.0  # 0: in lockstep
        self._deadline_s = math.inf
        self.radar = RadarConfig.model_validate(start.radar)
        self._resend = ResendBuffer(start.k)
        self.mine: tuple[int, ...] = ()
        self._acquisition: list[Scan] = []  # gapless from k = 0 to the one that confirms the last target
        self._bins: NDArray[np.int64] | None = None  # of the confirmed targets
        self._scans: dict[int, Scan] = {}
        self._newest = -1
        self._tracks: dict[int, Held] = {}
        self._question = Question(start.run)
        self.is_behind = False  # in real time: scans have come that no track has seen

    def own(self, targets: Iterable[int]) -> Iterable[Message | Flush]:
        """Hold these tracks and no others."""
        self.mine = tuple(targets)
        self._tracks = {m: held for m, held in self._tracks.items() if m in self.mine}
        return self._go_on_or_later()

    def hear(self, scan: Scan) -> Iterable[Message | Flush]:
        """Take a scan: plans of all dwells that it completes; a repeated one changes nothing."""
        self._keep(scan)
        return self._go_on_or_later()

    def catch_up(self) -> Iterable[Message | Flush]:
        """In real time: observe the scans that have come, and plan for the newest within half a period."""
        self.is_behind = False
        self._deadline_s = self._clock() + SEARCH_SHARE * self._period_s
        return self._go_on()

    def remember(self, history: History) -> Iterable[Message | Flush]:
        """Take scans or snapshots that were recalled."""
        if history.topic == "scan":
            self._question.answer_by_scans(history.k)
        for payload in history.payloads:
            match decoded(payload):
                case Scan(run=self._start.run) as scan:
                    self._keep(scan)
                case Snapshot(run=self._start.run) as snapshot:
                    self._restore(snapshot)
                case _:
                    pass
        return self._go_on_or_later()

    def is_rewound_by(self, checkpoint: Checkpoint) -> bool:
        """Whether the run must begin anew at this checkpoint."""
        return self._resend.is_rewound_by(checkpoint)

    def checkpoint(self, checkpoint: Checkpoint) -> Sequence[Message]:
        """Resend what the recorder waits for, and ask for the scans that we wait for."""
        again = self._resend.acknowledge(checkpoint)
        return [*again, *self._snapshots(), *self._missing(again=True)]

    def prepare(self) -> bool:
        """Predict where one of the tracks will be in the next dwell; false if all are predicted."""
        return not self.is_behind and any(held.track.prepare() for held in self._tracks.values())

    def _go_on_or_later(self) -> Iterable[Message | Flush]:
        """Go on at once; in real time when nothing newer waits, which a tick tells."""
        if self._period_s:
            self.is_behind = True
            return ()
        return self._go_on()

    def _go_on(self) -> Iterator[Message | Flush]:
        """Advance the acquisition, then every track, as far as the scans reach; ask for those that are missing.

        Plans go out in lots: while this worker plans for the next tracks, the others read those of the last. In real
        time all tracks are observed first; what is left of the time is for their searches, in equal parts.
        """
        for plan in itertools.chain(self._acquire(), self._advance_all()):
            if isinstance(plan, Plan):
                self._resend.add(plan.k, (plan,))
            yield plan
        for k in [k for k in self._scans if k <= self._newest - KEPT_SCANS]:
            del self._scans[k]
        yield from self._snapshots()
        yield from self._missing(again=False)

    def _keep(self, scan: Scan) -> None:
        check_dwell(scan.k, self.radar, self._start.dwells)
        check_scan(scan, self.radar)
        self._scans.setdefault(scan.k, scan)
        self._newest = max(self._newest, scan.k)

    def _restore(self, snapshot: Snapshot) -> None:
        """Let a track of ours that is behind its snapshot go on from there."""
        check_snapshot(snapshot, self.radar)
        self._question.answer_by_snapshot(snapshot.target, snapshot.k)
        if snapshot.target in self.mine and self._next_k(snapshot.target) <= snapshot.k:
            track = Track.restored(self.radar, self._start.strategy, self._start.seed, snapshot)
            self._tracks[snapshot.target] = Held(track, snapshot.k + 1, self._newest)

    def _snapshots(self) -> Sequence[Snapshot]:
        """Those that can be said by now. Nobody says them again if they are lost: the next ones come."""
        return [said for held in self._tracks.values() if (said := held.snapshot(self._resend.k)) is not None]

    def _acquire(self) -> list[Plan]:
        said: list[Plan] = []
        while self._bins is None and (k := len(self._acquisition)) in self._scans:
            self._acquisition.append(self._scans[k])
            self._bins = confirmed_bins(self.radar, self._acquisition)
            if self._bins is None and k >= (self._newest if self._period_s else self._resend.k):
                said += [self._searching(k, m) for m in self.mine]
        return said

    def _advance_all(self) -> Iterator[Plan | Flush]:
        for advance in (self._advance, self._plan_newest) if self._period_s else (self._advance,):
            for lot in _lots(self.mine):
                if plans := [plan for m in lot for plan in advance(m)]:
                    yield from plans
                    yield Flush()

    def _advance(self, target: int) -> Iterator[Plan]:
        """Plans of one track for the dwells that are not complete in the store; all before them are only observed."""
        held = self._tracks.get(target)
        if held is None:
            if self._bins is None:
                return
            settings = self._start
            bin_ = int(self._bins[target])
            track = Track(self.radar, settings.strategy, settings.seed, target, bin_, self._acquisition)
            held = self._tracks[target] = Held(track, len(self._acquisition), self._newest)
            yield from self._decide(held, self._acquisition[-1], target)
        while (scan := self._next_scan(held)) is not None:
            held.observe(scan)
            yield from self._decide(held, scan, target)

    def _next_scan(self, held: Held) -> Scan | None:
        """The scan that a track lacks; in real time, where dwells may never happen, nobody waits for it for long."""
        waited = (self._newest - max(held.k, held.since)) * self._period_s
        if held.k not in self._scans and waited > PATIENCE_S:
            following = min(k for k in self._scans if k > held.k)
            held.track.coast(following)
            held.k = following
        return self._scans.get(held.k)

    def _decide(self, held: Held, scan: Scan, target: int) -> list[Plan]:
        if self._period_s or scan.k < self._resend.k:
            return []
        return [self._plan(held, scan, target)]

    def _plan_newest(self, target: int) -> Iterator[Plan]:
        held = self._tracks.get(target)
        if held is not None and held.k > self._newest and held.planned < self._newest:
            yield self._plan(held, self._scans[self._newest], target)

    def _plan(self, held: Held, scan: Scan, target: int) -> Plan:
        held.planned = scan.k
        decision = held.track.decide(self._share_of_time(target) if self._period_s else None)
        return Plan(
            run=scan.run,
            k=scan.k,
            t=scan.t,
            target=target,
            status="tracking",
            bin=decision.bin,
            range_km=decision.range_km,
            estimate=decision.estimate,
            detected=decision.detected,
            depleted=decision.depleted,
            n_sim=decision.n_sim,
        )

    def _share_of_time(self, target: int) -> Callable[[], bool]:
        """Whether a track's search has time left: what there is to the deadline is shared evenly by those to come."""
        now_s, to_come = self._clock(), len(self.mine) - self.mine.index(target)
        until_s = now_s + (self._deadline_s - now_s) / to_come
        return lambda: self._clock() < until_s

    def _searching(self, k: int, target: int) -> Plan:
        return Plan(run=self._start.run, k=k, t=0, target=target, status="searching")

    def _missing(self, *, again: bool) -> Sequence[Message]:
        """The question for the first scan that a track lacks although later ones are there, or for its snapshot."""
        lacking = {m: self._next_k(m) for m in self.mine}
        known = max(self._newest, self._resend.k - 1)
        first = min(lacking.values(), default=known + 1)
        if first > known or first in self._scans:
            return []
        return self._question.ask(first, [m for m, k in lacking.items() if k == first], again=again)

    def _next_k(self, target: int) -> int:
        """The scan that a track needs next; one that has no belief needs the acquisition."""
        return self._tracks[target].k if target in self._tracks else len(self._acquisition)


def _lots(tracks: Sequence[int]) -> Iterator[Sequence[int]]:
    """Half of the tracks, half of the rest, and so on.

    To wake the readers for every plan costs all of them more than to read it; but they should not have to read many
    once the last one is made.
    """
    while tracks:
        half = (len(tracks) + 1) // 2
        yield tracks[:half]
        tracks = tracks[half:]


class PlannerCore:
    """Scan k in, plan k out for each track this worker owns."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` limits the searches of runs in real time; in lockstep it is never read."""
        self._name = name
        self._clock = clock
        self._workers: tuple[str, ...] = (name,)
        self._runs: dict[str, _Run] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def has_deferred(self) -> bool:
        """Whether a run in real time has scans that no track has observed."""
        return any(run.is_behind for run in self._runs.values())

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        """Hear a scan and plan; on a change of membership, take up the tracks that became ours."""
        for run in self._inactivity.after(event):
            self._runs.pop(run, None)
        match event:
            case Checkpoint():
                return self._checkpoint(event)
            case Scan() if event.run in self._runs:
                return self._runs[event.run].hear(event)
            case Scan():
                self._pending.add(event)
            case History(topic="scan" | "snapshot") if event.run in self._runs:
                return self._runs[event.run].remember(event)
            case Membership():
                self._workers = tuple(sorted({*event.names, self._name}))
                return [said for name, run in self._runs.items() for said in self._own(run, name)]
            case Tick():
                return itertools.chain.from_iterable(run.catch_up() for run in self._runs.values() if run.is_behind)
            case _:
                pass
        return ()

    def prepare(self) -> bool:
        """Predict one track while no scan waits."""
        return any(run.prepare() for run in self._runs.values())

    def _checkpoint(self, checkpoint: Checkpoint) -> Iterable[Message | Flush]:
        """Begin a run, go on with it, or forget it."""
        name = checkpoint.run
        if checkpoint.ended:
            self._runs.pop(name, None)
            self._pending.forget(name)
            return ()
        if name in self._runs and not self._runs[name].is_rewound_by(checkpoint):
            return self._runs[name].checkpoint(checkpoint)
        self._runs[name] = run = _Run(checkpoint, self._clock)
        if checkpoint.rate_hz:
            rehearse(run.radar, checkpoint.strategy)
        return [*self._own(run, name), *self._pending.replay(name, self.handle)]

    def _own(self, run: _Run, name: str) -> Iterable[Message | Flush]:
        holders = owners(name, run.radar.tracks, self._workers)
        return run.own(m for m, worker in enumerate(holders) if worker == self._name)
