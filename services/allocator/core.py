"""Allocator: collects the plans of dwell k, splits the power, and answers with the waveform of dwell k+1."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from services.delivery.inactivity import Inactivity
from services.delivery.pending import Pending
from services.delivery.resend import MAX_DWELLS, ResendBuffer
from shared.power.rules import Emission, Requests, power_rule
from shared.protocol.admission import check_directions
from shared.protocol.events import Event, Tick
from shared.protocol.messages import Checkpoint, Message, Plan, Refused, Waveform
from shared.scenario.radar_config import RadarConfig, Strategy
from shared.signal.array import angle_bin, bin_centres, spatial_frequency
from shared.tracking.motion import predicted_mean

MIN_RANGE_KM = 1e-3  # a target on top of the array needs no power; keeps delta = 1/R^4 finite

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
    plans: defaultdict[int, dict[int, Plan]] = field(default_factory=lambda: defaultdict(dict))
    newest: dict[int, Plan] = field(default_factory=dict)  # of each track
    k: int = 0  # in real time: the next dwell to be answered,
    due_s: float | None = None  # ... when,
    wait: float | None = None  # ... or how many periods after the next tick, which tells the time

    def expect(self, k: int, wait: float) -> None:
        """The waveform of dwell k is due so many periods from now."""
        self.k, self.wait, self.due_s = k, wait, None


class AllocatorCore:
    """Plans k in, waveform k out once all are there; in real time at the latest when it is due.

    A waveform is a function of its dwell's plans alone: an allocator that comes back needs no more than those of the
    dwells that are not acknowledged yet, which their planners resend.
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
        """Whether a tick must tell the time from which a waveform is due."""
        return any(barrier.wait is not None for barrier in self._barriers.values())

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
            case Plan():
                self._pending.add(event)
            case Tick():
                return [answer for barrier in self._barriers.values() for answer in _when_due(barrier, event.now_s)]
            case _:
                pass
        return ()

    def _checkpoint(self, checkpoint: Checkpoint) -> Sequence[Message]:
        """Go on with a run; begin one that is new, or that is rewound."""
        barrier = self._barriers.get(checkpoint.run)
        if barrier is not None and not barrier.resend.is_rewound_by(checkpoint):
            for dwell in [dwell for dwell in barrier.plans if dwell < checkpoint.k]:
                del barrier.plans[dwell]
            return barrier.resend.acknowledge(checkpoint)
        radar, resend = RadarConfig.model_validate(checkpoint.radar), ResendBuffer(checkpoint.k)
        period_s = 1.0 / checkpoint.rate_hz if checkpoint.rate_hz else 0.0
        self._barriers[checkpoint.run] = _Barrier(radar, checkpoint.strategy, resend, period_s, k=checkpoint.k)
        if period_s:
            warm_up(radar, checkpoint.strategy)
        return self._pending.replay(checkpoint.run, self.handle)


def _collect(barrier: _Barrier, plan: Plan) -> Sequence[Message]:
    """Take a plan; the waveform if it was the last one missing."""
    n_target, n_bin = barrier.radar.tracks, barrier.radar.array.n_bin
    if plan.target >= n_target or (plan.bins >= n_bin).any():
        asked = f"plan of track {plan.target} for bins {plan.bins.tolist()}"
        raise Refused(f"{asked}: {n_target} tracks and {n_bin} bins exist")
    check_directions(plan.bins, plan.nus, barrier.radar, is_asked=plan.status == "tracking")
    if plan.target not in barrier.newest or plan.k > barrier.newest[plan.target].k:
        barrier.newest[plan.target] = plan
    first = barrier.k if barrier.period_s else barrier.resend.k
    if not first <= plan.k < first + MAX_DWELLS or plan.target in barrier.plans[plan.k]:
        return ()
    barrier.plans[plan.k][plan.target] = plan
    if len(barrier.plans[plan.k]) == n_target:
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
    known = [plan.k for plan in barrier.newest.values()]
    if len(known) < barrier.radar.tracks or barrier.k > max(known) + MAX_COASTED_S / barrier.period_s:
        return ()  # too little is known: the radar goes on with the waveform it has
    return _answer(barrier, barrier.k)


def _answer(barrier: _Barrier, k: int) -> Sequence[Message]:
    plans = [barrier.plans[k].setdefault(m, barrier.newest[m]) for m in range(barrier.radar.tracks)]
    answer = waveform(barrier.radar, barrier.strategy, [coasted(barrier.radar, plan, k) for plan in plans])
    if barrier.period_s:
        barrier.expect(k + 1, AFTER_WAVEFORM if any(plan.k == k for plan in plans) else 1.0)
        barrier.plans = defaultdict(dict, {dwell: plans for dwell, plans in barrier.plans.items() if dwell > k})
        late = np.array([plan.k != k for plan in plans], dtype=np.int32)
        answer = answer.model_copy(update={"late": late})
    return barrier.resend.add(k, (answer,))


