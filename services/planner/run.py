"""One run as a planner knows it: the newest scans, and the tracks that this worker owns."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.delivery.pending import decoded
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.planner.decision import decide, warm_up
from cogradar.services.planner.held_tracks import HeldTracks, batches
from cogradar.services.planner.owned_track import OwnedTrack, detections_of, model_in, state_of
from cogradar.services.planner.recall import RecallRequest
from cogradar.services.planner.track_source import source_of
from cogradar.shared.protocol.admission import check_dwell, check_scan, check_snapshot
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan, roster_of
from cogradar.shared.protocol.orders import under
from cogradar.shared.protocol.recovery import Handover, History, Snapshot
from cogradar.shared.scenario.plugins.names import PluginFailed
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.runner import Flush

Choose = Callable[[Sequence[int]], Sequence[int]]  # of the tracks there are those that a worker owns
KEPT_SCANS = 512  # newest ones of each run, from which a track that changes hands is rebuilt without a recall


class Unplanned(Exception):
    """A rule or a belief of somebody's own failed in this run."""

    def __init__(self, run: str, reason: str) -> None:
        super().__init__(reason)
        self.run = run


class PlannedRun:
    """Scans in, plans of the owned tracks out."""

    def __init__(self, checkpoint: Checkpoint, planner: str, clock: Callable[[], float]) -> None:
        self._run, self._dwells, self._strategy = checkpoint.run, checkpoint.dwells, checkpoint.strategy
        self._clock = clock
        self._pacing = pacing_at(checkpoint.rate_hz)
        self._deadline_s = math.inf
        self._in_time: Sequence[int] = ()  # tracks that are planned for now: they share the time to the deadline
        self._restored = set[int]()  # tracks that went on from a snapshot
        self.radar = RadarConfig.model_validate(checkpoint.radar)
        self._model = TrackerModel.of(self.radar, checkpoint.strategy, checkpoint.seed)
        self.resend = ResendBuffer(checkpoint.k)
        self._choose: Choose = lambda _alive: ()  # until ownership is known
        self._held = HeldTracks(self._run, planner)
        self.source = source_of(self._run, self.radar, self._model, self._pacing)
        self._over: set[int] = set()  # tracks whose last scan was observed
        self._scans: dict[int, Scan] = {}
        self._seen: tuple[Scan, Detections, frozenset[int]] | None = None
        self._newest = -1
        self._lost = set[int]()  # dwells without a scan: the journal has none, or they never happened
        self._missed: dict[int, int] = {}  # dwells whose scans did not come, by the scan that showed it
        self._since: dict[int, int] = {}  # newest scan when a track was to begin and scans after its birth lacked
        self._tracks: dict[int, OwnedTrack] = {}
        is_joining = checkpoint.k > 0
        awaited = self._pacing.awaited_offers if is_joining and not checkpoint.resend else 0
        self._recall = RecallRequest(self._run, planner, awaited)
        self.is_behind = False  # in real time: scans have come that no track has observed
        if self._pacing.has_deadlines or is_joining:
            warm_up(self.radar, self._model)

    @property
    def n_owned(self) -> int:
        """Number of tracks that this worker owns."""
        return len(self._held.owned)

    @property
    def progress(self) -> str:
        """How near targets are to being found, in words; "": they are, or nothing is known yet."""
        return self.source.progress(self._scans)

    def await_no_offer(self) -> None:
        """For some of the tracks there may be no planner left that could offer them."""
        self._recall.wait_no_longer()

    def own(self, choose: Choose) -> Iterable[Message | Flush]:
        """Own the tracks that are chosen of those there are, and no others."""
        self._choose = choose
        self._own_alive()
        return self._advance_or_defer()

    def _own_alive(self) -> None:
        """Own what is chosen of the tracks that are there, or were since the acknowledged dwell."""
        alive = self.source.alive(self._scans, min(self.resend.k, self._newest))
        self._over.intersection_update(alive)
        there = [m for m in alive if m not in self._over]
        current = {m for m in there if self._pacing.loses_dwells or self._next_k(m) >= self._newest}
        for m in self._held.own(self._choose(there), current, quietly=not self.source.is_fixed):
            if m in self._tracks:
                self._tracks[m].save()
        held = set(self._held.all)
        self._tracks = {m: track for m, track in self._tracks.items() if m in held}
        self._restored.intersection_update(held)
        self._since = {m: k for m, k in self._since.items() if m in held and m not in self._tracks}

    def _own_changed(self) -> None:
        if not self.source.is_fixed:
            self._own_alive()

    def hand_over(self, said: Handover) -> Sequence[Message]:
        """Say which of another worker's tracks are taken; leave those that another one has taken."""
        if not said.taken:
            self._recall.offer(said.targets)
            taken = self._held.take(said, [m for m, track in self._tracks.items() if track.k > said.k])
            return [*taken, *self._missing()]
        self._held.leave(said)
        self._own_alive()
        return ()

    def receive(self, scan: Scan) -> Iterable[Message | Flush]:
        """Take a scan: plans of all dwells that it completes; a repeated one changes nothing."""
        self._check(scan)
        self._keep(scan)
        return self._advance_or_defer()

    def receive_history(self, history: History) -> Iterable[Message | Flush]:
        """Take scans or snapshots that were recalled: all of them, or none."""
        messages = [one for one in map(decoded, history.payloads) if one.run == self._run]
        scans = [one for one in messages if isinstance(one, Scan)]
        snapshots = [one for one in messages if isinstance(one, Snapshot)]
        for scan in scans:
            self._check(scan)
        for snapshot in snapshots:
            check_snapshot(snapshot, self.radar)
        for scan in scans:
            self._keep(scan)
        self._note_lost(history.k, {scan.k for scan in scans})
        for snapshot in snapshots:
            self._restore(snapshot)
        return self._advance_or_defer()

    def catch_up(self) -> Iterable[Message | Flush]:
        """In real time: observe the scans that have come, and plan for the newest within half a period."""
        self.is_behind = False
        self._deadline_s = self._clock() + self._pacing.search_s
        return self._advance()

    def acknowledge(self, checkpoint: Checkpoint) -> Sequence[Message | Flush]:
        """Drop what is acknowledged, and ask for the scans that tracks lack."""
        self.resend.acknowledge(checkpoint)
        self._recall.hear(checkpoint)
        lost = self._held.plan_again(checkpoint)
        self._tracks = {m: track for m, track in self._tracks.items() if m not in lost}
        self._own_changed()
        planned = self._advance_or_defer() if lost else ()
        snapshots = self._snapshots()
        unsaved = [m for m, track in self._tracks.items() if not track.is_saved]
        return [*planned, *snapshots, *self._held.offer(unsaved, self._next_k), *self._missing()]

    def prepare(self) -> bool:
        """Predict where one of the tracks will be in the next dwell; false if all are predicted."""
        try:
            return not self.is_behind and any(track.prepare() for track in self._tracks.values())
        except PluginFailed:  # its next scan will end the run
            return False

    def _advance_or_defer(self) -> Iterable[Message | Flush]:
        """Advance at once; in real time when no newer message waits, which a tick tells."""
        if self._pacing.has_deadlines:
            self.is_behind = True
            return ()
        return self._advance()

    def _advance(self) -> Iterator[Message | Flush]:
        """Advance the acquisition, then every track, as far as the scans reach; ask for those that are missing.

        Plans go out in batches: while this worker plans for the next tracks, the others read the plans of the last. In
        real time all tracks are observed first; what is left of the time is for their searches, in equal parts.
        """
        try:
            for plan in itertools.chain(self._search(), self._advance_tracks()):
                if isinstance(plan, Plan):
                    self.resend.add(plan.k, (plan,))
                yield plan
        except PluginFailed as error:
            raise Unplanned(self._run, str(error)) from error
        for k in [k for k in self._scans if k <= self._newest - KEPT_SCANS]:
            del self._scans[k]
        self._lost = {k for k in self._lost if k > self._newest - KEPT_SCANS}
        self._missed = {k: shown for k, shown in self._missed.items() if k > self._newest - KEPT_SCANS}
        yield from self._snapshots()
        yield from self._missing()

    def _check(self, scan: Scan) -> None:
        check_dwell(scan.k, self.radar, self._dwells)
        check_scan(scan, self.radar)

    def _keep(self, scan: Scan) -> None:
        self._scans.setdefault(scan.k, scan)
        if self._pacing.loses_dwells:
            self._note_missed(scan)
        self._newest = max(self._newest, scan.k)
        self._own_changed()

    def _restore(self, snapshot: Snapshot) -> None:
        """Let an owned track that is behind its snapshot continue from there."""
        if snapshot.target in self._held.all and self._next_k(snapshot.target) <= snapshot.k:
            self._tracks[snapshot.target] = OwnedTrack(
                self._model, state_of(self._model, snapshot), self._newest, self._pacing, snapshot.unseen or ()
            )
            self._restored.add(snapshot.target)

    def _snapshots(self) -> Sequence[Snapshot]:
        """Those that can be sent by now. They are never sent again: the next one does as well."""
        pending = (track.snapshot(self._run, self.resend.k) for track in self._tracks.values())
        return [snapshot for snapshot in pending if snapshot is not None]

    def _search(self) -> Iterator[Plan]:
        yield from self.source.search(self._scans, self._held.all, self._pacing.first_open(self._newest, self.resend.k))

    def _advance_tracks(self) -> Iterator[Plan | Flush]:
        """In real time tracks that lack the newest scan only come first: the others have what time is left."""
        if not self._pacing.has_deadlines:
            yield from self._in_batches(self._observe_all, self._held.all)
            return
        behind = [m for m in self._held.all if self._next_k(m) < self._newest]
        yield from self._plan_in_time([m for m in self._held.all if m not in behind])
        yield from self._plan_in_time(self._rebuild(behind))
        self.is_behind = bool(behind)

    def _plan_in_time(self, tracks: Sequence[int]) -> Iterator[Plan | Flush]:
        self._in_time = tracks
        yield from self._in_batches(self._observe_all, tracks)
        yield from self._in_batches(self._plan_newest, tracks)

    def _in_batches(self, advance: Callable[[int], Iterable[Plan]], tracks: Sequence[int]) -> Iterator[Plan | Flush]:
        for batch in batches(tracks):
            if plans := [plan for m in batch for plan in advance(m)]:
                yield from plans
                yield Flush()

    def _rebuild(self, behind: list[int]) -> list[int]:
        """Advance tracks up to the newest scan, for a while. Returns those that are there; the others stay behind.

        Dwell by dwell: plans of one dwell share what is worked out of its scan.
        """
        until_s, caught_up = self._clock() + self._pacing.rebuild_s, list[int]()
        while behind:
            m = min(behind, key=self._next_k)
            track = self._begun(m)
            if track is None or self._observe_next(track) is None:
                behind.remove(m)  # until more is known
            elif track.k > self._newest:
                behind.remove(m)
                caught_up.append(m)
            if self._clock() >= until_s:
                break
        return caught_up

    def _observe_all(self, target: int) -> Iterator[Plan]:
        """Advance one track over all scans; in lockstep, its plans of the dwells that are not acknowledged."""
        is_new, track = target not in self._tracks, self._begun(target)
        if track is None:
            return
        if is_new and self.source.plans_first:
            yield from self._plan_in_lockstep(track, t=0)
        while (scan := self._observe_next(track)) is not None:
            yield from self._plan_in_lockstep(track, scan.t)

    def _begun(self, target: int) -> OwnedTrack | None:
        """A track as far as it has come, or as it begins; None if this cannot be known yet."""
        if target not in self._tracks and (state := self.source.begin(target, self._scans)) is not None:
            unseen = [k for k in range(self.source.first_k(target), state.k + 1) if k not in self._scans]
            lacking = next((k for k in unseen if k not in self._lost), None)
            if lacking is not None and not self._has_waited(lacking, self._since.setdefault(target, self._newest)):
                return None
            self._tracks[target] = OwnedTrack(self._model, state, self._newest, self._pacing, unseen)
        return self._tracks.get(target)

    def _observe_next(self, track: OwnedTrack) -> Scan | None:
        """The scan by which a track has advanced; None: there is none, or the track is over."""
        if (scan := self._next_scan(track)) is None:
            return None
        seen, there = self._read(scan)
        if track.state.target not in there:
            self._over.add(track.state.target)
            return None
        track.observe(seen, model_in(self._model, scan))
        return scan

    def _read(self, scan: Scan) -> tuple[Detections, frozenset[int]]:
        """What the newest scan says, one object for all tracks: they share what is worked out of it; and its tracks."""
        if self._seen is None or self._seen[0] is not scan:
            self._seen = scan, detections_of(self._model, scan), frozenset(roster_of(scan).ids.tolist())
        _, seen, there = self._seen
        return seen, there

    def _next_scan(self, track: OwnedTrack) -> Scan | None:
        """The scan that a track lacks; in real time, where dwells may be lost for good, it does not wait for long."""
        if track.k not in self._scans:
            k = next(k for k in itertools.count(track.k) if k not in self._lost or k in self._scans)
            if self._has_waited(track.k, track.since):
                k = min(k for k in self._scans if k > track.k)
            if k > track.k:
                track.coast(k)
        return self._scans.get(track.k)

    def _has_waited(self, k: int, since: int) -> bool:
        """Whether scan k has been awaited for long, while newer ones came, by a track that is here since a scan."""
        return self._pacing.may_coast(self._newest - max(self._missed.get(k, k), since))

    def _note_missed(self, scan: Scan) -> None:
        """Note what a scan shows to be missing: it is awaited from now on, unless the dwell never happened."""
        first = max(self._newest + 1, scan.k - KEPT_SCANS)
        if self._newest >= 0 and first < scan.k:
            self._missed |= dict.fromkeys(range(first, scan.k), scan.k)
        if scan.skipped is not None:
            self._lost |= {*range(scan.k - min(scan.skipped, KEPT_SCANS), scan.k)}

    def _note_lost(self, first_k: int, recalled: set[int]) -> None:
        """Of acknowledged dwells the journal has all scans that there will ever be: tracks do not wait for others."""
        if recalled and self._pacing.loses_dwells:
            self._lost |= {*range(first_k, min(max(recalled), self.resend.k))} - recalled

    def _plan_in_lockstep(self, track: OwnedTrack, t: int) -> Iterator[Plan]:
        first = max(self.resend.k, self._held.first_k(track.state.target))
        if not self._pacing.has_deadlines and track.state.k >= first:
            yield self._plan(track, t)

    def _plan_newest(self, target: int) -> Iterator[Plan]:
        """In real time: the plan of the newest dwell, if the track has observed it."""
        track = self._tracks.get(target)
        if track is not None and track.k > self._newest and track.planned < self._newest:
            yield self._plan(track, self._scans[self._newest].t)

    def _plan(self, track: OwnedTrack, t: int) -> Plan:
        state = track.state
        track.planned = state.k
        judged = self.source.judged(state) | ({"unseen": list(track.unseen)} if track.unseen else {})
        has_time = self._share_of_time(state.target) if self._pacing.has_deadlines else None
        decision = decide(*self._settings(state.k), state, has_time)
        if self._model.existence.is_over(state, max(decision.chances.tolist(), default=0.0)):
            return Plan(run=self._run, k=state.k, t=t, target=state.target, status="ended", **judged)
        return Plan(
            run=self._run,
            k=state.k,
            t=t,
            target=state.target,
            status="tracking",
            detected=state.detected,
            depleted=state.depleted,
            **vars(decision),
            **judged,
        )

    def _settings(self, k: int) -> tuple[RadarConfig, TrackerModel]:
        """Radar and model for decisions after dwell k: of that dwell, as commands have set them."""
        scan = self._scans.get(k)
        if scan is None or scan.settings is None:
            return self.radar, self._model
        return under(self.radar, self._strategy, scan.settings)[0], model_in(self._model, scan)

    def _share_of_time(self, target: int) -> Callable[[], bool]:
        """Whether a track's search has time left: the time to the deadline is shared evenly by those still to come."""
        now_s, to_come = self._clock(), len(self._in_time) - self._in_time.index(target)
        until_s = now_s + (self._deadline_s - now_s) / to_come
        return lambda: self._clock() < until_s

    def _missing(self) -> Sequence[Message]:
        """The request for the first scan that a track lacks although later ones are there, or for its snapshot.

        In real time for the snapshots of all tracks that are far behind, whatever scans are here.
        """
        lacking = {m: self._next_k(m) for m in self._held.all if self._recall.may_ask(m)}
        known = max(self._newest, self.resend.k - 1)
        first = min(lacking.values(), default=known + 1)
        if first > known:
            return []
        goes_on = first in self._scans
        far = [m for m, k in lacking.items() if self._pacing.is_far(known - k) and m not in self._restored]
        if goes_on and not far:
            return []
        return self._recall.ask(first, far or [m for m, k in lacking.items() if k == first], goes_on=goes_on)

    def _next_k(self, target: int) -> int:
        """The scan that a track needs next; one that has no belief needs its birth, or the acquisition."""
        return self._tracks[target].k if target in self._tracks else self.source.first_k(target)
