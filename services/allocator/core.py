"""Allocator: collects the plans of dwell k, splits the power, and answers with the waveform of dwell k+1."""

import logging
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

from pydantic import ValidationError

from cogradar.services.allocator.tracks import Tracks, tracks_of
from cogradar.services.allocator.waveform import warm_up, waveform
from cogradar.services.delivery.inactivity import Inactivity
from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.pacing import Pacing, pacing_at
from cogradar.services.delivery.pending import Pending, decoded
from cogradar.services.delivery.resend import MAX_DWELLS, ResendBuffer
from cogradar.shared.protocol.admission import check_plan
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan
from cogradar.shared.protocol.orders import Order, in_force
from cogradar.shared.protocol.recovery import History, NoWaveforms
from cogradar.shared.scenario.plugins.names import PluginFailed, PluginRefused, is_own, short
from cogradar.shared.scenario.plugins.resolver import load_for
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy

DUE = 0.5  # periods after the first message of its dwell that is of use an answer is due in real time
log = logging.getLogger(__name__)


@dataclass
class _Run:
    """One run's plans, collected per dwell until there is one of every track."""

    radar: RadarConfig
    strategy: Strategy
    resend: ResendBuffer
    pacing: Pacing
    tracks: Tracks
    k: int  # the dwell to be answered next
    allocator: str  # name of this process
    plans: defaultdict[int, dict[int, Plan]] = field(default_factory=lambda: defaultdict(dict))
    newest: dict[int, Plan] = field(default_factory=dict)  # of each track
    orders: Sequence[Order] = ()  # as the last checkpoint says
    held: set[int] = field(default_factory=set)  # dwells that are complete, too far ahead of the journal
    due_s: float | None = None  # when the answer is due, whatever is missing,
    wait_s: float | None = None  # ... or how long after the next tick, which tells the time
    failed: NoWaveforms | None = None  # its strategy or objective did

    @property
    def first_open(self) -> int:
        """The first dwell for which a plan is still useful."""
        return self.pacing.first_open(self.k, self.resend.k)

    def expect(self, k: int, periods: float | None) -> None:
        """The waveform of dwell k is due so many periods from now; None: once something of its dwell is here."""
        self.k, self.due_s = k, None
        self.wait_s = None if periods is None else self.pacing.wait_s(periods)

    def reach(self, k: int) -> None:
        """The radar has come to dwell k. In real time it may have been away for more dwells than are kept."""
        if self.pacing.loses_dwells and k >= self.first_open + MAX_DWELLS:
            self.k = k
            self.forget(k)

    def give_up(self, run: str, error: PluginFailed) -> Sequence[Message]:
        """Make no more waveforms: the strategy or objective of somebody's own failed, and would again."""
        log.error("%s: %s", run, error)
        self.failed = NoWaveforms.of(run, self.allocator, error, ends=True)
        return (self.failed,)

    def forget(self, before_k: int) -> None:
        """No waveform will be made for the dwells before this one."""
        self.plans = defaultdict(dict, {k: plans for k, plans in self.plans.items() if k >= before_k})
        self.held = {k for k in self.held if k >= before_k}
        self.tracks.forget(before_k)


class AllocatorCore:
    """Plans k in, waveform k out once all are there; in real time at the latest when it is due.

    In lockstep a waveform is a function of the scan, plans and orders of its dwell. An allocator that comes back needs
    no more than these, for the dwells that are not acknowledged yet. Scans and plans are sent again, and each
    checkpoint says the orders.
    """

    def __init__(self, name: str = "allocator") -> None:
        self._name = name
        self._refused: dict[str, str] = {}  # runs whose strategy cannot be had here, and why
        self._runs: dict[str, _Run] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def wake_s(self) -> float | None:
        """When the next waveform of a run in real time is due."""
        return min((run.due_s for run in self._runs.values() if run.due_s is not None), default=None)

    @property
    def has_deferred(self) -> bool:
        """Whether a tick must tell the time from which a waveform is due, or the recorder lacks something."""
        return any(run.wait_s is not None or run.resend.is_asked for run in self._runs.values())

    @property
    def busy(self) -> frozenset[int]:
        """Shards with runs."""
        return self._inactivity.busy

    def handle(self, event: Event) -> Sequence[Message]:
        """Collect, and answer when a dwell is complete or its time is over."""
        for name in self._inactivity.after(event):
            self._pending.forget(name)
            self._runs.pop(name, None)
            self._refused.pop(name, None)
        match event:
            case _ if self._inactivity.is_elsewhere(event):
                pass
            case Checkpoint(ended=True):
                self._refused.pop(event.run, None)
                self._runs.pop(event.run, None)
                self._pending.forget(event.run)
            case Checkpoint():
                return self._checkpoint(event)
            case Plan() if event.run in self._runs:
                return _collect(self._runs[event.run], event)
            case History(topic="plan") if event.run in self._runs:
                return _given(self._runs[event.run], event)
            case Scan() if event.run in self._runs:
                run = self._runs[event.run]
                run.reach(event.k)
                return _next(run, event.k, is_first=True) if run.tracks.take(event, run.first_open) else ()
            case Plan() | Scan():
                self._pending.add(event)
            case Tick():
                runs = self._runs.values()
                again = [answer for run in runs for answer in run.resend.again(drained=event.drained)]
                return again + [answer for run in runs for answer in _when_due(run, event.now_s)]
            case _:
                pass
        return ()

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        self._pending.validate()
        self._inactivity.validate(self._runs)
        for run in self._runs.values():
            run.resend.validate()
            run.tracks.validate()
            require(len(run.plans) <= MAX_DWELLS, "plans of more dwells are kept than may be")
            is_open = min(run.plans, default=run.first_open) >= run.first_open
            require(run.pacing.loses_dwells or is_open, "plans are kept of a dwell that is acknowledged")

    def _checkpoint(self, checkpoint: Checkpoint) -> Sequence[Message]:
        """Go on with a run, or begin it."""
        run = self._runs.get(checkpoint.run)
        if run is not None and run.failed is not None:
            return (run.failed,)
        if run is not None:
            run.forget(checkpoint.k)
            run.resend.acknowledge(checkpoint)
            run.orders = checkpoint.orders
            return tuple(answer for k in sorted(run.held) for answer in _next(run, k, is_first=False))
        radar, pacing = RadarConfig.model_validate(checkpoint.radar), pacing_at(checkpoint.rate_hz)
        resend, tracks = ResendBuffer(checkpoint.k), tracks_of(radar, pacing)
        run = _Run(radar, checkpoint.strategy, resend, pacing, tracks, checkpoint.k, self._name)
        self._runs[checkpoint.run] = run
        run.orders = checkpoint.orders
        try:
            load_for("allocator", checkpoint.radar, checkpoint.strategy)
            if pacing.has_deadlines:
                warm_up(radar, checkpoint.strategy)
        except PluginRefused as error:
            return self._refuse(checkpoint, error)
        except PluginFailed as error:
            return run.give_up(checkpoint.run, error)
        return self._pending.replay(checkpoint.run, self.handle)

    def _refuse(self, checkpoint: Checkpoint, error: PluginRefused) -> Sequence[Message]:
        """A run whose strategy cannot be had here: by the next checkpoint it may. One that begins should not wait."""
        del self._runs[checkpoint.run]
        self._pending.forget(checkpoint.run)
        if self._refused.get(checkpoint.run) != str(error):
            log.error("%s: %s", checkpoint.run, error)
        self._refused[checkpoint.run] = str(error)
        return (NoWaveforms.of(checkpoint.run, self._name, error, ends=checkpoint.k == 0),)


