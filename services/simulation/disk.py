"""The recorder's disk: SQLite's own files, of which a crash keeps what was synced, and which fills up or is slow.

The journal is the real one, with its write-ahead log, on files of its own. When the recorder dies, its successor finds
a copy of them as the disk would have them: of a commit that was under way, any part of the log may be there. SQLite's
recovery has to make of it what it can.
"""

import hashlib
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.sqlite import SqliteConnection, failure

_MEMORY = Path("/dev/shm")  # noqa: S108 - no file of a fixed name; a sync costs nothing there
NO_LIMIT = 2**30  # pages


class PowerCut(Exception):
    """The machine lost its power; the process is gone."""


class Disk:
    """One machine's disk, through all lives of its recorder."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.is_full = False
        self.cuts_power = False  # in the next commit
        self.commit_s = 0.0  # how long a commit takes
        self._folder = tempfile.TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None)
        self._rng = rng
        self._life = 0
        self._log_before = 0  # bytes of the log that were there before the last commit
        self._journal: SimulatedJournal | None = None
        # Of recorders that were frozen, and have a successor on the same file.
        self._left: dict[str, SimulatedJournal] = {}
        self.opened = self.leads = 0  # how often
        self.after_commit: Callable[[], None] = lambda: None
        self._backup: Path | None = None
        self.writes_left = 0  # until one is an I/O error; 0: none is
        self._synced = b"", 0  # at the last sync: digest of the file, bytes of the log
        self._is_away = False
        self.refused = ""  # why the journal cannot be opened any more

    def open(self, wait: Callable[[float], None]) -> Journal:
        """The journal of a recorder that is started; `wait` lets its time pass."""
        self.put_back()
        self.opened += 1
        self._journal = SimulatedJournal(self, wait)
        self.limit()
        return self._journal

    @property
    def is_open(self) -> bool:
        """Whether there is a recorder."""
        return self._journal is not None

    @property
    def journal(self) -> Journal:
        """The journal of the present recorder."""
        if self._journal is None:
            raise ValueError("there is no recorder")
        return self._journal

    @property
    def path(self) -> Path:
        """File of the journal in this life."""
        return Path(self._folder.name) / f"{self._life}.db"

    def leave(self, key: str) -> None:
        """The recorder is frozen for so long that its lock is taken from it: another one may open the file."""
        if self._journal is not None:
            self._journal.lose_lock()
            self._left[key] = self._journal
            self._journal = None

    def discard_left(self, key: str) -> None:
        """One that was frozen is gone."""
        if (journal := self._left.pop(key, None)) is not None:
            journal.discard()

    def limit(self) -> None:
        """Let the disk be full, or not."""
        if self._journal is not None:
            (row,) = self._journal.read("PRAGMA page_count")
            self._journal.read(f"PRAGMA max_page_count = {row['page_count'] if self.is_full else NO_LIMIT}")

    def crash(self, *, torn: bool) -> None:
        """The recorder is gone. `torn`: in the middle of a commit, of which the log has some part."""
        if self._journal is None:
            return
        self.put_back()
        before, old = self.path, self._journal
        self._journal = None
        if self._left and not torn:  # one that was frozen has the same file open
            old.discard()
            return
        self._life += 1
        _copy(before, self.path)
        if torn and self._rng.random() < 0.7:  # else all of it is there, and no process was told
            log = _log(self.path)
            size = log.stat().st_size
            with log.open("r+b") as file:
                file.truncate(int(self._rng.integers(min(self._log_before, size), size + 1)))
        old.discard()
        before.unlink()

    def back_up(self) -> None:
        """Keep the journal as it is now."""
        self._backup = Path(self._folder.name) / "backup.db"
        _copy(self._where, self._backup)

    def restore(self) -> None:
        """Put the journal in place that was kept, while no recorder is there; one that is frozen has the other file."""
        if self._backup is not None:
            self._life += 1
            _copy(self._backup, self.path)

    def lose_syncs(self) -> None:
        """From now on nothing is synced."""
        log = _log(self._where)
        self._synced = _content(self._where), log.stat().st_size if log.exists() else 0

    def cut_back(self) -> None:
        """The power was cut: of what the log got since then, any beginning is there; no recorder is.

        It is as it was where the log went into the file, which is synced for itself, or was begun anew.
        """
        log, (before, n_byte) = _log(self.path), self._synced
        if log.exists() and _content(self.path) == before and log.stat().st_size > n_byte:
            with log.open("r+b") as file:
                file.truncate(int(self._rng.integers(n_byte, log.stat().st_size + 1)))

    def rot(self) -> None:
        """One bit of the journal is another one, while no recorder is there."""
        with closing(sqlite3.connect(self.path)) as db:  # what is in the log has SQLite's own checksums
            db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        content = bytearray(self.path.read_bytes())
        if content:
            content[int(self._rng.integers(len(content)))] ^= 1 << int(self._rng.integers(8))
        self.path.write_bytes(content)

    def take_away(self) -> None:
        """Move the files elsewhere."""
        if self._journal is not None and not self._is_away:
            self._move(self.path, self._away)
            self._is_away = True

    def put_back(self) -> None:
        """Move them back, as they are by now."""
        if self._is_away:
            self._move(self._away, self.path)
            self._is_away = False

    @property
    def _where(self) -> Path:
        return self._away if self._is_away else self.path

    @property
    def _away(self) -> Path:
        return Path(self._folder.name) / "away.db"

    def _move(self, source: Path, target: Path) -> None:
        for end in ("", "-wal", "-shm"):
            if (file := source.with_name(source.name + end)).exists():
                file.rename(target.with_name(target.name + end))

    def count_write(self) -> bool:
        """Whether the write that is about to happen is an I/O error."""
        if self.writes_left == 0:
            return False
        self.writes_left -= 1
        return self.writes_left == 0

    def is_done(self) -> bool:
        """Whether a commit that is an I/O error is there nevertheless."""
        return bool(self._rng.random() < 0.5)

    def begin_commit(self) -> None:
        """A commit is about to write to the log."""
        log = _log(self.path)
        self._log_before = log.stat().st_size if log.exists() else 0

    def close(self) -> None:
        """Remove all files."""
        for key in list(self._left):
            self.discard_left(key)
        if self._journal is not None:
            self._journal.discard()
        self._folder.cleanup()


class SimulatedJournal(Journal):
    """The journal on such a disk."""

    def __init__(self, disk: Disk, wait: Callable[[float], None]) -> None:
        self._disk, self._wait = disk, wait
        super().__init__(str(disk.path))
        self.read("PRAGMA busy_timeout = 0")  # no other process goes on while one waits

    def commit(self) -> None:
        """Make durable what was written, unless the power is cut."""
        if not self.has_uncommitted:
            return
        self._disk.begin_commit()
        super().commit()
        if self._disk.cuts_power:
            raise PowerCut
        self._disk.after_commit()
        self._wait(self._disk.commit_s)

    def _execute(self, statement: str, parameters: Sequence[Any] = ()) -> int:
        if self._disk.count_write():
            if statement == "COMMIT" and self._disk.is_done():
                super()._execute(statement, parameters)
            raise failure(self.path, sqlite3.OperationalError("disk I/O error"))
        return super()._execute(statement, parameters)

    def lose_lock(self) -> None:
        """Let another process take the lock, without a word."""
        if isinstance(self._connection, SqliteConnection):
            self._connection.lose_lock()

    def _now_us(self) -> int:
        self._disk.leads += 1  # no clock tells two recorders one moment
        return self._disk.leads

    def discard(self) -> None:
        """Close it as it is."""
        self._disk.cuts_power, self._disk.writes_left, self._wait = False, 0, lambda _: None
        self.rollback()
        self.close()


def _content(path: Path) -> bytes:
    """Digest of a file."""
    return hashlib.blake2b(path.read_bytes()).digest() if path.exists() else b""


def _log(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _copy(source: Path, target: Path) -> None:
    shutil.copyfile(source, target)
    if _log(source).exists():
        shutil.copyfile(_log(source), _log(target))
    else:
        _log(target).unlink(missing_ok=True)
