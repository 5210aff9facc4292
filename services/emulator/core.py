"""The service around a front end: transmits when it is time, publishes scans, and truth if the front end knows it.

It is the same for every front end (`cogradar.services.emulator.front_end`): pacing in lockstep and in real time, recall
of waveforms, redelivery. An emulator that comes back opens its front end again and goes on at the run's checkpoint.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cogradar.services.delivery.inactivity import Inactivity
from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS, Pacing, pacing_at
from cogradar.services.delivery.pending import Pending, decoded
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.emulator.aside import StillWaiting
from cogradar.services.emulator.cycle import (
    check_waveform,
    compared,
    limited,
    scan_message,
    transmission,
    truth_message,
)
from cogradar.services.emulator.front_end import (
    FrontEndError,
    OpenFrontEnd,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    fault_line,
)
from cogradar.services.emulator.kept_open import Counts, KeptOpen
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import (
    MAX_REASON,
    EmulatorCheckpoint,
    Message,
    Refused,
    RunEnd,
    Scan,
    Waveform,
)
from cogradar.shared.protocol.orders import Order, ends, in_force, is_paused, is_paused_for_some, power_share
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.scan import Detections, Strongest
from cogradar.shared.wire.meter import Measures

PAUSED = "transmission is paused"
LOOK_S = 0.02  # lockstep: from a look for the answer of a front end that is asked aside to the next
LATE = 0.2  # real time: periods after which a dwell is late, as after a receiver that is slower than the rate
ANSWERED = 3  # dwells: a waveform that is no older shows that others answer
SAY_S = 5.0  # real time: while targets are acquired, from a scan without a measurement to the next that is sent


@dataclass
class _Run:
    """One run at its front end."""

    settings: Settings
    front_end: KeptOpen
    k: int  # next dwell to transmit
    t: int  # clock of dwell k-1
    resend: ResendBuffer
    pacing: Pacing
    waveforms: dict[int, Waveform] = field(default_factory=dict)  # of dwell k-1 and later; in real time the newest
    due_s: float | None = None  # in real time: when dwell k is to be transmitted; None: at the next tick
    waited_k: int = -1  # in real time: the newest dwell that was late, and waits, or has waited,
    waits_until_s: float = 0.0  # ... at most until then
    begun_k: int = 0  # k when the run was begun here
    over: bool = False
    last_k: int | None = None  # dwell of the last scan, if that is known
    strongest: Strongest | None = None  # of the acquisition
    unmeasured: int = 0  # dwells of the acquisition in which nothing was measured
    last_fault: str = ""  # ... why
    said: int = 0  # in real time: of these dwells, those that were sent, beyond the scans that there may be
    say_s: float = 0.0  # ... and when the next one may be
    orders: Sequence[Order] = ()  # as the last checkpoint says
    awaits_first_waveform: bool = False  # of a run that begins, whose number of tracks is unknown
    awaits_answer: bool = False  # in lockstep: its front end is asked for dwell k, and others go on meanwhile

    @property
    def is_ticking(self) -> bool:
        """Whether its dwells are transmitted by the clock."""
        return self.pacing.has_deadlines and not self.over

    @property
    def radar(self) -> RadarConfig:
        """Its radar."""
        return self.settings.radar

    def is_tracking(self, waveform: Waveform | None) -> bool:
        """Whether the clock of the run advances in a dwell with this waveform: it is no acquisition."""
        return self.radar.is_unknown or (waveform is not None and waveform.tracking)


class EmulatorCore:
    """Waveform k in, scan k+1 out, for any number of runs."""

    def __init__(self, open_front_end: OpenFrontEnd) -> None:
        self._open = open_front_end
        self._counts = Counts()
        self._runs: dict[str, _Run] = {}
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

    def _troubled(self) -> list[tuple[str, _Run]]:
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
        run = self._runs[checkpoint.run] = _Run(
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
        if run.t > 0 or run.is_tracking(None):  # the acquisition has no dwell to spare
            run.last_k = checkpoint.newest_k
            _skip(run, max(run.k, checkpoint.due_k))
            run.begun_k = run.k
        answers = [*_go_on(run), *self._pending.replay(checkpoint.run, self.handle)]
        return [*answers, *_missing(run)]

    def _forget(self, name: str) -> None:
        if (run := self._runs.pop(name, None)) is not None:
            run.front_end.close()

    def _recalled(self, run: _Run, history: History) -> Sequence[Message]:
        """All that was recalled, or nothing: what was transmitted before one is refused would not be sent."""
        messages = [decoded(payload) for payload in history.payloads]
        waveforms = [one for one in messages if isinstance(one, Waveform) and one.run == history.run]
        for waveform in waveforms:
            _check(run, waveform)
        return [answer for waveform in waveforms for answer in _take(run, waveform)]


def _check(run: _Run, waveform: Waveform) -> None:
    """Refuse what cannot be transmitted, or is of a dwell that the radar cannot have come to."""
    check_waveform(waveform, run.radar, run.settings.dwells)
    ahead = waveform.k - run.k
    if run.k > run.begun_k and ahead > run.pacing.most_ahead:  # at first the others may have gone on without us
        raise Refused(f"waveform of dwell {waveform.k}, {ahead} dwells ahead of the radar")


def _take(run: _Run, waveform: Waveform) -> Sequence[Message]:
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


def _checkpoint(run: _Run, checkpoint: EmulatorCheckpoint) -> Sequence[Message]:
    """Go on as far as the journal allows; what the recorder lacks is sent again at a tick."""
    run.resend.acknowledge(checkpoint)
    run.orders = checkpoint.orders
    return [*_go_on(run), *_missing(run)]


def _missing(run: _Run) -> Sequence[Message]:
    """The recall of the next waveform, if the journal has it already and we do not."""
    any_will_do = run.pacing.has_deadlines
    is_here = run.k - 1 in run.waveforms or (any_will_do and run.waveforms)
    may_be_there = run.k <= run.resend.k or (any_will_do and run.resend.k > 0)
    lacks = not run.over and run.k > 0 and may_be_there and not is_here
    return (WaveformRecall(run=run.settings.run, k=run.k - 1),) if lacks else ()


def _go_on(run: _Run) -> Sequence[Message]:
    """In lockstep: transmit as far as waveforms are there and the recorder keeps up."""
    answers: list[Message] = []
    while not run.over and run.pacing.may_transmit(run.k - run.resend.k):
        before = run.k - 1
        waveform = run.waveforms.get(before)
        if waveform is None and run.k > 0:
            break
        try:
            answers += _next_dwell(run, waveform, 0.0)
        except StillWaiting:
            run.awaits_answer = True
            return answers
        run.waveforms.pop(before, None)
    run.awaits_answer = False
    return answers


def _pulse(run: _Run, now: Tick) -> Sequence[Message]:
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
        _skip(run, run.k + overdue)
    waveform = next(iter(run.waveforms.values()), None)
    if run.t > 0 and waveform is None and not run.awaits_first_waveform:
        return ()  # back in mid-run: the allocator goes on sending waveforms, and the journal's newest was asked for
    # The acquisition has no dwell to spare; but others may have come to its end.
    if waveform is not None and waveform.k >= run.k and (waveform.tracking or run.t > 0):
        _skip(run, waveform.k + 1)
    return _next_dwell(run, waveform, now_s)


def _waits(run: _Run, now: Tick) -> bool:
    """In real time: whether a dwell that is late anyway, as after a slow receiver, waits, for a period at most.

    For the messages that have come, first: one for each dwell would fall behind, orders with them. Then for the
    waveform of the dwell before, which takes some time: each dwell would be radiated with an older one. Others are
    waited for only if they have answered lately.
    """
    if run.due_s is None or now.now_s < run.due_s + run.pacing.seconds(1) * LATE:
        return False
    if run.waited_k != run.k:
        run.waited_k, run.waits_until_s = run.k, now.now_s + run.pacing.seconds(1)
    if now.now_s >= run.waits_until_s or not now.drained:
        return now.now_s < run.waits_until_s
    is_on_its_way = run.t > 0 and run.k - ANSWERED <= max(run.waveforms, default=-1) < run.k - 1
    if is_on_its_way:
        run.due_s = run.waits_until_s
    return is_on_its_way


def _skip(run: _Run, k: int) -> None:
    """In real time: the clock, or others, went on to dwell k meanwhile; the dwells in between never happened."""
    skipped = min(k - run.k, run.settings.dwells - run.t)
    run.k, run.t = run.k + skipped, run.t + skipped


def _next_dwell(run: _Run, waveform: Waveform | None, now_s: float) -> Sequence[Message]:
    """Dwell k with this waveform, or, before there is any, with power in all directions; or the end of the run."""
    k, max_scans = run.k, run.radar.acquisition.max_scans
    if run.t == run.settings.dwells or (run.t > 0 and ends(run.orders, k)):
        answers = _end(run, k, "complete", "" if run.t == run.settings.dwells else "ended by command")
    elif ends(run.orders, k):
        answers = _end(run, k, "failed", "ended by a command before every target was detected")
    elif not run.is_tracking(waveform) and k - run.said >= max_scans:
        measured = k - (run.said if run.pacing.loses_dwells else run.unmeasured)
        reason = f"not every target was detected within {measured} scans"
        nearest = f"; {run.strongest}" if run.strongest is not None else ""
        if run.strongest is not None and run.strongest.share > 1.0:  # detections which no target explains
            nearest += "; are echoes as strong as radar.echo.amplitude_db says? cogradar calibrate measures them"
        lost = f"; nothing was measured in {run.unmeasured} dwells: {run.last_fault}" if run.unmeasured else ""
        answers = _end(run, k, "failed", reason + nearest + lost)
    else:
        try:
            answers = _transmit(run, k, waveform, now_s)
        except FrontEndError as error:
            answers = _end(run, k, "failed", f"front end: {error}")
    if not answers:
        return ()
    run.k += 1
    return run.resend.add(k, answers)


def _end(run: _Run, k: int, status: str, reason: str = "") -> Sequence[Message]:
    run.over = True
    end = {"run": run.settings.run, "k": max(k - 1, 0), "t": run.t, "status": status, "reason": reason[:MAX_REASON]}
    return (RunEnd.model_validate(end),)


def _transmit(run: _Run, k: int, waveform: Waveform | None, now_s: float) -> Sequence[Message]:
    """One transmit-receive cycle, or the end of a front end that has no more of them.

    While targets are acquired in real time, a dwell without a measurement is none: the acquisition has none to spare.
    As many more as it has are sent all the same, now and then, so that all are told of the fault. Of a pause for a
    number of dwells each one is: it would never be over.
    """
    asked = _asked(run, k, waveform)
    is_tracking = run.is_tracking(waveform)
    measured: ScanData | None = ScanData.not_measured(PAUSED)  # its front end is left alone
    if asked.power > 0.0:
        measured = run.front_end.transmit(k, (run.t, run.t + is_tracking), asked, now_s)
    if measured is None and run.t == 0:
        raise FrontEndError("no more dwells, and not every target is detected")
    if measured is None:
        return _end(run, k, "complete", "the front end has no more dwells")
    scan = _scan(run, k, measured, waveform, asked)
    if isinstance(scan, str):
        scan = _scan(run, k, run.front_end.refuse(scan, now_s), waveform, asked)
    if isinstance(scan, str):
        raise FrontEndError(scan)
    if asked.power > 0.0:
        _note(run, scan, now_s)
    if scan.t == 0:
        limit = threshold(run.radar.detector.p_fa)
        run.strongest = Strongest.of(Detections.of(vars(scan), run.radar.array.n_bin, limit), run.strongest)
    if scan.t == 0 and not scan.bins.size:
        run.unmeasured, run.last_fault = run.unmeasured + 1, scan.fault or run.front_end.fault
        if run.pacing.loses_dwells:
            may_wait = now_s < run.say_s and not is_paused_for_some(in_force(run.orders, k))
            if may_wait or run.said >= run.radar.acquisition.max_scans:
                return ()
            run.said, run.say_s = run.said + 1, now_s + SAY_S
    run.t, run.last_k = scan.t, k
    return _with_truth(run, scan, waveform)


def _asked(run: _Run, k: int, waveform: Waveform | None) -> Transmission:
    """What orders let be radiated in a dwell: an allocator that is away knows no new one."""
    orders = in_force(run.orders, k)
    most = 0.0 if is_paused(orders) else run.radar.array.power * power_share(orders)
    return limited(transmission(run.radar, waveform), most)


def _with_truth(run: _Run, scan: Scan, waveform: Waveform | None) -> Sequence[Message]:
    """The messages of a dwell. Raises FrontEndError."""
    truth = run.front_end.truth(scan.t)
    if truth is None:
        return (scan,)
    try:
        return (scan, truth_message(scan, truth, waveform))  # the loop waits for the scan
    except (AttributeError, TypeError, ValueError) as error:
        raise FrontEndError(fault_line(f"truth: {error}")) from error


def _note(run: _Run, scan: Scan, now_s: float) -> None:
    """Count what the front end came to in a dwell."""
    n_unmeasured = 0 if scan.unmeasured is None else scan.unmeasured.size
    looks = scan.bins if scan.nus is None else scan.nus
    n_measured = len(set(looks.tolist()))  # a look may have several rows
    run.front_end.note(n_measured, n_unmeasured, scan.fault, now_s)


def _scan(run: _Run, k: int, measured: ScanData, waveform: Waveform | None, asked: Transmission) -> Scan | str:
    """The scan of a dwell, or why it cannot be."""
    try:
        sent_k = -1 if waveform is None else waveform.k
        measured = compared(run.radar, asked, measured, sent_k if sent_k < k - 1 else None)
        is_lit = measured.beams is not None and (np.asarray(measured.beams) >= 0).any()
        t = run.t + (1 if is_lit or run.radar.is_unknown else 0)
        return scan_message(run.settings, k, t, measured, waveform, run.last_k)
    except SenselessScan as error:
        return str(error)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # it is no array, ...
        return f"{type(error).__name__}: {error}"
