"""How work can end short of its aim: one family of exceptions, each with the exit code of the command line.

Below everything else in services. The text of a failure is for the user: what happened, and what would do.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar

INTERRUPTED = "interrupted"  # reason of a run that failed because its processes are gone


class Failure(Exception):
    """The work did not reach its aim; the text says why."""

    exit_code: ClassVar[int] = 1


class BadInput(Failure, ValueError):
    """What was asked for makes no sense, or a file given is not what it should be; nothing was changed."""

    exit_code = 2


class NoSuchRun(BadInput):
    """No run is as it was asked for; another store may have one."""


class InUse(BadInput):
    """Another process has the store, and its text names it."""


class NoStoreYet(BadInput):
    """There is no file, an empty one, or a server that does not answer: somebody may be about to make it a store."""


class MissingLibrary(BadInput, ModuleNotFoundError):
    """A library that is an extra of ours is not installed; the text says what installs it."""


class RunFailed(Failure):
    """A run, or what was to be done with one, did not reach its end."""


class StoreFailed(Failure):
    """A store failed while it was in use; the text names the file."""


class Busy(StoreFailed):
    """Another program reads or writes the file of a store, so that it cannot be begun with now."""


class NoRoom(StoreFailed):
    """A store could not be written, as its disk is full; what was not committed is undone."""


class Displaced(NoRoom):
    """The file of a store was removed, replaced or made read-only while it was in use.

    What is written then is lost with the last process that has the file open. What was not committed is undone.
    """


class Unreachable(NoRoom):
    """The server of a store does not answer, or has ended the session; what was not committed is undone."""


class Damaged(StoreFailed):
    """Bytes of a store are not as they were written; the text names what is damaged, and what to do."""

    exit_code = 2

    def __init__(self, text: str, run: str = "") -> None:
        super().__init__(text)
        self.run = run  # whose bytes they are; "": unknown, or the whole store


class DamagedIndex(Damaged):
    """Of an index of a store; no row is lost, and the text says what makes it anew."""


class Deposed(Failure):
    """Another process took over the role of this one, which was frozen or cut off; this one has ended itself."""

    exit_code = 4


class Unheard(Failure):
    """The router hears this process no more, though the link is up; it ends, and is to be started again."""

    exit_code = 5


class NoMetrics(Failure):
    """No service answers questions; the text says where it was asked."""

    exit_code = 3


class Interrupted(Failure):
    """The user or the system asked for a stop; the exit code is that of SIGINT, of another signal 128 + its number."""

    exit_code = 130


class SignalEvent(threading.Event):
    """May be set by a signal's handler, which runs in the main thread, also where that waits for it with its lock."""

    def __init__(self) -> None:
        super().__init__()
        self._cond = threading.Condition(threading.RLock())


@contextmanager
def with_interrupts_after() -> Iterator[threading.Event]:
    """Let a Ctrl-C wait until this is over: within compiled code it would end the interpreter, or be lost.

    A second one does not wait, nor does any where a program handles the signal itself. The event is set meanwhile.
    """
    stop = SignalEvent()
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stop
        return
    came = list[int]()

    def note(number: int, _frame: object) -> None:
        came.append(number)
        if len(came) > 1:
            raise KeyboardInterrupt
        stop.set()

    signal.signal(signal.SIGINT, note)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


def check_stop(stop: threading.Event | None, hint: str = "") -> None:
    """Raise Interrupted if `stop` is set; `hint` says what the user can do next."""
    if stop is not None and stop.is_set():
        raise Interrupted(f"interrupted{hint}")
