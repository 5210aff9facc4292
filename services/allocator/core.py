"""Allocator: collects the plans of dwell k, splits the power, and answers with the waveform of dwell k+1."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from services.allocator.told import Told
from services.allocator.waveform import coasted, open_waveform, warm_up, waveform
from services.delivery.inactivity import Inactivity
from services.delivery.invariant import require
from services.delivery.pending import Pending
from services.delivery.resend import MAX_DWELLS, ResendBuffer
from shared.protocol.admission import check_plan, check_scan
from shared.protocol.events import Event, Tick
from shared.protocol.messages import Checkpoint, Message, Plan, Scan
from shared.scenario.radar_config import RadarConfig, Strategy

# Real time: when a waveform is due, in periods, after the first plan of its dwell, or else after the last waveform.
AFTER_PLAN, AFTER_WAVEFORM = 0.5, 1.5  # ... and while no plan comes at all, one period after the other
MAX_COASTED_S = 5.0  # after so long without any plan an extrapolation is a guess


@dataclass
class _Barrier:
    """One run's plans, collected per dwell until there is one of every track."""

    radar: RadarConfig
    strategy: Strategy
    resend: ResendBuffer
    period_s: float  # between dwells in real time; 0: in lockstep
    scans: dict[int, Scan] = field(default_factory=dict)  # where the number of tracks is unknown
    plans: defaultdict[int, dict[int, Plan]] = field(default_factory=lambda: defaultdict(dict))
    newest: dict[int, Plan] = field(default_factory=dict)  # of each track
    first_k: int = 0  # since this dwell all scans have come,
    newest_k: int = -2  # ... the last one of this dwell
    told: Told = field(default_factory=Told)  # in real time: which tracks there are
    k: int = 0  # in real time: the next dwell to be answered,
    due_s: float | None = None  # ... when,
    wait: float | None = None  # ... or how many periods after the next tick, which tells the time

    def expect(self, k: int, wait: float) -> None:
        """The waveform of dwell k is due so many periods from now."""
        self.k, self.wait, self.due_s = k, wait, None


class AllocatorCore:
    """Plans k in, waveform k out once all are there; in real time at the latest when it is due.

    In lockstep a waveform is a function of its dwell's scan and plans alone: an allocator that comes back needs no more
    than those of the dwells that are not acknowledged yet, which are sent again.
    """

    def __init__(self) -> None:
        self._barriers: dict[str, _Barrier] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def wake_s(self) -> float | None:
        """When the next waveform of a run in real time is due."""
        return min((barrier.due_s for barrier in self._barriers.values() if barrier.due_s is not None), default=None)

    @property
    def has_deferred(self) -> bool:
        """Whether a tick must tell the time from which a waveform is due, or the recorder lacks something."""
        return any(barrier.wait is not None or barrier.resend.is_asked for barrier in self._barriers.values())

    def handle(self, event: Event) -> Sequence[Message]:
        """Collect, and answer when a dwell is complete or its time is over."""
        for run in self._inactivity.after(event):
            self._barriers.pop(run, None)
        match event:
            case Checkpoint(ended=True):
                self._barriers.pop(event.run, None)
                self._pending.forget(event.run)
            case Checkpoint():
                return self._checkpoint(event)
            case Plan() if event.run in self._barriers:
                return _collect(self._barriers[event.run], event)
            case Scan() if event.run in self._barriers:
                return _take(self._barriers[event.run], event)
            case Plan() | Scan():
                self._pending.add(event)
            case Tick():
                barriers = self._barriers.values()
                again = [answer for barrier in barriers for answer in barrier.resend.again(drained=event.drained)]
                return again + [answer for barrier in barriers for answer in _when_due(barrier, event.now_s)]
            case _:
                pass
        return ()

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        self._pending.validate()
        self._inactivity.validate(self._barriers)
        for barrier in self._barriers.values():
            barrier.resend.validate()
            is_kept = len(barrier.plans) <= MAX_DWELLS and len(barrier.scans) <= MAX_DWELLS
            require(is_kept, "plans or scans of more dwells are kept than may be")
            is_open = barrier.period_s > 0.0 or min(barrier.plans, default=barrier.resend.k) >= barrier.resend.k
            require(is_open, "plans are kept of a dwell that is acknowledged")

    def _checkpoint(self, checkpoint: Checkpoint) -> Sequence[Message]:
        """Go on with a run; begin one that is new, or that is rewound."""
        barrier = self._barriers.get(checkpoint.run)
        if barrier is not None and not barrier.resend.is_rewound_by(checkpoint):
            for kept in (barrier.plans, barrier.scans):
                for dwell in [dwell for dwell in kept if dwell < checkpoint.k]:
                    del kept[dwell]
            barrier.resend.acknowledge(checkpoint)
            return ()
        radar, resend = RadarConfig.model_validate(checkpoint.radar), ResendBuffer(checkpoint.k)
        period_s = 1.0 / checkpoint.rate_hz if checkpoint.rate_hz else 0.0
        self._barriers[checkpoint.run] = _Barrier(radar, checkpoint.strategy, resend, period_s, k=checkpoint.k)
        if period_s:
            warm_up(radar, checkpoint.strategy)
        return self._pending.replay(checkpoint.run, self.handle)


