"""One run at its front end: what is radiated in a dwell, and the messages that come of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cogradar.services.delivery.pacing import Pacing
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.emulator.cycle import compared, limited, scan_message, transmission, truth_message
from cogradar.services.emulator.front_end import (
    FrontEndError,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    fault_line,
)
from cogradar.services.emulator.kept_open import KeptOpen
from cogradar.shared.protocol.messages import MAX_REASON, Message, RunEnd, Scan, Waveform
from cogradar.shared.protocol.orders import PAUSED, Order, ends, in_force, is_paused, is_paused_for_some, power_share
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.scan import Detections, Strongest

SAY_S = 5.0  # real time: while targets are acquired, from a scan without a measurement to the next that is sent


@dataclass
class Run:
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


def skip(run: Run, k: int) -> None:
    """In real time: the clock, or others, went on to dwell k meanwhile; the dwells in between never happened."""
    skipped = min(k - run.k, run.settings.dwells - run.t)
    run.k, run.t = run.k + skipped, run.t + skipped


def next_dwell(run: Run, waveform: Waveform | None, now_s: float) -> Sequence[Message]:
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


def _end(run: Run, k: int, status: str, reason: str = "") -> Sequence[Message]:
    run.over = True
    end = {"run": run.settings.run, "k": max(k - 1, 0), "t": run.t, "status": status, "reason": reason[:MAX_REASON]}
    return (RunEnd.model_validate(end),)


def _transmit(run: Run, k: int, waveform: Waveform | None, now_s: float) -> Sequence[Message]:
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


def _asked(run: Run, k: int, waveform: Waveform | None) -> Transmission:
    """What orders let be radiated in a dwell: an allocator that is away knows no new one."""
    orders = in_force(run.orders, k)
    most = 0.0 if is_paused(orders) else run.radar.array.power * power_share(orders)
    return limited(transmission(run.radar, waveform), most)


def _with_truth(run: Run, scan: Scan, waveform: Waveform | None) -> Sequence[Message]:
    """The messages of a dwell. Raises FrontEndError."""
    truth = run.front_end.truth(scan.t)
    if truth is None:
        return (scan,)
    try:
        return (scan, truth_message(scan, truth, waveform))  # the loop waits for the scan
    except (AttributeError, TypeError, ValueError) as error:
        raise FrontEndError(fault_line(f"truth: {error}")) from error


def _note(run: Run, scan: Scan, now_s: float) -> None:
    """Count what the front end came to in a dwell."""
    n_unmeasured = 0 if scan.unmeasured is None else scan.unmeasured.size
    looks = scan.bins if scan.nus is None else scan.nus
    n_measured = len(set(looks.tolist()))  # a look may have several rows
    run.front_end.note(n_measured, n_unmeasured, scan.fault, now_s)


def _scan(run: Run, k: int, measured: ScanData, waveform: Waveform | None, asked: Transmission) -> Scan | str:
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
