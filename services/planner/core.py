"""Planner worker: owns the belief of some (run, track)s, answers each scan with a plan.

Ownership is a hint, not a lock: two owners publish the same plan twice and the allocator takes one. A track is a
function of the scans, so a new owner rebuilds it. It takes the scans it has, or else asks for a recall of the scans
since the track's last snapshot. Meanwhile the old owner goes on, if it is there. A worker whose tracks bring no plans,
alive or not, owns nothing of that run for a while.
"""

import itertools
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from cogradar.services.delivery.inactivity import Inactivity
from cogradar.services.delivery.pending import Pending
from cogradar.services.planner.run import PlannedRun, Unplanned
from cogradar.shared.protocol.events import Event, Membership, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Refused, Scan
from cogradar.shared.protocol.recovery import Handover, History, NoPlans
from cogradar.shared.protocol.slots import may_plan
from cogradar.shared.scenario.faults import listed
from cogradar.shared.scenario.plugins.names import PluginFailed, PluginRefused
from cogradar.shared.scenario.plugins.resolver import load_for
from cogradar.shared.scenario.tables import TRUE_RULES
from cogradar.shared.wire.meter import Measures
from cogradar.shared.wire.runner import Flush

SUSPENDED_S = 60.0
DEEPER = 8  # times as many owners are suspended whenever a track is overdue again within this time
NAMED = 5  # of those, in the log
TELL_S = 30.0  # from one line of the log on a run without tracks to the next
GRACE_S = 2.0  # after owners have changed: what is overdue then is the last owner's
log = logging.getLogger(__name__)


class _Overdue(NamedTuple):
    """A track whose owners brought no plans."""

    n: int  # times, in a row
    until_s: float  # after which it is forgotten