def _take(barrier: _Barrier, scan: Scan) -> Sequence[Message]:
    """Take a scan, if it says which tracks there are; the waveform if their plans have come already."""
    first = barrier.k if barrier.period_s else barrier.resend.k
    if not barrier.radar.is_unknown or not first <= scan.k < first + MAX_DWELLS or scan.k in barrier.scans:
        return ()
    check_scan(scan, barrier.radar)
    barrier.scans[scan.k] = scan
    if scan.k > barrier.newest_k + 1:
        barrier.first_k = scan.k
    barrier.newest_k = max(barrier.newest_k, scan.k)
    if _is_complete(barrier, scan.k):
        return _answer(barrier, scan.k)
    if barrier.period_s:
        barrier.expect(scan.k, AFTER_PLAN)
    return ()


def _is_complete(barrier: _Barrier, k: int) -> bool:
    """Whether the plans of all tracks of a dwell are there."""
    if not barrier.radar.is_unknown:
        return len(barrier.plans[k]) == barrier.radar.announced
    scan = barrier.scans.get(k)
    return scan is not None and scan.roster is not None and barrier.plans[k].keys() >= set(scan.roster.ids.tolist())


def _collect(barrier: _Barrier, plan: Plan) -> Sequence[Message]:
    """Take a plan; the waveform if it was the last one missing."""
    check_plan(plan, barrier.radar)
    if barrier.period_s:
        barrier.told.planned.add(plan.target)
        if plan.target not in barrier.newest or plan.k > barrier.newest[plan.target].k:
            barrier.newest[plan.target] = plan
    first = barrier.k if barrier.period_s else barrier.resend.k
    if not first <= plan.k < first + MAX_DWELLS or plan.target in barrier.plans[plan.k]:
        return ()
    barrier.plans[plan.k][plan.target] = plan
    if _is_complete(barrier, plan.k):
        return _answer(barrier, plan.k)
    if barrier.period_s and len(barrier.plans[plan.k]) == 1:
        barrier.expect(plan.k, AFTER_PLAN)
    return ()


def _when_due(barrier: _Barrier, now_s: float) -> Sequence[Message]:
    """In real time: answer with the plans there are; the others are extrapolated from their last ones."""
    if barrier.wait is not None:
        barrier.due_s, barrier.wait = now_s + barrier.wait * barrier.period_s, None
    if barrier.due_s is None or now_s < barrier.due_s:
        return ()
    barrier.due_s = None
    if barrier.radar.is_unknown:  # without its scan nobody can say which tracks there are
        return _answer(barrier, barrier.k) if barrier.k in barrier.scans else ()
    known = [plan.k for plan in barrier.newest.values()]
    if len(known) < barrier.radar.announced or barrier.k > max(known) + MAX_COASTED_S / barrier.period_s:
        return ()  # too little is known: the radar goes on with the waveform it has
    return _answer(barrier, barrier.k)


def _answer(barrier: _Barrier, k: int) -> Sequence[Message]:
    if barrier.radar.is_unknown:
        return _answer_open(barrier, k)
    plans = [barrier.plans[k].get(m) or barrier.newest[m] for m in range(barrier.radar.announced)]
    answer = waveform(barrier.radar, barrier.strategy, [coasted(barrier.radar, plan, k) for plan in plans])
    if barrier.period_s:
        barrier.expect(k + 1, AFTER_WAVEFORM if any(plan.k == k for plan in plans) else 1.0)
        barrier.plans = defaultdict(dict, {dwell: plans for dwell, plans in barrier.plans.items() if dwell > k})
        late = np.array([plan.k != k for plan in plans], dtype=np.int32)
        answer = answer.model_copy(update={"late": late})
    return barrier.resend.add(k, (answer,))


def _answer_open(barrier: _Barrier, k: int) -> Sequence[Message]:
    """The waveform of a dwell whose tracks its scan says; in real time with plans of earlier dwells, moved on.

    A track without a plan for long has nobody who follows it, and ends. An allocator that has just come back waits as
    long for the plans of those that it does not know: the radar goes on with the waveform it has.
    """
    scan = barrier.scans[k]
    if scan.roster is None:
        return ()
    roster = scan.roster
    if barrier.period_s:
        roster = barrier.told.goes_on_from(roster, k, barrier.radar.most_tracks)
    plans = [barrier.plans[k].get(m) or barrier.newest.get(m) for m in roster.ids.tolist()]
    most = max(MAX_COASTED_S, 2.0 * barrier.period_s)
    if None in plans and (k - barrier.first_k) * barrier.period_s <= most:
        return ()
    known = [plan for plan in plans if plan is not None and (k - plan.k) * barrier.period_s <= most]
    answer, asked = open_waveform(barrier.radar, barrier.strategy, scan, roster, known)
    if barrier.period_s:
        answer = barrier.told.repeated(answer)
        barrier.expect(k + 1, AFTER_WAVEFORM)
        barrier.plans = defaultdict(dict, {dwell: plans for dwell, plans in barrier.plans.items() if dwell > k})
        barrier.scans = {dwell: scan for dwell, scan in barrier.scans.items() if dwell > k}
        barrier.newest = {plan.target: plan for plan in asked} | {
            m: plan for m, plan in barrier.newest.items() if plan.k > k
        }
        late = np.array([plan.k != k for plan in asked], dtype=np.int32)
        answer = answer.model_copy(update={"late": late})
    return barrier.resend.add(k, (answer,))
