"""One run as a planner knows it: the newest scans, and the tracks that this worker owns."""

import itertools
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Sequence

from services.delivery.pending import decoded
from services.delivery.resend import ResendBuffer
from services.planner.decision import decide, warm_up
from services.planner.owned_track import OwnedTrack, detections_of, state_of
from services.planner.recall import RecallRequest
from shared.protocol.admission import check_dwell, check_scan, check_snapshot
from shared.protocol.messages import Checkpoint, Message, Plan, Scan
from shared.protocol.recovery import History, Snapshot
from shared.scenario.radar_config import RadarConfig
from shared.tracking.model import TrackerModel
from shared.tracking.track import Acquisition, start
from shared.wire.runner import Flush

log = logging.getLogger(__name__)

SEARCH_SHARE = 0.4  # of a period, for the searches of all tracks; the allocator waits for half a period
PATIENCE_S = 1.0  # in real time: how long a track waits for a scan that is missing, while newer ones come
KEPT_SCANS = 512  # newest ones of each run, from which a track that changes hands is rebuilt without a recall


class PlannedRun:
    """Scans in, plans of the owned tracks out."""

    def __init__(self, checkpoint: Checkpoint, clock: Callable[[], float]) -> None:
        self._run, self._dwells = checkpoint.run, checkpoint.dwells
        self._clock = clock
        self._period_s = 1.0 / checkpoint.rate_hz if checkpoint.rate_hz else 0.0  # 0: in lockstep
        self._deadline_s = math.inf
        self.radar = RadarConfig.model_validate(checkpoint.radar)
        self._model = TrackerModel.of(self.radar, checkpoint.strategy, checkpoint.seed)
        self._resend = ResendBuffer(checkpoint.k)
        self._owned: tuple[int, ...] = ()
        self._acquisition = Acquisition(self._model)  # gapless from k = 0 to the one that confirms the last target
        self._scans: dict[int, Scan] = {}
        self._newest = -1
        self._tracks: dict[int, OwnedTrack] = {}
        self._recall = RecallRequest(self._run)
        self.is_behind = False  # in real time: scans have come that no track has observed
        if self._period_s:
            warm_up(self.radar.planner, self._model)

    @property
    def n_owned(self) -> int:
        """Number of tracks that this worker owns."""
        return len(self._owned)

    def own(self, targets: Iterable[int]) -> Iterable[Message | Flush]:
        """Own these tracks and no others."""
        before, self._owned = self._owned, tuple(targets)
        if before != self._owned:
            tracks = ", ".join(str(m + 1) for m in self._owned) or "none"
            log.info("%s: owns tracks %s", self._run, tracks)
        self._tracks = {m: track for m, track in self._tracks.items() if m in self._owned}
        return self._advance_or_defer()

    def receive(self, scan: Scan) -> Iterable[Message | Flush]:
        """Take a scan: plans of all dwells that it completes; a repeated one changes nothing."""
        self._keep(scan)
        return self._advance_or_defer()

    def receive_history(self, history: History) -> Iterable[Message | Flush]:
        """Take scans or snapshots that were recalled."""
        if history.topic == "scan":
            self._recall.receive_scans(history.k)
        for payload in history.payloads:
            match decoded(payload):
                case Scan(run=self._run) as scan:
                    self._keep(scan)
                case Snapshot(run=self._run) as snapshot:
                    self._restore(snapshot)
                case _:
                    pass
        return self._advance_or_defer()

    def catch_up(self) -> Iterable[Message | Flush]:
        """In real time: observe the scans that have come, and plan for the newest within half a period."""
        self.is_behind = False
        self._deadline_s = self._clock() + SEARCH_SHARE * self._period_s
        return self._advance()

    def is_rewound_by(self, checkpoint: Checkpoint) -> bool:
        """Whether the run must begin anew at this checkpoint."""
        return self._resend.is_rewound_by(checkpoint)

    def acknowledge(self, checkpoint: Checkpoint) -> Sequence[Message]:
        """Drop what is acknowledged; resend what the recorder asks for, and ask for the scans that tracks lack."""
        again = self._resend.acknowledge(checkpoint)
        return [*again, *self._snapshots(), *self._missing(again=True)]

    def prepare(self) -> bool:
        """Predict where one of the tracks will be in the next dwell; false if all are predicted."""
        return not self.is_behind and any(track.prepare() for track in self._tracks.values())

    def _advance_or_defer(self) -> Iterable[Message | Flush]:
        """Advance at once; in real time when no newer message waits, which a tick tells."""
        if self._period_s:
            self.is_behind = True
            return ()
        return self._advance()

    def _advance(self) -> Iterator[Message | Flush]:
        """Advance the acquisition, then every track, as far as the scans reach; ask for those that are missing.

        Plans go out in batches: while this worker plans for the next tracks, the others read those of the last. In real
        time all tracks are observed first; what is left of the time is for their searches, in equal parts.
        """
        for plan in itertools.chain(self._acquire(), self._advance_tracks()):
            if isinstance(plan, Plan):
                self._resend.add(plan.k, (plan,))
            yield plan
        for k in [k for k in self._scans if k <= self._newest - KEPT_SCANS]:
            del self._scans[k]
        yield from self._snapshots()
        yield from self._missing(again=False)

    def _keep(self, scan: Scan) -> None:
        check_dwell(scan.k, self.radar, self._dwells)
        check_scan(scan, self.radar)
        self._scans.setdefault(scan.k, scan)
        self._newest = max(self._newest, scan.k)

    def _restore(self, snapshot: Snapshot) -> None:
        """Let an owned track that is behind its snapshot continue from there."""
        check_snapshot(snapshot, self.radar)
        self._recall.receive_snapshot(snapshot.target, snapshot.k)
        if snapshot.target in self._owned and self._next_k(snapshot.target) <= snapshot.k:
            self._tracks[snapshot.target] = OwnedTrack(self._model, state_of(snapshot), self._newest)

    def _snapshots(self) -> Sequence[Snapshot]:
        """Those that can be sent by now. They are never sent again: the next one does as well."""
        pending = (track.snapshot(self._run, self._resend.k) for track in self._tracks.values())
        return [snapshot for snapshot in pending if snapshot is not None]

    def _acquire(self) -> Iterator[Plan]:
        """Plans of the dwells after which the targets are still searched for."""
        while self._acquisition.bins is None and (k := len(self._acquisition.scans)) in self._scans:
            bins = self._acquisition.add(detections_of(self._scans[k]))
            if bins is None and k >= (self._newest if self._period_s else self._resend.k):
                yield from (Plan(run=self._run, k=k, t=0, target=m, status="searching") for m in self._owned)

    def _advance_tracks(self) -> Iterator[Plan | Flush]:
        for advance in (self._observe_all, self._plan_newest) if self._period_s else (self._observe_all,):
            for batch in _batches(self._owned):
                if plans := [plan for m in batch for plan in advance(m)]:
                    yield from plans
                    yield Flush()

    def _observe_all(self, target: int) -> Iterator[Plan]:
        """Advance one track over all scans; in lockstep, its plans of the dwells that are not acknowledged."""
        track = self._tracks.get(target)
        if track is None:
            bins = self._acquisition.bins
            if bins is None:
                return
            state = start(self._model, target, int(bins[target]), self._acquisition.scans)
            track = self._tracks[target] = OwnedTrack(self._model, state, self._newest)
            yield from self._plan_in_lockstep(track, t=0)
        while (scan := self._next_scan(track)) is not None:
            track.observe(scan)
            yield from self._plan_in_lockstep(track, scan.t)

    def _next_scan(self, track: OwnedTrack) -> Scan | None:
        """The scan that a track lacks; in real time, where dwells may be lost for good, it does not wait for long."""
        waited_s = (self._newest - max(track.k, track.since)) * self._period_s
        if track.k not in self._scans and waited_s > PATIENCE_S:
            track.coast(min(k for k in self._scans if k > track.k))
        return self._scans.get(track.k)

    def _plan_in_lockstep(self, track: OwnedTrack, t: int) -> Iterator[Plan]:
        if not self._period_s and track.state.k >= self._resend.k:
            yield self._plan(track, t)

    def _plan_newest(self, target: int) -> Iterator[Plan]:
        """In real time: the plan of the newest dwell, if the track has observed it."""
        track = self._tracks.get(target)
        if track is not None and track.k > self._newest and track.planned < self._newest:
            yield self._plan(track, self._scans[self._newest].t)

    def _plan(self, track: OwnedTrack, t: int) -> Plan:
        state = track.state
        track.planned = state.k
        has_time = self._share_of_time(state.target) if self._period_s else None
        decision = decide(self.radar.planner, self._model, state, has_time)
        return Plan(
            run=self._run,
            k=state.k,
            t=t,
            target=state.target,
            status="tracking",
            bins=decision.bins,
            chances=decision.chances,
            best_bin=decision.best_bin,
            worth=decision.worth,
            gain=decision.gain,
            range_km=decision.range_km,
            estimate=decision.estimate,
            covariance=decision.covariance,
            detected=state.detected,
            depleted=state.depleted,
            reach=decision.reach,
            astray=decision.astray,
            n_sim=decision.n_sim,
            nus=decision.nus,
            gate=decision.gate,
        )

    def _share_of_time(self, target: int) -> Callable[[], bool]:
        """Whether a track's search has time left: the time to the deadline is shared evenly by those still to come."""
        now_s, to_come = self._clock(), len(self._owned) - self._owned.index(target)
        until_s = now_s + (self._deadline_s - now_s) / to_come
        return lambda: self._clock() < until_s

    def _missing(self, *, again: bool) -> Sequence[Message]:
        """The request for the first scan that a track lacks although later ones are there, or for its snapshot."""
        lacking = {m: self._next_k(m) for m in self._owned}
        known = max(self._newest, self._resend.k - 1)
        first = min(lacking.values(), default=known + 1)
        if first > known or first in self._scans:
            return []
        return self._recall.ask(first, [m for m, k in lacking.items() if k == first], again=again)

    def _next_k(self, target: int) -> int:
        """The scan that a track needs next; one that has no belief needs the acquisition."""
        return self._tracks[target].k if target in self._tracks else len(self._acquisition.scans)


def _batches(tracks: Sequence[int]) -> Iterator[Sequence[int]]:
    """Half of the tracks, half of the rest, and so on.

    To wake the readers for every plan costs all of them more than to read it; but they should not have to read many
    once the last one is made.
    """
    while tracks:
        half = (len(tracks) + 1) // 2
        yield tracks[:half]
        tracks = tracks[half:]