class PlannerCore:
    """Scan k in, plan k out for each track this worker owns."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` limits the searches of runs in real time; in lockstep it is never read."""
        self._name = name
        self._clock = clock
        self._workers: tuple[str, ...] = (name,)  # a bus tells of all of them before anything else
        self._is_one_gone = False  # of the planners that were there since this one is: its tracks are not offered
        self._runs: dict[str, PlannedRun] = {}
        self._suspended: dict[str, dict[str, float]] = {}  # of a run: workers without progress, and until when
        self._late: dict[str, set[str]] = {}  # of a run: workers that were suspended because they brought no plans
        self._overdue: dict[str, dict[int, _Overdue]] = {}  # of a run, by track
        self._changed_s: dict[str, float] = {}  # of a run: when its tracks changed owners, as one had gone or was late
        self._tell_s: dict[str, float] = {}  # of a run: when its progress is told next
        self._failed: dict[str, NoPlans] = {}  # runs whose rule failed
        self._refused: dict[str, str] = {}  # runs whose rule cannot be had here, and why
        self._now_s = 0.0
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def has_deferred(self) -> bool:
        """Whether a run in real time has scans that no track has observed, or the recorder lacks plans."""
        return any(run.is_behind or run.resend.is_asked for run in self._runs.values())

    def handle(self, event: Event) -> Iterable[Message | Flush]:
        """Receive a scan and plan; on a change of membership, take up the tracks that this worker now owns."""
        for run in self._inactivity.after(event):
            self._forget(run)
            self._pending.forget(run)
        try:
            answers = self._handle(event)
        except Unplanned as error:
            return self._give_up(error)
        return answers if isinstance(answers, Sequence) else self._as_far_as_it_goes(answers)

    def _as_far_as_it_goes(self, answers: Iterable[Message | Flush]) -> Iterator[Message | Flush]:
        try:
            yield from answers
        except Unplanned as error:
            yield from self._give_up(error)

    def _give_up(self, error: Unplanned) -> Sequence[Message]:
        """A run whose rule failed: it would fail in any planner."""
        log.error("%s: %s", error.run, error)
        self._forget(error.run)
        self._failed[error.run] = NoPlans.of(error.run, self._name, error, ends=True)
        return (self._failed[error.run],)

    def _forget(self, run: str) -> None:
        for known in (
            self._runs,
            self._suspended,
            self._late,
            self._overdue,
            self._changed_s,
            self._failed,
            self._refused,
        ):
            known.pop(run, None)

    def _handle(self, event: Event) -> Iterable[Message | Flush]:
        match event:
            case Checkpoint():
                return self._checkpoint(event)
            case Scan() | History() | Handover() if event.run in self._runs:
                return self._receive(self._runs[event.run], event)
            case Scan():
                self._pending.add(event)
            case NoPlans(ends=False, late=False) if event.run in self._runs and event.process != self._name:
                return self._excuse(event.run, event.process)
            case Membership():
                there = {*event.names, self._name}
                if not there.issuperset(self._workers):
                    self._is_one_gone, self._changed_s = True, dict.fromkeys(self._runs, self._now_s)
                self._workers = tuple(sorted(there))
                for name in self._runs:
                    self._forgive(name)
                return [answer for name in self._runs for answer in self._own(name)]
            case Tick():
                self._now_s = event.now_s
                self._tell_progress()
                behind = itertools.chain.from_iterable(run.catch_up() for run in self._runs.values() if run.is_behind)
                again = [plan for run in self._runs.values() for plan in run.resend.again(drained=event.drained)]
                return itertools.chain(again, self._readmit(), behind)
            case _:
                pass
        return ()

    def prepare(self) -> bool:
        """Predict one track while no scan waits."""
        return any(run.prepare() for run in self._runs.values())

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        self._pending.validate()
        self._inactivity.validate(self._runs)

    def measures(self) -> Measures:
        """How many tracks this worker owns."""
        return {"tracks_owned": sum(run.n_owned for run in self._runs.values())}

    def _tell_progress(self) -> None:
        """Log each half minute how near targets are to being found, as the owner of the first track."""
        for name, run in self._runs.items():
            due_s = self._tell_s.setdefault(name, self._now_s + TELL_S)
            if self._now_s >= due_s and self._owner(name)(0) == self._name and run.progress:
                log.info("%s: %s", name, run.progress)
            if self._now_s >= due_s:
                self._tell_s[name] = self._now_s + TELL_S
        self._tell_s = {name: due_s for name, due_s in self._tell_s.items() if name in self._runs}

    def _receive(self, run: PlannedRun, message: Scan | History | Handover) -> Iterable[Message | Flush]:
        match message:
            case Scan():
                return run.receive(message)
            case History(topic="scan" | "snapshot"):
                return run.receive_history(message)
            case Handover() if message.planner != self._name:
                return run.hand_over(message)
            case _:
                return ()

    def _checkpoint(self, checkpoint: Checkpoint) -> Iterable[Message | Flush]:
        """Begin a run, note how far it is acknowledged, or forget it."""
        name, rule = checkpoint.run, checkpoint.radar["planner"]["rule"]
        if rule in TRUE_RULES:
            raise Refused(f"radar.planner.rule = {rule}: needs the truth, which no planner is told")
        if checkpoint.ended:
            self._forget(name)
            self._pending.forget(name)
            return ()
        if name in self._failed:
            return (self._failed[name],)
        if name in self._runs:
            answers = [*self._runs[name].acknowledge(checkpoint), *self._suspend(name, checkpoint.overdue)]
            return [*answers, *self._tell_late(name)]
        try:
            load_for("planner", checkpoint.radar, checkpoint.strategy)
            self._runs[name] = PlannedRun(checkpoint, self._name, self._clock)
        except PluginFailed as error:
            return self._give_up(Unplanned(name, str(error)))
        except PluginRefused as error:
            return self._refuse(name, error)
        self._refused.pop(name, None)
        self._forgive(name)
        return [*self._own(name), *self._pending.replay(name, self.handle)]

    def _refuse(self, name: str, error: PluginRefused) -> Sequence[Message]:
        """A run whose rule cannot be had here: others may have it, and by the next checkpoint it may be here, too."""
        if self._refused.get(name) != str(error):
            log.error("%s: %s", name, error)
        self._refused[name] = str(error)
        self._runs.pop(name, None)
        self._pending.forget(name)
        return (NoPlans.of(name, self._name, error, ends=False),)

    def _excuse(self, name: str, worker: str) -> Iterable[Message | Flush]:
        """Take the tracks of a worker that cannot plan for a run, until it no longer says so."""
        suspended = self._suspended.setdefault(name, {})
        is_known, suspended[worker] = worker in suspended, self._now_s + SUSPENDED_S
        if is_known or worker not in self._workers:
            return ()
        self._forgive(name)
        self._changed_s[name] = self._now_s
        self._runs[name].await_no_offer()
        return self._own(name)

    def _own(self, name: str) -> Iterable[Message | Flush]:
        run, owner = self._runs[name], self._owner(name)
        if self._is_one_gone or len(self._workers) == 1:
            run.await_no_offer()
        return run.own(lambda alive: [m for m in alive if owner(m) == self._name])

    def _owner(self, name: str) -> Callable[[int], str]:
        """The owner of each track of a run, the same for all workers that know of the same."""
        suspended = self._suspended.get(name, {})
        return self._runs[name].source.owner([worker for worker in self._workers if worker not in suspended])

    def _suspend(self, name: str, overdue: Sequence[int]) -> Iterable[Message | Flush]:
        """Take the tracks of a run from the workers that bring no plans, if there are others.

        A track that is overdue again is taken from more and more of them at once. Names without a process, however
        many, cannot keep a run waiting, for in the end every worker plans for the track itself.
        """
        if not overdue or self._now_s < self._changed_s.get(name, -math.inf) + GRACE_S:
            return ()
        suspended, until_s = self._suspended.setdefault(name, {}), self._now_s + SUSPENDED_S
        before = self._overdue.setdefault(name, {})
        n = max(before[m].n if m in before and self._now_s < before[m].until_s else 0 for m in overdue)
        before |= dict.fromkeys(overdue, _Overdue(n + 1, until_s))
        late = set[str]()
        if n > 1:
            suspended.pop(self._name, None)
        for i in range(DEEPER**n):
            found = set(map(self._owner(name), overdue)) - {""}
            if i > 0 or n > 1:  # a planner that works this out is no mere name: it takes the track
                found.discard(self._name)
            if not found:
                break
            late |= found
            suspended |= dict.fromkeys(found, until_s)
        self._forgive(name)
        if late & suspended.keys():
            self._changed_s[name] = self._now_s
            self._late[name] = (self._late.get(name, set()) | late) & suspended.keys()
            log.warning("%s: %s", name, self._said_late(name))
        return self._own(name)

    def _said_late(self, name: str) -> str:
        """Which workers are suspended as they brought no plans, all requests together; "": none."""
        late = sorted(self._late.get(name, set()) & self._suspended.get(name, {}).keys())
        return f"{listed(late, NAMED)}: no plans; others take their tracks" if late else ""

    def _tell_late(self, name: str) -> Sequence[Message]:
        """Let the recorder say what the run waits for, or has waited for."""
        said = self._said_late(name)
        return (NoPlans.of(name, self._name, said, ends=False).model_copy(update={"late": True}),) if said else ()

    def _forgive(self, name: str) -> None:
        """Suspend none where all planners that may plan for some track are suspended."""
        suspended, alone = self._suspended.get(name, {}), list[int]()
        for m in self._runs[name].source.slots:  # a track of each slot
            able = [worker for worker in self._workers if may_plan(worker, m)]
            if not able:
                alone.append(m + 1)
            elif suspended.keys() >= set(able):
                for worker in able:
                    del suspended[worker]
        if alone:
            log.warning("%s: no planner here may plan for tracks %s", name, ", ".join(map(str, alone)))

    def _readmit(self) -> Iterator[Message | Flush]:
        """Let workers whose time is over own tracks again; the others plan until they have taken them."""
        for name, suspended in self._suspended.items():
            if over := [worker for worker, until_s in suspended.items() if self._now_s >= until_s]:
                for worker in over:
                    del suspended[worker]
                yield from self._own(name)
