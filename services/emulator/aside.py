"""A front end in another process, asked aside: in lockstep, where nothing is late, the emulator need not wait for it.

Its calls are made in a thread of its own. Meanwhile other runs go on, and the run can be cancelled.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import Event

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, OpenFrontEnd, ScanData, Transmission
from cogradar.shared.protocol.messages import EmulatorCheckpoint

AT_ONCE_S = 0.1  # so long all wait for a dwell: a front end that is well answers within it

Check = Callable[[], None]  # raises to give up what is waited for


class StillWaiting(Exception):
    """There is no answer yet: the same call, later, asks for it again."""


class CannotOpen(FrontEndError):
    """It could not be opened; the text says why."""


class OpensAside:
    """Opens front ends that are asked aside in lockstep."""

    def __init__(self, make: Callable[[Check], OpenFrontEnd], check: Check) -> None:
        """`make` gives what opens a front end and gives up where `check` raises."""
        self._make, self._check = make, check

    def __call__(self, checkpoint: EmulatorCheckpoint) -> FrontEnd:
        """Begin to open it. Raises FrontEndError in real time, where it is opened at once."""
        if pacing_at(checkpoint.rate_hz).has_deadlines:
            return self._make(self._check)(checkpoint)
        return Aside(self._make, self._check, checkpoint)


class Aside:
    """One run's front end, which may still be being opened."""

    def __init__(self, make: Callable[[Check], OpenFrontEnd], check: Check, checkpoint: EmulatorCheckpoint) -> None:
        self._is_closed, self._outer = Event(), check
        self._thread = ThreadPoolExecutor(1, f"front end of {checkpoint.run}")
        self._opened = self._thread.submit(make(self._check), checkpoint)
        self._asked: tuple[int, Future[ScanData | None]] | None = None  # dwell and its answer

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        """Transmit dwell k, once. Raises StillWaiting until its measurement is there."""
        is_new = self._asked is None or self._asked[0] != k
        if self._asked is None or is_new:
            self._asked = k, self._thread.submit(self._transmit, k, t, waveform)
        answer = self._asked[1]
        wait([answer], AT_ONCE_S if is_new else 0.0)
        if not answer.done():
            raise StillWaiting
        return answer.result()

    def close(self) -> None:
        """Give up what is waited for. Its thread switches it off and ends, if it was opened."""
        self._is_closed.set()
        self._thread.submit(self._close)
        self._thread.shutdown(wait=False)

    def _transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        try:
            front_end = self._opened.result()
        except FrontEndError as error:
            raise CannotOpen(str(error)) from error
        self._check()
        return front_end.transmit(k, t, waveform)

    def _close(self) -> None:
        if self._opened.exception() is None:
            self._opened.result().close()

    def _check(self) -> None:
        self._outer()
        if self._is_closed.is_set():
            raise FrontEndError("closed")
