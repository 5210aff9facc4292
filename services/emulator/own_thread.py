"""Somebody else's front end in real time: it runs in a thread of its own, which is left behind when a call hangs.

Nothing can stop a call in Python. The emulator goes on without it, and opens another front end; the one that hangs is
closed in its own thread if its call ever returns. In lockstep nothing is late: there its calls are made directly.
"""

import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, ScanData, Settings, Transmission, told
from cogradar.shared.protocol.messages import EmulatorCheckpoint

FIRST_S = 30.0  # for calls up to the first dwell after opening, which may have to load much
CLOSE_S = 10.0  # at least, to switch it off: at the end of the process it would stay on
MOST_LEFT = 8  # threads that hang, after which no further front end is opened
Answers = queue.SimpleQueue[tuple[Any, Exception | None]]


class OpensInOwnThread:
    """Opens front ends that may hang."""

    def __init__(self, make: Callable[[Settings], FrontEnd], source: str | None = None) -> None:
        """source : its name with the hash of its source."""
        self._make, self.source = make, source
        self._left: list[threading.Thread] = []

    def __call__(self, checkpoint: EmulatorCheckpoint) -> FrontEnd:
        """Open it. Opening takes what time it needs."""
        settings = Settings.of(checkpoint)
        pacing = pacing_at(settings.rate_hz)
        if not pacing.has_deadlines:
            return self._make(settings)
        # Front ends that are open note their threads in this list.
        self._left[:] = [thread for thread in self._left if thread.is_alive()]
        if len(self._left) >= MOST_LEFT:
            raise FrontEndError(f"{len(self._left)} front ends that were opened before hang: restart the emulator")
        return InOwnThread(self._make, settings, pacing.silence_s, self._left)


class InOwnThread:
    """A front end whose calls have a deadline."""

    def __init__(
        self,
        make: Callable[[Settings], FrontEnd],
        settings: Settings,
        deadline_s: float,
        left: list[threading.Thread],
        first_s: float = FIRST_S,
        *,
        opening_s: float | None = None,
    ) -> None:
        """left : where its thread is noted if a call hangs; opening_s : of opening, None: what time it needs."""
        self._deadline_s, self._left, self._first_s = deadline_s, left, first_s
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Answers] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name=f"front end of {settings.run}", daemon=True)
        self._thread.start()
        try:
            self._front_end: FrontEnd = self._call("opening", lambda: make(settings), opening_s)
        except BaseException:
            self._jobs.put(None)
            raise
        for name in ("truth", "prepare"):  # which a front end may have
            if (method := getattr(self._front_end, name, None)) is not None:
                vars(self)[name] = partial(self._within, name, method)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        """Transmit dwell k and measure. Raises FrontEndError if it takes too long."""
        scan: ScanData | None = self._within("transmit", self._front_end.transmit, k, t, waveform)
        self._first_s = 0.0
        return scan

    def _within(self, name: str, method: Callable[..., Any], *given: Any) -> Any:
        """What a method of it returns. Until it has transmitted, it may have to load much."""
        return self._call(name, lambda: method(*given), max(self._deadline_s, self._first_s))

    def close(self) -> None:
        """Switch it off; one that hangs as soon as it does so no longer."""
        is_left = self._thread in self._left
        try:
            self._call("close", self._front_end.close, 0.0 if is_left else max(self._deadline_s, CLOSE_S))
        except FrontEndError:
            if not is_left:
                raise
        finally:
            self._jobs.put(None)

    def _call(self, name: str, do: Callable[[], Any], deadline_s: float | None) -> Any:
        answers: Answers = queue.SimpleQueue()
        self._jobs.put((do, answers))
        try:
            value, error = answers.get(timeout=deadline_s)
        except queue.Empty:
            self._leave()
            raise FrontEndError(f"{name} did not return within {deadline_s:g} s") from None
        except BaseException:  # an interrupt: it is not waited for
            self._leave()
            raise
        if error is not None:
            raise error
        return value

    def _leave(self) -> None:
        if self._thread not in self._left:
            self._left.append(self._thread)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            do, answers = job
            try:
                answers.put((do(), None))
            except Exception as error:  # noqa: BLE001 - somebody else's front end may raise anything
                answers.put((None, error))
            except BaseException as error:  # noqa: BLE001 - SystemExit: the radar waits for an answer all the same
                answers.put((None, FrontEndError(told(error))))
