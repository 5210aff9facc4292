"""How work can end short of its aim: one family of exceptions, each with the exit code of the command line.

Below everything else in services. The text of a failure is for the user: what happened, and what would do.
"""

import threading
from typing import ClassVar

BY_USER = "by user"  # reason of a run that was stopped,
INTERRUPTED = "interrupted"  # ... and of one that failed because its processes are gone


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


def check_stop(stop: threading.Event | None, hint: str = "") -> None:
    """Raise Interrupted if `stop` is set; `hint` says what the user can do next."""
    if stop is not None and stop.is_set():
        raise Interrupted(f"interrupted{hint}")
