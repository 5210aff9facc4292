"""The file of a journal while it is open: statements, their transaction, and which recorder may commit it."""

import sqlite3
import time
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cogradar.services.errors import BadInput, Deposed, Displaced, Failure, NoRoom
from cogradar.services.recorder.file.lock import JournalLock
from cogradar.services.recorder.file.schema import (
    MEMORY,
    STAMP,
    Limit,
    Place,
    connect,
    displaced,
    failure,
    has_room,
    make,
    place_of,
    refusal,
    settle,
)
from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.scenario.faults import printable
from cogradar.shared.wire.meter import Durations

KEPT_LEADERS = 100  # of which the file has the epoch and the name


class _Leader(NamedTuple):
    epoch: int
    name: str


class Database:
    """One SQLite file (or ":memory:")."""

    def __init__(self, path: str, *, owner: str = "cogradar", read_only: bool = False) -> None:
        """A writer takes the file's lock in the name of `owner`, and makes a new or empty file a journal.

        What is in memory is closed with the last reference to it, a file by `close` only.

        Raises BadInput, with the file left as it was, if it is something else or another process writes it.
        """
        self.path, self._owner = path, owner
        self.commits = Durations()
        self.epoch = 0  # of the recorder that leads the runs of this file; 0: this process leads none
        self._place = Place()
        self._db = connect(path, read_only=read_only)
        self._is_closed = False
        if path == MEMORY:
            weakref.finalize(self, self._db.close)
        self._limit = Limit(self._db, path)
        self._lock: JournalLock | None = None
        try:
            if not read_only and path != MEMORY:
                self._lock = JournalLock(path, owner)
            if not read_only:
                make(self._db, path)
        except (Failure, sqlite3.Error) as error:
            self.rollback()
            self.close()
            raise error if isinstance(error, Failure) else refusal(path, error, read_only=read_only) from None
        self._db.row_factory = sqlite3.Row
        self._place = {} if read_only else place_of(path)

    def close(self) -> None:
        """Commit and close: the write-ahead log goes into the file, which is then whole by itself. Once is enough."""
        if self._is_closed:
            return
        try:
            self.commit()
        finally:
            self._is_closed = True
            if self._lock is not None and not displaced(self.path, self._place):  # whose files they are is unknown
                settle(self._db)
            self._db.close()
            if self._lock is not None:
                self._lock.release()

    # Leading.

    def lead(self) -> None:
        """Take the lead of all runs, in the transaction that `commit` ends: a recorder that led before commits nothing
        any more. Raises Deposed if one that began later leads already.

        The epoch is above all in the file. It is a moment besides, so that an older copy of the file, which does not
        know the last ones, hands out a higher one, too.
        """
        self._begin()
        self.epoch = self.epoch or max(self._newest().epoch + 1, self._now_us())
        self._execute("INSERT OR IGNORE INTO leader VALUES (?, ?)", (self.epoch, self._owner))
        last = "SELECT epoch FROM leader ORDER BY epoch DESC LIMIT ?"
        self._execute(f"DELETE FROM leader WHERE epoch NOT IN ({last})", (KEPT_LEADERS,))

    def check_leads(self) -> None:
        """Raises Deposed, with the transaction undone, if a recorder that began later leads the runs of this file."""
        if self.epoch and (newest := self._newest()).epoch > self.epoch:
            self.rollback()
            raise deposed(self.epoch, newest.epoch, f"{newest.name} has {self.path}")

    def _newest(self) -> _Leader:
        for row in self.rows("SELECT epoch, name FROM leader ORDER BY epoch DESC LIMIT 1"):
            if not row[0] < MAX_EPOCH:
                raise BadInput(f"{self.path}: leader.epoch = {row[0]}: must be below {MAX_EPOCH}")
            return _Leader(row[0], printable(str(row[1]))[:100])
        return _Leader(0, "")

    def _now_us(self) -> int:
        return time.time_ns() // 1000

    # Writing: statements gather in one transaction until `commit`.

    @property
    def has_uncommitted(self) -> bool:
        """Whether something was written that a power cut would undo."""
        return self._db.in_transaction

    def commit(self) -> None:
        """Make durable what was written."""
        if self._db.in_transaction:
            self.check_place()
            with self.commits.timed():
                self._execute("COMMIT")

    def rollback(self) -> None:
        """Undo what was written since the last commit."""
        if self._db.in_transaction:
            self._execute("ROLLBACK")

    def copy_to(self, path: str) -> None:
        """Write all of it into a new file. Raises BadInput if there is one already, or it cannot be written."""
        self.commit()
        try:
            Path(path).touch(exist_ok=False)
            self._db.execute("VACUUM INTO ?", [path])
        except (OSError, sqlite3.Error) as error:
            raise BadInput(f"{path}: {getattr(error, 'strerror', None) or error}") from None

    def check_place(self) -> None:
        """Raises Displaced if its files are no longer where they were, or cannot be written."""
        if fault := displaced(self.path, self._place):
            raise Displaced(f"{fault} while it was in use: put it back as it was, or restart on the file that is there")

    def check_room(self) -> None:
        """Raises NoRoom unless it can be written to."""
        self.check_place()
        if not has_room(self.path):
            raise NoRoom(f"{self.path}: the disk is full")
        self.write(STAMP)
        self.commit()

    def write(self, statement: str, *parameters: Any) -> int:
        """Execute a statement in the transaction that `commit` ends; the number of rows that it changed."""
        self._begin()
        return self._execute(statement, parameters).rowcount

    def _begin(self) -> None:
        """Begin a transaction, unless one goes on. Raises Deposed.

        It is the only one that writes from here on, so no other recorder takes the lead before it is committed.
        """
        if not self._db.in_transaction:
            self.check_leads()  # for the one that leads has the file most of the time
            self._execute("BEGIN IMMEDIATE")
            self.check_leads()

    # Reading: what is committed, and what this process has written.

    def read(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT, as dictionaries."""
        return [dict(row) for row in self.rows(query, parameters)]

    def rows(self, query: str, parameters: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """The same as they come: many numbers are read in half the time."""
        self._limit.begin()
        try:
            return self._db.execute(query, tuple(parameters)).fetchall()
        except sqlite3.Error as error:
            raise failure(self.path, error) from None

    def each(self, query: str, parameters: Sequence[Any] = ()) -> Iterator[sqlite3.Row]:
        """The same one after the other: all of them may be more than there is memory for."""
        self._limit.begin()
        try:
            yield from self._db.execute(query, tuple(parameters))
        except sqlite3.Error as error:
            raise failure(self.path, error) from None

    # Temporary tables belong to this connection only, whatever may be written to the file.

    def create_temporary(self, definition: str) -> None:
        """Create a temporary table or view."""
        self._execute(f"CREATE TEMP {definition}")

    def add_temporary(self, table: str, rows: Sequence[dict[str, Any]]) -> None:
        """Insert rows of equal columns into a temporary table; one of the same key is replaced."""
        for first in rows[:1]:
            columns, marks = ", ".join(first), ", ".join(f":{name}" for name in first)
            self.write_temporary(f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", rows)

    def write_temporary(self, statement: str, rows: Sequence[Sequence[Any] | dict[str, Any]]) -> None:
        """Execute a statement on a temporary table for each of these rows."""
        is_ours = not self._db.in_transaction  # else the rows wait for somebody else's commit, but can be read
        if is_ours:
            self._execute("BEGIN")
        self._limit.begin()
        try:
            self._db.executemany(statement, rows)
        except sqlite3.Error as error:
            if is_ours:  # or what was read would stay pinned
                self._execute("ROLLBACK")
            raise failure(self.path, error) from None
        if is_ours:
            self.commit()

    def _execute(self, statement: str, parameters: Sequence[Any] = ()) -> sqlite3.Cursor:
        self._limit.begin()
        try:
            return self._db.execute(statement, parameters)
        except sqlite3.Error as error:
            raise failure(self.path, error) from None


def deposed(own: int, newest: int, who: str) -> Deposed:
    """What a recorder says when it has met one that began later."""
    return Deposed(
        f"{who} with epoch {newest}, this recorder has epoch {own}: it was frozen or cut off while the other one took"
        " over, and ends"
    )