def _given(run: _Run, history: History) -> Sequence[Message]:
    """Take the plans that the journal has of a dwell; their planners may be gone."""
    messages = [decoded(payload) for payload in history.payloads]
    plans = [one for one in messages if isinstance(one, Plan) and one.run == history.run]
    return [answer for plan in plans for answer in _collect(run, plan)]


def _collect(run: _Run, plan: Plan) -> Sequence[Message]:
    """Take a plan; the waveform if it was the last one missing."""
    check_plan(plan, run.radar)
    run.tracks.note(plan)
    if plan.target not in run.newest or plan.k > run.newest[plan.target].k:
        run.newest[plan.target] = plan
    first, plans = run.first_open, run.plans
    if not first <= plan.k < first + MAX_DWELLS or plan.target in plans[plan.k]:
        return ()
    plans[plan.k][plan.target] = plan
    return _next(run, plan.k, is_first=len(plans[plan.k]) == 1)


def _next(run: _Run, k: int, *, is_first: bool) -> Sequence[Message]:
    """The waveform if all of dwell k is there; after the first that comes of it, a time until it is due."""
    ids, plans = run.tracks.ids(k), run.plans[k]
    if ids is not None and len(plans) >= len(ids) and plans.keys() >= ids:
        if not run.pacing.may_answer(k - run.resend.k):
            run.held.add(k)
            return ()
        run.held.discard(k)
        return _answer(run, k)
    if is_first:
        run.expect(k, DUE)
    return ()


def _when_due(run: _Run, now_s: float) -> Sequence[Message]:
    """In real time: answer with the plans there are; the others are extrapolated from their last ones."""
    if run.wait_s is not None:
        run.due_s, run.wait_s = now_s + run.wait_s, None
    if run.due_s is None or now_s < run.due_s:
        return ()
    run.due_s = None
    return _answer(run, run.k)


def _own(run: _Run) -> str:
    """The strategy, or objective, of somebody's own that makes a run's emissions; "": none is."""
    names = (run.strategy, run.radar.allocation.objective if run.strategy is Strategy.POWER_AWARE else "")
    return next((short(name) for name in names if is_own(name)), "")


def _answer(run: _Run, k: int) -> Sequence[Message]:
    """The waveform of dwell k, with earlier plans where its own are missing; none if too little is known."""
    update = run.tracks.update(k, run.newest | run.plans[k], run.orders) if run.failed is None else None
    if update is None:
        return ()
    try:
        made = waveform(run.radar, run.strategy, update, in_force(run.orders, k + 1))
    except PluginFailed as error:
        return run.give_up(update.run, error)
    except ValidationError as error:
        if not (own := _own(run)):
            raise
        said = error.errors(include_url=False, include_context=False, include_input=False)[0]["msg"]
        text = f"{own} returned what no waveform can be: {said.removeprefix('Value error, ')}"
        return run.give_up(update.run, PluginFailed(text))
    answer = run.tracks.sent(made)
    run.newest = {plan.target: plan for plan in update.plans} | {m: p for m, p in run.newest.items() if p.k > k}
    if run.pacing.loses_dwells:
        run.forget(k + 1)
    run.expect(k + 1, None)
    return run.resend.add(k, (answer,))
