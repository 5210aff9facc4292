"""A store while it is open, in a file or on a server: statements, their transaction, which recorder may commit it."""

import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from cogradar.services.errors import BadInput, Deposed, MissingLibrary, NoRoom, StoreFailed
from cogradar.services.recorder.store.address import Address, is_server
from cogradar.services.recorder.store.seal import CHECKSUM, LISTED, QUARANTINED, sealed, verify
from cogradar.services.recorder.store.sqlite import SqliteConnection
from cogradar.services.recorder.store.unreadable import Intact
from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.scenario.faults import printable
from cogradar.shared.wire.meter import Durations

KEPT_LEADERS = 100  # whose epochs and names the store keeps


class Connection(Protocol):
    """What a kind of store does in its own way. Statements have `?` for each parameter, and mean the same in all.

    All can raise NoRoom while the store cannot be written, else StoreFailed.
    """

    @property
    def name(self) -> str:
        """What people are told that it is: a file, or an address without a password."""

    begin: str  # a transaction, which no recorder that takes the lead can overlook
    begin_to_lead: str  # ... which is the only one
    hold_still: str  # a transaction of a reader, which sees one state of the store from then on
    stamp: str  # a statement that writes and changes nothing
    has_temporary: bool  # tables of this process beside the store's

    @property
    def in_transaction(self) -> bool:
        """Whether something was written that is not committed."""

    def execute(self, statement: str, parameters: Sequence[Any]) -> int:
        """Execute a statement; the number of rows that it changed."""

    def execute_many(self, statement: str, rows: Sequence[Sequence[Any] | dict[str, Any]]) -> None:
        """Execute a statement for each of these rows."""

    def rows(self, query: str, parameters: Sequence[Any]) -> list[Any]:
        """Rows of a SELECT, which can be indexed."""

    def read(self, query: str, parameters: Sequence[Any]) -> list[dict[str, Any]]:
        """Rows of a SELECT."""

    def part(self) -> AbstractContextManager[None]:
        """Damage that is met within undoes this part of a transaction only, on a server; elsewhere its writer has no
        room. In a file such a transaction can only be undone as a whole: what is written after it raises the same.
        """

    def check_place(self) -> None:
        """Raises NoRoom if the store is no longer where it was."""

    def check_room(self) -> None:
        """Raises NoRoom if it is known to have no room."""

    def expire_after(self, seconds: float) -> None:
        """Let another process write if this one is silent for so long, where its death may not be seen."""

    def intact(self, table: str) -> Intact:
        """What can be read of a table, where no transaction goes on."""

    def made_anew(self, table: str, intact: Intact) -> str:
        """Put these rows of a table in its place; what the old one is called from now on."""

    def faults(self) -> list[str]:
        """What is wrong with how the store is laid out, as far as it can tell."""

    def n_byte(self) -> int:
        """Bytes of the store."""

    def close(self) -> None:
        """Let others write."""


def _connect(name: str, owner: str, *, read_only: bool) -> Connection:
    if not name:
        raise BadInput("the store has no name: name a file, such as build/runs.db")
    if not is_server(name):
        return SqliteConnection(name, owner, read_only=read_only)
    try:
        from cogradar.services.recorder.store.postgresql import PostgresqlConnection
    except ImportError:
        shown = Address.of(name).shown
        raise MissingLibrary(
            f"{shown}: needs psycopg, which talks to servers: pip install 'cogradar[postgres]'"
        ) from None
    return PostgresqlConnection(name, owner, read_only=read_only)


class _Leader(NamedTuple):
    epoch: int
    name: str


