"""A front end in another process, asked aside: in lockstep, where nothing is late, the emulator need not wait for it.

Its calls are made in a thread of its own. Meanwhile other runs go on, and the run can be cancelled. Runs that share a
front end take turns at it: a process that knows one run at a time would else be opened for another before its answer.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Condition, Event

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, OpenFrontEnd, ScanData, Transmission
from cogradar.shared.protocol.messages import EmulatorCheckpoint

AT_ONCE_S = 0.1  # so long all wait for a dwell: a front end that is well answers within it
TURN_S = 2.0  # after which the next one takes the turn of a run: its front end is silent
LOOK_S = 0.1  # from a look whether a turn is still waited for to the next
_NOBODY = object()

Check = Callable[[], None]  # raises to give up what is waited for


class StillWaiting(Exception):
    """There is no answer yet: the same call, later, asks for it again."""


class CannotOpen(FrontEndError):
    """It could not be opened; the text says why."""


class OpensAside:
    """Opens front ends that are asked aside in lockstep."""

    def __init__(self, make: Callable[[Check], OpenFrontEnd], check: Check) -> None:
        """`make` gives what opens a front end and gives up where `check` raises."""
        self._make, self._check, self._turns = make, check, _Turns()

    def __call__(self, checkpoint: EmulatorCheckpoint) -> FrontEnd:
        """Open it with its first dwell; in real time at once. Raises FrontEndError."""
        if pacing_at(checkpoint.rate_hz).has_deadlines:
            return self._make(self._check)(checkpoint)
        return Aside(self._make, self._check, self._turns, checkpoint)


class _Turns:
    """Whose turn it is at a front end."""

    def __init__(self) -> None:
        self._changed, self._whose, self._since_s = Condition(), _NOBODY, 0.0

    @contextmanager
    def mine(self, check: Check) -> Iterator[None]:
        """A turn, if need be taken from a run that is too slow."""
        me = object()
        with self._changed:
            while self._whose is not _NOBODY and time.monotonic() - self._since_s <= TURN_S:
                self._changed.wait(LOOK_S)
                check()
            self._whose, self._since_s = me, time.monotonic()
        try:
            yield
        finally:
            with self._changed:
                if self._whose is me:
                    self._whose = _NOBODY
                    self._changed.notify()


class Aside:
    """One run's front end, which is opened with the first dwell."""

    def __init__(
        self, make: Callable[[Check], OpenFrontEnd], check: Check, turns: _Turns, checkpoint: EmulatorCheckpoint
    ) -> None:
        self._outer, self._turns, self._checkpoint, self._is_closed = check, turns, checkpoint, Event()
        self._opens = make(self._check)
        self._open: FrontEnd | None = None
        self._thread = ThreadPoolExecutor(1, f"front end of {checkpoint.run}")
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
        """Give up what is waited for. Its thread switches it off, if it is open, and ends."""
        self._is_closed.set()
        self._thread.submit(self._close)
        self._thread.shutdown(wait=False)

    def _transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        with self._turns.mine(self._check):
            self._check()
            if self._open is None:
                try:
                    self._open = self._opens(self._checkpoint)
                except FrontEndError as error:
                    raise CannotOpen(str(error)) from error
            return self._open.transmit(k, t, waveform)

    def _close(self) -> None:
        if self._open is not None:
            self._open.close()

    def _check(self) -> None:
        self._outer()
        if self._is_closed.is_set():
            raise FrontEndError("closed")
