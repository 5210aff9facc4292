"""A run's front end, kept open: one that fails is closed and opened again, each time after a longer pause.

In real time the radar goes on meanwhile, with dwells in which nothing is measured. In lockstep a dwell waits for its
measurement: it is tried again at once, a few times, so that a fault that passes changes nothing in the run.
"""

import logging
from dataclasses import dataclass, replace

from cogradar.services.delivery.pacing import Pacing
from cogradar.services.emulator.aside import CannotOpen, StillWaiting
from cogradar.services.emulator.front_end import (
    FrontEnd,
    FrontEndError,
    GroundTruth,
    KnowsTruth,
    OpenFrontEnd,
    ScanData,
    SenselessScan,
    Transmission,
    fault_line,
    told,
)
from cogradar.services.errors import Interrupted
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.wire.runner import Preparing

FIRST_S, LONGEST_S = 0.5, 30.0  # real time: from a failure to the next opening; twice as long each time
ATTEMPTS = 5  # in lockstep, at one dwell
WELL = 10  # dwells in lockstep, which has no clock, that are measured until a fault is logged again
REPEAT_S = 30.0  # after which what goes on is logged again
log = logging.getLogger(__name__)


@dataclass
class Counts:
    """What the front ends of a process came to, of all runs."""

    failures: int = 0  # openings and dwells that raised
    senseless: int = 0  # scans that were refused
    dwells: int = 0  # in which nothing was measured
    asked: int = 0  # looks
    looks: int = 0  # ... that were not measured, with the looks of these dwells


