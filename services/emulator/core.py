"""The service around a front end: transmits when it is time, publishes scans, and truth if the front end knows it.

It is the same for every front end (`cogradar.services.emulator.front_end`): pacing in lockstep and in real time, recall
of waveforms, redelivery. An emulator that comes back opens its front end again and goes on at the run's checkpoint.
"""

from collections.abc import Sequence

from cogradar.services.delivery.inactivity import Inactivity
from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS, pacing_at
from cogradar.services.delivery.pending import Pending, decoded
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.emulator.aside import StillWaiting
from cogradar.services.emulator.cycle import check_waveform
from cogradar.services.emulator.dwell import Run, next_dwell, skip
from cogradar.services.emulator.front_end import OpenFrontEnd, Settings
from cogradar.services.emulator.kept_open import Counts, KeptOpen
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, Refused, Waveform
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.wire.meter import Measures

LOOK_S = 0.02  # lockstep: from a look for the answer of a front end that is asked aside to the next
LATE = 0.2  # real time: periods after which a dwell is late, as after a receiver that is slower than the rate
LOOK = 0.1  # ... and after which it is looked again whether it may be transmitted
ANSWERED = 3  # dwells: a waveform that is no older shows that others answer


class EmulatorCore:
    """Waveform k in, scan k+1 out, for any number of runs."""

    def __init__(self, open_front_end: OpenFrontEnd) -> None:
        self._open = open_front_end
        self._counts = Counts()
        self._runs: dict[str, Run] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()
        self._ticked_s = 0.0

    @property
    def wake_s(self) -> float | None:
        """When the next dwell of a run in real time is due, or an answer is looked for."""
        due = [run.due_s for run in self._runs.values() if run.is_ticking and run.due_s is not None]
        due += [self._ticked_s + LOOK_S for run in self._runs.values() if run.awaits_answer]
        return min(due, default=None)

    @property
    def has_deferred(self) -> bool:
        """Whether a run in real time waits for the tick of its first dwell, or the recorder for what it lacks."""
        return any((run.is_ticking and run.due_s is None) or run.resend.is_asked for run in self._runs.values())

    @property
    def busy(self) -> frozenset[int]:
        """Shards with runs."""
        return self._inactivity.busy

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, let more dwells happen, or send again what was lost."""
        for name in self._inactivity.after(event):
            self._forget(name)
            self._pending.forget(name)
        match event:
            case _ if self._inactivity.is_elsewhere(event):
                pass
            case EmulatorCheckpoint(ended=True):
                self._forget(event.run)
                self._pending.forget(event.run)
            case EmulatorCheckpoint() if event.run in self._runs:
                return _checkpoint(self._runs[event.run], event)
            case EmulatorCheckpoint():
                return self._begin(event)
            case Waveform() if event.run in self._runs:
                return _take(self._runs[event.run], event)
            case History(topic="waveform") if event.run in self._runs:
                return self._recalled(self._runs[event.run], event)
            case Waveform():
                self._pending.add(event)
            case Tick():
                self._ticked_s = event.now_s
                answers = [answer for run in self._runs.values() for answer in _pulse(run, event)]
                self._inactivity.note(answers)  # in real time the radar goes on, though no other process is left
                return answers + [m for run in self._runs.values() for m in run.resend.again(drained=event.drained)]
        return ()

    def prepare(self) -> bool:
        """Let a front end prepare a dwell whose waveform is still to come."""
        return any(run.front_end.prepare() for run in self._runs.values() if not run.over)

    @property
    def trouble(self) -> str:
        """Why front ends measure nothing; "": they do."""
        return "; ".join(f"{name}: front end: {run.front_end.fault}" for name, run in self._troubled())

    def measures(self) -> Measures:
        """What the front ends came to."""
        return {
            "front_end_failures": self._counts.failures,
            "front_ends_failing": len(self._troubled()),
            "scans_senseless": self._counts.senseless,
            "dwells_not_measured": self._counts.dwells,
            "looks_asked": self._counts.asked,
            "looks_not_measured": self._counts.looks,
        }

    def _troubled(self) -> list[tuple[str, Run]]:
        return [(name, run) for name, run in self._runs.items() if run.front_end.fault and not run.over]

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        self._pending.validate()
        self._inactivity.validate(self._runs)
        for run in self._runs.values():
            run.resend.validate()
            require(run.t <= min(run.settings.dwells, run.k), f"dwell {run.k} at t = {run.t}")
            may_be = run.pacing.has_deadlines or run.k - run.resend.k <= MAX_AHEAD_DWELLS
            require(may_be, f"dwell {run.k}, though only those before {run.resend.k} are acknowledged")

    def close(self) -> None:
        """Stop transmitting."""
        for name in list(self._runs):
            self._forget(name)

    def _begin(self, checkpoint: EmulatorCheckpoint) -> Sequence[Message]:
        """Go on after dwell k-1, of which nothing is known here but the checkpoint."""
        settings = Settings.of(checkpoint)
        self._forget(checkpoint.run)
        pacing = pacing_at(settings.rate_hz)
        run = self._runs[checkpoint.run] = Run(
            settings,
            KeptOpen(self._open, checkpoint, pacing, self._counts),
            k=checkpoint.k,
            t=checkpoint.t,
            begun_k=checkpoint.k,
            orders=checkpoint.orders,
            resend=ResendBuffer(checkpoint.k),
            pacing=pacing,
            awaits_first_waveform=settings.radar.is_unknown and checkpoint.k == 0,
        )
        if checkpoint.newest_k is not None and checkpoint.newest_t > run.t:  # the journal lags behind the radar
            run.k, run.t = checkpoint.newest_k + 1, checkpoint.newest_t
        if run.t > 0 or run.is_tracking(None):  # the acquisition has no dwell to spare
            run.last_k = checkpoint.newest_k
            skip(run, max(run.k, checkpoint.due_k))
            run.begun_k = run.k
        answers = [*_go_on(run), *self._pending.replay(checkpoint.run, self.handle)]
        return [*answers, *_missing(run)]

    def _forget(self, name: str) -> None:
        if (run := self._runs.pop(name, None)) is not None:
            run.front_end.close()

    def _recalled(self, run: Run, history: History) -> Sequence[Message]:
        """All that was recalled, or nothing: what was transmitted before one is refused would not be sent."""
        messages = [decoded(payload) for payload in history.payloads]
        waveforms = [one for one in messages if isinstance(one, Waveform) and one.run == history.run]
        for waveform in waveforms:
            _check(run, waveform)
        return [answer for waveform in waveforms for answer in _take(run, waveform)]


def _check(run: Run, waveform: Waveform) -> None:
    """Refuse what cannot be transmitted, or is of a dwell that the radar cannot have come to."""
    check_waveform(waveform, run.radar, run.settings.dwells)
    ahead = waveform.k - run.k
    if run.k > run.begun_k and ahead > run.pacing.most_ahead:  # at first the others may have gone on without us
        raise Refused(f"waveform of dwell {waveform.k}, {ahead} dwells ahead of the radar")


def _take(run: Run, waveform: Waveform) -> Sequence[Message]:
    """Keep a waveform until its dwell comes; a repeated one changes nothing."""
    _check(run, waveform)
    run.awaits_first_waveform = False
    if run.pacing.has_deadlines:
        if waveform.k >= max(run.waveforms, default=0):
            run.waveforms = {waveform.k: waveform}
        if run.waited_k == run.k <= waveform.k + 1:
            run.due_s = None
    elif run.k - 1 <= waveform.k < run.k + MAX_AHEAD_DWELLS and not run.over:
        run.waveforms.setdefault(waveform.k, waveform)
    return _go_on(run)


def _checkpoint(run: Run, checkpoint: EmulatorCheckpoint) -> Sequence[Message]:
    """Go on as far as the journal allows; what the recorder lacks is sent again at a tick."""
    run.resend.acknowledge(checkpoint)
    run.orders = checkpoint.orders
    return [*_go_on(run), *_missing(run)]


def _missing(run: Run) -> Sequence[Message]:
    """The recall of the next waveform, if the journal has it already and we do not."""
    any_will_do = run.pacing.has_deadlines
    is_here = run.k - 1 in run.waveforms or (any_will_do and run.waveforms)
    may_be_there = run.k <= run.resend.k or (any_will_do and run.resend.k > 0)
    lacks = not run.over and run.k > 0 and may_be_there and not is_here
    return (WaveformRecall(run=run.settings.run, k=run.k - 1),) if lacks else ()


def _go_on(run: Run) -> Sequence[Message]:
    """In lockstep: transmit as far as waveforms are there and the recorder keeps up."""
    answers: list[Message] = []
    while not run.over and run.pacing.may_transmit(run.k - run.resend.k):
        before = run.k - 1
        waveform = run.waveforms.get(before)
        if waveform is None and run.k > 0:
            break
        try:
            answers += next_dwell(run, waveform, 0.0)
        except StillWaiting:
            run.awaits_answer = True
            return answers
        run.waveforms.pop(before, None)
    run.awaits_answer = False
    return answers


def _pulse(run: Run, now: Tick) -> Sequence[Message]:
    """In real time: transmit when it is due, with the newest waveform there is."""
    if run.awaits_answer:
        return _go_on(run)
    now_s = now.now_s
    due_s = run.pacing.next_due_s(run.due_s, now_s)
    if run.over or due_s is None or _waits(run, now):
        return ()
    overdue = 0 if run.due_s is None else run.pacing.overdue(run.due_s, now_s)
    run.due_s = due_s
    if run.t > 0 and run.front_end.is_down:  # its opening took so long; a receiver that is slow lowers the rate
        skip(run, run.k + overdue)
    waveform = next(iter(run.waveforms.values()), None)
    if run.t > 0 and waveform is None and not run.awaits_first_waveform:
        return ()  # back in mid-run: the allocator goes on sending waveforms, and the journal's newest was asked for
    # The acquisition has no dwell to spare; but others may have come to its end.
    if waveform is not None and waveform.k >= run.k and (waveform.tracking or run.t > 0):
        skip(run, waveform.k + 1)
    return next_dwell(run, waveform, now_s)


def _waits(run: Run, now: Tick) -> bool:
    """In real time: whether a dwell that is late anyway, as after a slow receiver, waits, for a period at most.

    For the messages that have come, first: one for each dwell would fall behind, orders with them. Then for the
    waveform of the dwell before, which takes some time: each dwell would be radiated with an older one. Others are
    waited for only if they have answered lately.
    """
    period_s, newest_k = run.pacing.seconds(1), max(run.waveforms, default=-1)
    if run.waited_k != run.k:
        is_late = run.due_s is not None and now.now_s >= run.due_s + LATE * period_s
        if not is_late or run.front_end.is_down:  # what is down skips the dwells that its opening took
            return False
        run.waited_k, run.waits_until_s = run.k, now.now_s + period_s
    are_answering = run.t > 0 and newest_k >= run.k - ANSWERED
    if newest_k >= run.k - 1 or now.now_s >= run.waits_until_s or (now.drained and not are_answering):
        return False
    run.due_s = min(now.now_s + LOOK * period_s, run.waits_until_s)
    return True
