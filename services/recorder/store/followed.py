"""What has become of the files of a store: of one that this process writes, or follows while another one writes it."""

import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path

from cogradar.services.recorder.store.address import is_server
from cogradar.services.recorder.store.lock import inode_in_use, is_written
from cogradar.services.recorder.store.tables import MEMORY

ROOM_BYTES = 1 << 20  # free on a disk that was full, before it is written to again


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


def is_special(path: str) -> bool:
    """Whether a pipe, a socket or a device is there: SQLite would wait for it, or never end."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return False  # SQLite says why it cannot be opened
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def has_room(path: str) -> bool:
    """Whether the disk of a file has some room left, as far as the system says: it knows no quota."""
    return path == MEMORY or shutil.disk_usage(Path(path).parent).free >= ROOM_BYTES


Place = dict[str, os.stat_result]  # files of a journal as they were when it was opened


def place_of(path: str) -> Place:
    """The files that a writer of a journal has open: its own, the log with its index, the lock."""
    found = Place()
    for file in () if path == MEMORY else (path, f"{path}-wal", f"{path}-shm", f"{Path(path).resolve()}.lock"):
        with suppress(OSError):
            found[file] = Path(file).stat()
    return found


def displaced(path: str, place: Place) -> str:
    """What has become of the files of a journal that is open to be written; "": nothing."""
    for file, before in place.items():
        try:
            now = Path(file).stat()
        except OSError as error:
            is_gone = isinstance(error, FileNotFoundError)
            return f"{file} was removed" if is_gone else f"{file}: {error.strerror}"
        if not os.path.samestat(before, now):
            return f"{file} was replaced"
        if file == path and not (now.st_mode & 0o222 and os.access(path, os.W_OK)):
            return f"{file} was made read-only"
    return ""
