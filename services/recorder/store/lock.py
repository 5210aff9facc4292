"""One writer per journal: a lock with an owner, on a file beside it."""

import errno
import json
import os
import socket
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import lock_descriptor, unlock_descriptor

from cogradar.services.errors import BadInput, InUse

_NO_PLACE = {errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG}  # for the file either


class JournalLock:
    """The right to write to a journal, until it is released or the process dies, however it dies."""

    def __init__(self, path: str, owner: str) -> None:
        """Take it. Raises InUse with the owner's name if another process has it, BadInput if no lock can be made."""
        self._path = f"{Path(path).resolve()}.lock"
        try:
            self._file = self._take(path)
            self.sign(path, owner)
        except OSError as error:
            why = error.strerror if error.errno in _NO_PLACE else f"no lock on it: {error.strerror}"
            if error.errno == errno.ENOENT and not (folder := Path(self._path).parent).exists():
                why = f"there is no folder {folder}: make it first"
            raise BadInput(f"{path}: {why}") from None

    def sign(self, path: str, owner: str) -> None:
        """Write the owner and the file's identity into the lock; again, once a new file is there."""
        with suppress(OSError):  # the disk is full: others read that another process has it
            os.truncate(self._file, 0)
            os.lseek(self._file, 0, os.SEEK_SET)
            # On Windows only its holder can read the first byte of a file that is locked.
            os.write(self._file, b" " + json.dumps(_signature(path, owner)).encode())

    def release(self) -> None:
        """Let others write."""
        if _is_at(self._file, self._path) and _is_held(self._file):  # else another process has made or taken it
            with suppress(PermissionError):  # Windows removes no open file: it stays there, and means nothing
                Path(self._path).unlink(missing_ok=True)
        os.close(self._file)

    def lose(self) -> None:
        """Let others take it, as a file system over the network does with the lock of a machine that is cut off."""
        unlock_descriptor(self._file)

    def _take(self, path: str) -> int:
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
            if not lock_descriptor(file, blocking=False):
                holder = _holder(file)
                os.close(file)
                raise InUse(f"{path}: in use by {holder}")
            if _is_at(file, self._path):
                return file
            os.close(file)  # its owner released it, and with it the name, between the two calls


def inode_in_use(path: str) -> int | None:
    """Inode of the file that the writer of a journal has open; None: unknown."""
    try:
        with Path(f"{Path(path).resolve()}.lock").open("rb") as file:
            inode = json.loads(_signed(file.fileno()))["inode"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return inode if isinstance(inode, int) else None


def is_written(path: str) -> bool:
    """Whether a process has the lock of a journal. One that was killed leaves the lock's file behind, not the lock."""
    try:
        with Path(f"{Path(path).resolve()}.lock").open("rb") as file:
            return not lock_descriptor(file.fileno(), blocking=False)
    except OSError as error:
        return not isinstance(error, FileNotFoundError)


def _signature(path: str, owner: str) -> dict[str, object]:
    since = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    inode = Path(path).stat().st_ino if Path(path).exists() else None
    return {"name": owner, "pid": os.getpid(), "host": socket.gethostname(), "since": since, "inode": inode}


def _signed(file: int) -> bytes:
    os.lseek(file, 1, os.SEEK_SET)
    return os.read(file, 1000)


def _holder(file: int) -> str:
    try:
        return "{name} (process {pid} on {host}, since {since})".format(**json.loads(_signed(file)))
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"  # that has just taken it


def _is_held(file: int) -> bool:
    """Whether a lock that was taken is still ours: some file systems take it back from a machine that is cut off."""
    try:
        return lock_descriptor(file, blocking=False)
    except OSError:
        return False


def _is_at(file: int, path: str) -> bool:
    try:
        return os.path.samestat(os.fstat(file), Path(path).stat())
    except FileNotFoundError:
        return False