class KeptOpen:
    """The front end of one run."""

    def __init__(self, opens: OpenFrontEnd, checkpoint: EmulatorCheckpoint, pacing: Pacing, counts: Counts) -> None:
        """Open it. At the beginning of a run it must succeed: what fails then is a setting more often than a fault."""
        self._opens, self._checkpoint, self._pacing, self._counts = opens, checkpoint, pacing, counts
        self._source: str | None = getattr(opens, "source", None)  # of a user's own, with its hash
        self._open: FrontEnd | None = None
        self._delay_s = 0.0
        self._failed_s: float | None = None  # when the dwell was due in which it failed; None: its time is counted
        self._retry_s = 0.0
        self._now_s = 0.0  # when the last dwell was due
        self.is_down = False  # it was out of use, or was opened, in the last dwell: that may have taken long
        self._lost, self._well = 0, 0  # dwells in a row
        self._told_s: dict[str, float] = {}  # by what went wrong: when it was logged last
        self._is_told = False  # that nothing is measured
        self._is_known = False  # of the last dwell, that it is for a fault
        self.fault = ""  # why nothing was measured in the last dwell; "": something was
        self._reopen(0.0, checkpoint.k, checkpoint.t)
        self._ends = self.fault if checkpoint.k == 0 else ""
        self._k, self._tries = checkpoint.k, 0  # dwell, and attempts at it that failed

    def prepare(self) -> bool:
        """Let it prepare the next dwell, if it can; false if there is nothing left to do."""
        front_end: object = self._open
        try:
            return isinstance(front_end, Preparing) and bool(front_end.prepare())
        except Interrupted:
            raise
        except Exception as error:  # noqa: BLE001 - somebody else's front end may raise anything
            self._fail(error, self._now_s)
            return False

    def truth(self, t: int) -> GroundTruth | None:
        """Where the targets were at clock t, of the newest dwell; None: unknown. Raises FrontEndError."""
        try:
            return self._open.truth(t) if isinstance(self._open, KnowsTruth) else None
        except Interrupted:
            raise
        except Exception as error:  # scores would lack dwells
            raise FrontEndError(fault_line(f"truth: {told(error)}")) from error

    def transmit(self, k: int, clock: tuple[int, int], asked: Transmission, now_s: float) -> ScanData | None:
        """Transmit dwell k and measure, as far as there is a front end; None: there are no more dwells.

        clock : t of the dwell before, and of this one
        Raises FrontEndError if the run cannot go on, and StillWaiting if the same call has to be made again.
        """
        if self._ends:
            raise FrontEndError(self._ends)
        self._begin(now_s)
        if k != self._k:
            self._k, self._tries = k, 0
        while self._tries < ATTEMPTS:
            if self._open is None and now_s >= self._retry_s:
                self.is_down = True
                self._reopen(now_s, k, clock[0])
            if self._open is not None:
                try:
                    return self._named(self._open.transmit(k, clock[1], asked))
                except (Interrupted, StillWaiting):  # the user's wish, or time that passes: not the front end's fault
                    raise
                except SenselessScan as error:
                    return self.refuse(str(error), now_s)
                except Exception as error:
                    self._fail(error, now_s)
                    if k == self._tries == 0 and isinstance(error, CannotOpen):
                        raise FrontEndError(self.fault) from error
            if self._pacing.has_deadlines:
                self._tell("failed", now_s)
                return ScanData.not_measured(self.fault)
            self._tries += 1
        raise FrontEndError(f"{self.fault}; tried {ATTEMPTS} times")

    def _named(self, measured: ScanData | None) -> ScanData | None:
        """What was measured, with the name of the user's own front end that did."""
        if self._source is None or not isinstance(measured, ScanData):
            return measured
        return replace(measured, front_end=self._source)

    def _begin(self, now_s: float) -> None:
        """A dwell begins. The pause after a failure is counted from its end, which may have come late."""
        if self._failed_s is not None:
            ended_s = max(self._failed_s, now_s - self._pacing.seconds(1))
            self._retry_s, self._failed_s = ended_s + self._delay_s, None
        self._now_s, self.is_down = now_s, self._open is None

    def note(self, measured: int, unmeasured: int, fault: str | None, now_s: float) -> None:
        """Count what a dwell came to: looks that were measured, and those that were not."""
        self._counts.asked += measured + unmeasured
        self._counts.looks += unmeasured
        if measured:
            if self._is_told:
                log.info("%s: front end: measures again, after %d dwells", self._checkpoint.run, self._lost)
            self._lost, self._delay_s, self.fault, self._is_told, self._is_known = 0, 0.0, "", False, False
            self._well += 1
            if self._well == WELL and not self._pacing.has_deadlines:
                self._told_s.clear()
            return
        self._counts.dwells += 1
        self._lost, self._well = self._lost + 1, 0
        self.fault = fault or "nothing was measured"
        if not self._is_known:
            self._tell("unmeasured", now_s)
        self._is_known = False

    def refuse(self, why: str, now_s: float) -> ScanData:
        """In place of a scan that cannot be: nothing was measured."""
        self._counts.senseless += 1
        self.fault = fault_line(f"senseless scan: {why}")
        self._tell("senseless", now_s)
        return ScanData.not_measured(self.fault)

    def close(self) -> None:
        """Switch it off."""
        front_end, self._open = self._open, None
        if front_end is not None:
            try:
                front_end.close()
            except Exception:
                log.exception("the front end of %s cannot be closed", self._checkpoint.run)

    def _reopen(self, now_s: float, k: int, t: int) -> None:
        try:
            self._open = self._opens(self._checkpoint.model_copy(update={"k": k, "t": t}))
        except Interrupted:
            raise
        except Exception as error:  # noqa: BLE001 - somebody else's front end may raise anything
            self._fail(error, now_s)
            return
        if self._checkpoint.world is not None and not isinstance(self._open, KnowsTruth):
            self._fail(FrontEndError("this front end knows no truth: the scenario must have no [world]"), now_s)

    def _fail(self, error: Exception, now_s: float) -> None:
        """It is of no use any more."""
        self._counts.failures += 1
        is_its_own = isinstance(error, FrontEndError)
        self.fault = fault_line(str(error) if is_its_own else told(error))
        self._tell("failed", now_s, None if is_its_own else error)
        self.close()
        self._delay_s = min(2.0 * self._delay_s or FIRST_S, LONGEST_S) if self._pacing.has_deadlines else 0.0
        self._failed_s, self.is_down = now_s, True

    def _tell(self, what: str, now_s: float, error: Exception | None = None) -> None:
        """Log the fault, and its like not again for a while: each dwell may have one, with other numbers in it."""
        self._is_known = True
        if now_s < self._told_s.get(what, -REPEAT_S) + REPEAT_S:
            return
        self._told_s[what], self._is_told = now_s, True
        since = f"; nothing was measured in the last {self._lost} dwells" if self._lost > 1 else ""
        log.warning("%s: front end: %s%s", self._checkpoint.run, self.fault, since, exc_info=error)
