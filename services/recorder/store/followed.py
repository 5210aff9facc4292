"""A store that another process writes: which one is there by now, and what keeps that process from writing it."""

from pathlib import Path

from cogradar.services.recorder.store.address import is_server
from cogradar.services.recorder.store.lock import inode_in_use, is_written


class Followed:
    """A store of this name."""

    def __init__(self, name: str) -> None:
        self._name, self._is_server, self._was_there = name, is_server(name), False

    def identity(self) -> object | None:
        """Changes when another one is put in its place; None: there is none yet. What a server has, it has itself."""
        if self._is_server:
            return self._name
        try:
            status = Path(self._name).stat()
        except OSError:  # or what was a folder is none, or a file system does not answer
            return None
        return status.st_dev, status.st_ino

    def is_lost(self) -> bool:
        """Whether it was there, or its writer has signed for it, and it is not there now."""
        is_there = self.identity() is not None
        self._was_there = self._was_there or is_there
        return not is_there and (self._was_there or inode_in_use(self._name) is not None)

    def trouble(self) -> str:
        """What keeps it from being written, as far as it is seen from here; "": nothing."""
        if self._is_server:
            return ""
        try:
            status = Path(self._name).stat()
        except OSError as error:
            fault = "was removed" if isinstance(error, FileNotFoundError) else f"{error.strerror}"
            return f"{self._name} {fault}"
        fault = ""
        if inode_in_use(self._name) not in {None, status.st_ino}:
            fault = "was replaced, its recorder has another file open"
        elif not status.st_mode & 0o222:
            fault = "was made read-only"
        return f"{self._name} {fault}" if fault and is_written(self._name) else ""  # else it is a copy, or what is kept