class Database:
    """One store: a file, ":memory:", or a schema of a PostgreSQL server."""

    def __init__(self, path: str, *, owner: str = "cogradar", read_only: bool = False) -> None:
        """A writer takes the store's lock in the name of `owner`, and makes what is new or empty a store.

        Raises BadInput, with all left as it was, if it is something else or another process writes it.
        """
        self._owner = owner
        self.commits = Durations()
        self._newest_row: tuple[Any, ...] = ()  # of the leaders, as it was verified: it is read with each transaction
        self.epoch = 0  # of the recorder that leads the runs of this store; 0: this process leads none
        self._is_closed = False
        self._connection = _connect(path, owner, read_only=read_only)
        self.path = self._connection.name

    def close(self) -> None:
        """Commit and close. Once is enough."""
        if self._is_closed:
            return
        try:
            self.commit()
        finally:
            self._is_closed = True
            self._connection.close()

    # Leading.

    def lead(self) -> None:
        """Take the lead of all runs, in the transaction that `commit` ends: a recorder that led before commits nothing
        any more. Raises Deposed if one that began later leads already.

        The epoch is above all in the store, and above its own before: what was written since may be lost. It is a
        moment besides, so that an older copy, which does not know the last ones, hands out a higher one, too.
        """
        self._begin(self._connection.begin_to_lead)
        self.epoch = max(self._newest().epoch + 1, self.epoch + 1, self._now_us())
        row = sealed("leader", {"epoch": self.epoch, "name": self._owner})
        self._execute("INSERT INTO leader VALUES (?, ?, ?) ON CONFLICT DO NOTHING", tuple(row.values()))
        last = "SELECT epoch FROM leader ORDER BY epoch DESC LIMIT ?"
        self._execute(f"DELETE FROM leader WHERE epoch NOT IN ({last})", (KEPT_LEADERS,))

    def check_leads(self) -> None:
        """Raises Deposed, with the transaction undone, if a recorder that began later leads the runs of this store."""
        if self.epoch and (newest := self._newest()).epoch > self.epoch:
            self.rollback()
            raise deposed(self.epoch, newest.epoch, f"{printable(str(newest.name))[:100]} has {self.path}")

    def _newest(self) -> _Leader:
        for epoch, name, known in self.rows(f"SELECT {LISTED['leader']} FROM leader ORDER BY epoch DESC LIMIT 1"):
            if (epoch, name, known) != self._newest_row:
                verify(self.path, "leader", {"epoch": epoch, "name": name, CHECKSUM: known})
                self._newest_row = epoch, name, known
            if not epoch < MAX_EPOCH:
                raise BadInput(f"{self.path}: leader.epoch = {epoch}: must be below {MAX_EPOCH}")
            return _Leader(epoch, name)
        return _Leader(0, "")

    def _now_us(self) -> int:
        return time.time_ns() // 1000

    # Writing: statements gather in one transaction until `commit`.

    @property
    def has_uncommitted(self) -> bool:
        """Whether something was written that a power cut would undo."""
        return self._connection.in_transaction

    def commit(self) -> None:
        """Make durable what was written."""
        if self._connection.in_transaction:
            self.check_place()
            with self.commits.timed():
                self._execute("COMMIT")

    def rollback(self) -> None:
        """Undo what was written since the last commit."""
        if self._connection.in_transaction:
            self._execute("ROLLBACK")

    def copy_to(self, path: str) -> None:
        """Write all of a file, or of what is in memory, into a new file. Raises BadInput if it cannot be written."""
        self.commit()
        try:
            Path(path).touch(exist_ok=False)
            self._execute("VACUUM INTO ?", [path])
        except (OSError, StoreFailed) as error:
            why = getattr(error, "strerror", None) or str(error).removeprefix(f"{self.path}: ")
            raise BadInput(f"{path}: {why}") from None

    def check_place(self) -> None:
        """Raises NoRoom if the store is no longer where it was, or cannot be written."""
        self._connection.check_place()

    def check_room(self) -> None:
        """Raises NoRoom unless it can be written to."""
        try:
            self._connection.check_room()
        except NoRoom:
            self.check_leads()  # it may be another one that has it
            raise
        self.write(self._connection.stamp)
        self.commit()

    def expire_after(self, seconds: float) -> None:
        """Let another process write if this one is silent for so long, where its death may not be seen."""
        self._connection.expire_after(seconds)

    def made_anew(self, table: str) -> tuple[str, str]:
        """Put the rows of a table that can be read in its place. This begins a transaction, which takes the lead again.

        Returns the name that the old table has from now on, and how much of it cannot be read. Raises Damaged, NoRoom,
        Deposed.
        """
        self.rollback()
        intact = self._connection.intact(table)
        self.lead()
        return self._connection.made_anew(table, intact), intact.lost

    def faults(self) -> list[str]:
        """What is wrong with how the store is laid out, as far as the kind of store can tell."""
        return self._connection.faults()

    def n_byte(self) -> int:
        """Bytes of the store; 0 in memory."""
        return self._connection.n_byte()

    def write(self, statement: str, *parameters: Any) -> int:
        """Execute a statement in the transaction that `commit` ends; the number of rows that it changed."""
        self._begin()
        return self._execute(statement, parameters)

    @contextmanager
    def part(self) -> Iterator[None]:
        """Damage that is met within ends this part of the transaction only. Nothing may be committed in it."""
        self._begin()
        with self._connection.part():
            yield

    def write_many(self, statement: str, rows: Sequence[Sequence[Any]]) -> None:
        """The same for each of these rows."""
        self._begin()
        self._connection.execute_many(statement, rows)

    def _begin(self, statement: str | None = None) -> None:
        """Begin a transaction, unless one goes on. Raises Deposed.

        No other recorder takes the lead from here on before it is committed.
        """
        if not self._connection.in_transaction:
            self.check_leads()  # for the one that leads has the file most of the time
            self._execute(statement or self._connection.begin)
            self.check_leads()

    # Reading: what is committed, and what this process has written.

    def hold_still(self) -> None:
        """Read what is committed now, from here on, whatever is written meanwhile."""
        self._execute(self._connection.hold_still)

    def read(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT, as dictionaries."""
        return self._connection.read(query, parameters)

    def rows(self, query: str, parameters: Sequence[Any] = ()) -> list[Any]:
        """The same as they come, to be indexed: many numbers are read in half the time."""
        return self._connection.rows(query, parameters)

    def stored(self, table: str, which: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Whole rows of a table, without the documents of runs, each as it was written. Raises Damaged."""
        rows = self.read(f"SELECT {LISTED[table]} FROM {table} {which}", parameters)
        for row in rows:
            if row.get("status") != QUARANTINED:  # a run that is set aside says so, whatever else its row says
                verify(self.path, table, row)
        return rows

    # Temporary tables belong to this connection only, whatever may be written to the store.

    @property
    def has_temporary(self) -> bool:
        """Whether there are such."""
        return self._connection.has_temporary

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
        is_ours = not self._connection.in_transaction  # else the rows wait for somebody else's commit, but can be read
        if is_ours:
            self._execute("BEGIN")
        try:
            self._connection.execute_many(statement, rows)
        except StoreFailed:
            if is_ours:  # or what was read would stay pinned
                self._execute("ROLLBACK")
            raise
        if is_ours:
            self.commit()

    def _execute(self, statement: str, parameters: Sequence[Any] = ()) -> int:
        return self._connection.execute(statement, parameters)


def deposed(own: int, newest: int, who: str) -> Deposed:
    """What a recorder says when it has met one that began later."""
    return Deposed(
        f"{who} with epoch {newest}, this recorder has epoch {own}: it was frozen or cut off while the other one took"
        " over, and ends"
    )