def coasted(radar: RadarConfig, plan: Plan, k: int) -> Plan:
    """A plan of an earlier dwell for dwell k: its cells and range, moved as its estimate will have moved by then.

    Its chances are kept, and what a look is worth: an estimate says nothing of how the belief has spread since.
    """
    if plan.k == k or plan.status == "searching":
        return plan.model_copy(update={"k": k})
    n_bin, dwells = radar.array.n_bin, np.array([1, k + 1 - plan.k])
    states = np.array([predicted_mean(plan.estimate, radar.motion.dt_s * n) for n in dwells])
    meant, arrived = angle_bin(spatial_frequency(states), n_bin).astype(np.int32)
    moved = np.clip(np.append(plan.bins, np.int32(plan.best_bin)) + (arrived - meant), 0, n_bin - 1).astype(np.int32)
    kept = np.sort(np.unique(moved[:-1], return_index=True)[1])  # of cells that meet at the edge the first
    range_km = float(np.hypot(states[1, 0], states[1, 2]))
    if plan.nus is not None and plan.gate is not None:
        from_nu, to_nu = spatial_frequency(states)
        nus = np.clip(plan.nus + (to_nu - from_nu), -0.5, 0.5)
        moved[:-1], kept = angle_bin(nus, n_bin), np.arange(nus.size)
        gate = plan.gate
        if gate.any():  # of the same width, at the array the nearest: (0, 0) would be all ranges
            gate = gate + max(range_km - plan.range_km, -float(gate[0]))
        plan = plan.model_copy(update={"nus": nus, "gate": gate})
    gain = plan.gain * (_floored(plan.range_km) / _floored(range_km)) ** 4
    cells = {"bins": moved[kept], "chances": plan.chances[kept], "best_bin": int(moved[-1])}
    return plan.model_copy(update={"k": k, "range_km": range_km, "gain": gain, **cells})


def waveform(radar: RadarConfig, strategy: Strategy, plans: Sequence[Plan]) -> Waveform:
    """Waveform that serves the plans of one dwell, tracks in order, under the run's strategy."""
    array = radar.array
    tracking = all(plan.status == "tracking" for plan in plans)
    if tracking:
        sent = power_rule(strategy)(radar, _requests(radar, plans))
    else:
        nothing, none = np.empty((array.n_tx, 0), np.complex128), np.full((len(plans), 1), np.nan)
        sent = Emission(array.power, nothing, none, np.zeros(none.shape), "acquisition")
    is_lit = ~np.isnan(sent.nus)
    nus = np.where(is_lit, sent.nus, 0.0)
    beams = np.where(is_lit, angle_bin(nus, array.n_bin), -1).astype(np.int32)
    steered: dict[str, Any] = {}
    if radar.receiver.cells == "steered":
        gates = np.array([np.zeros(2) if plan.gate is None else plan.gate for plan in plans])
        steered = {"nus": nus, "gates": gates}
    return Waveform.model_validate(
        {
            "run": plans[0].run,
            "k": plans[0].k,
            "tracking": tracking,
            "isotropic": sent.isotropic,
            "factor": sent.factor.astype(np.complex64),
            "beams": beams,
            "shares": sent.shares,
            "status": sent.status,
            "late": np.zeros(len(plans), dtype=np.int32),
        }
        | steered
    )


def _requests(radar: RadarConfig, plans: Sequence[Plan]) -> Requests:
    """What the plans of tracks ask for, as arrays."""
    n, centres = max(plan.bins.size for plan in plans), bin_centres(radar.array.n_bin)
    nus, chances = np.zeros((len(plans), n)), np.zeros((len(plans), n))
    for m, plan in enumerate(plans):
        nus[m, : plan.bins.size] = centres[plan.bins] if plan.nus is None else plan.nus
        chances[m, : plan.bins.size] = plan.chances
    ranges = np.maximum([plan.range_km for plan in plans], MIN_RANGE_KM)
    gains, worths = (np.array([getattr(plan, name) for plan in plans]) for name in ("gain", "worth"))
    reaches, astray = (np.array([getattr(plan, name) for plan in plans]) for name in ("reach", "astray"))
    return Requests(nus, chances, ranges, gains, worths, reaches, astray, plans[0].k)


def _floored(range_km: float) -> float:
    return max(range_km, MIN_RANGE_KM)


def warm_up(radar: RadarConfig, strategy: Strategy) -> None:
    """Make a waveform that is not sent: the first call of a compiled kernel loads it, which may take a second."""
    bins = np.linspace(0, radar.array.n_bin - 1, radar.tracks).astype(np.int32)
    asked: dict[str, Any] = {"chances": np.ones(1), "gain": 1.0, "range_km": radar.acquisition.range_max_km}
    if radar.receiver.cells == "steered":
        asked |= {"nus": np.zeros(1), "gate": np.zeros(2)}
    plans = [
        Plan(run="warm-up", k=0, t=0, target=m, status="tracking", bins=bin_, best_bin=int(bin_[0]), **asked)
        for m, bin_ in enumerate(bins[:, np.newaxis])
    ]
    waveform(radar, strategy, plans)
