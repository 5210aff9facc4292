"""A store in an SQLite file, and which files are stores. Made once, whole, never out of another program's.

A file may come from anywhere. SQLite runs what a schema holds (triggers, views, expressions) inside our own statements,
so a file whose schema is not word for word ours is refused before it is asked anything.
"""

import sqlite3
import sys
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from difflib import get_close_matches
from functools import cache, partial
from pathlib import Path
from typing import Any

from cogradar.services.errors import BadInput, Busy, Damaged, Displaced, Failure, InUse, NoRoom, NoStoreYet, StoreFailed
from cogradar.services.recorder.store.followed import Place, displaced, has_room, is_special, place_of
from cogradar.services.recorder.store.lock import JournalLock
from cogradar.services.recorder.store.seal import beyond_cure, damage, run_asked
from cogradar.services.recorder.store.tables import MEMORY, SCHEMA_VERSION, statements
from cogradar.services.recorder.store.unreadable import KEPT, Intact, intact_rows, made_anew
from cogradar.shared.scenario.faults import printable

APPLICATION_ID = 0x636F6772  # "cogr"
STAMP = f"PRAGMA user_version={SCHEMA_VERSION}"  # writes to the file even if it says so already
LOG_BYTES = 16 << 20  # of the log (-wal), once no long question needs more: SQLite keeps it as long as it ever was
MAX_VALUE = 64 << 20  # bytes of one value of a file; a message has at most 4 MiB
STEPS_BETWEEN = 1_000_000  # of SQLite's machine, some 10 ms, between two looks at how many a question took
STEPS, STEPS_PER_BYTE = 200_000_000, 20  # that a question may take: some seconds, and longer for a long file
_ACTING = "trigger view index table"  # what a schema holds, in the order in which it is named
_NO_TEXT = "Could not decode to UTF-8"  # how an error of Python's begins, and not of SQLite's
# No error of the disk: after one SQLite has undone the whole transaction, and a writer must begin again.
_DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")
_NO_ROOM = {"SQLITE_FULL", "SQLITE_IOERR_WRITE", "SQLITE_IOERR_SHMSIZE"}  # a disk, a quota, and the index of the log


class SqliteConnection:
    """One SQLite file, or what is in memory: `Connection` of `database`."""

    begin = begin_to_lead = "BEGIN IMMEDIATE"  # from here on no other process can write
    hold_still = "BEGIN"
    stamp = STAMP
    has_temporary = True

    def __init__(self, path: str, owner: str, *, read_only: bool) -> None:
        """A writer takes the file's lock in the name of `owner`, and makes a new or empty file a journal.

        What is in memory is closed with the last reference to it, a file by `close` only.

        Raises BadInput, with the file left as it was, if it is something else or another process writes it.
        """
        self.name, self._read_only = path, read_only
        if path != MEMORY and is_special(path):
            raise BadInput(f"{path}: not a regular file, must be a store of runs or the name of a new one")
        # First of all: SQLite makes a file that is not there, in the place of one that its writer misses.
        try:
            self._lock = None if read_only or path == MEMORY else JournalLock(path, owner)
        except InUse:
            with suppress(NoStoreYet):  # it may be about to be made
                connect(path, read_only=True).close()  # what is no store is said now, not when the lock is free
            raise
        is_new = self._lock is not None and not Path(path).exists()
        try:
            self.db = connect(path, read_only=read_only)
        except BaseException:
            if self._lock is not None:
                self._lock.release()
            raise
        if path == MEMORY:
            weakref.finalize(self, self.db.close)
        self._limit = Limit(self.db, path)
        self._place = Place()
        self._spoiled: Damaged | None = None  # what the transaction has met
        self._has_old_log = False  # of a former writer
        try:
            if self._lock is not None and is_new:
                self._lock.sign(path, owner)
            if not read_only:
                make(self.db, path)
                self._renew_log()
        except (Failure, sqlite3.Error) as error:
            if self.db.in_transaction:
                self.db.execute("ROLLBACK")
            self.close()
            raise error if isinstance(error, Failure) else refusal(path, error, read_only=read_only) from None
        self.db.row_factory = sqlite3.Row
        self._place = {} if read_only else place_of(path)

    def _renew_log(self) -> None:
        """Put the log of a former writer into the file, and begin it anew. Raises StoreFailed.

        If a sync of that writer has failed, the system may hold what no disk has, and calls it written from then on.
        Behind such a gap in the log nothing would outlive a power cut. The file is written and synced for itself.
        """
        try:
            ((is_busy, *_),) = self._write(lambda: self.db.execute("PRAGMA wal_checkpoint(TRUNCATE)"))
        except NoRoom:
            is_busy = True
        self._has_old_log = bool(is_busy)

    def close(self) -> None:
        """Close it: the write-ahead log goes into the file, which is then whole by itself."""
        if self._lock is not None and not displaced(self.name, self._place):  # whose files they are is unknown
            settle(self.db)
        self.db.close()
        if self._lock is not None:
            self._lock.release()

    def lose_lock(self) -> None:
        """Let another process take the lock, without a word."""
        if self._lock is not None:
            self._lock.lose()

    def expire_after(self, _seconds: float) -> None:
        """The lock goes with the process, and needs no time."""

    @property
    def in_transaction(self) -> bool:
        """Whether something was written that is not committed."""
        return self.db.in_transaction

    def check_place(self) -> None:
        """Raises Displaced if its files are no longer where they were, or cannot be written."""
        if fault := displaced(self.name, self._place):
            raise Displaced(f"{fault} while it was in use: put it back as it was, or restart on the file that is there")

    def check_room(self) -> None:
        """Raises NoRoom, as far as the system knows it."""
        self.check_place()
        if not has_room(self.name):
            raise NoRoom(f"{self.name}: the disk is full")
        if self._has_old_log:
            self._renew_log()

    def intact(self, table: str) -> Intact:
        """What can be read of a table, where no transaction goes on."""
        return intact_rows(self, table)

    def made_anew(self, table: str, intact: Intact) -> str:
        """Put the rows of a table that can be read in its place; what the old one is called from now on."""
        (create,) = (text for text in statements() if text.startswith(f"CREATE TABLE {table} "))
        return made_anew(self, table, create, "rowid = {0}", intact)

    def faults(self) -> list[str]:
        """What SQLite finds wrong with its pages."""
        lines = [line for (text,) in self.rows("PRAGMA quick_check(10)", ()) for line in text.splitlines()]
        return [line for line in lines if line != "ok" and not line.startswith("***")]

    def n_byte(self) -> int:
        """Bytes of the file with its log."""
        return _size(self.name)

    def execute(self, statement: str, parameters: Sequence[Any]) -> int:
        """Execute a statement; the number of rows that it changed."""
        if statement == "ROLLBACK" or not self.db.in_transaction:  # SQLite may have undone it by itself
            self._spoiled = None
        run = run_asked(statement, parameters)
        return self._write(lambda: self.db.execute(statement, parameters), run).rowcount

    def _write(self, ask: Callable[[], sqlite3.Cursor], run: str = "") -> sqlite3.Cursor:
        """Let SQLite change something. Some faults undo the whole transaction: a reason to begin again. After damage
        SQLite writes nothing more before a rollback, and would say no more than that the file is malformed.
        """
        if self._spoiled is not None:
            raise self._spoiled
        self._limit.begin()
        is_begun = self.db.in_transaction
        try:
            return ask()
        except sqlite3.Error as error:
            found = self._met(failure(self.name, error, run))
            raise NoRoom(str(found)) if is_begun and not self.db.in_transaction else found from None

    def _met(self, found: StoreFailed) -> StoreFailed:
        """What was met; a transaction that has met damage is spoiled by it."""
        if isinstance(found, Damaged) and self.db.in_transaction and not self._read_only:
            self._spoiled = found
        return found

    @contextmanager
    def part(self) -> Iterator[None]:
        """Damage that SQLite meets spoils the whole transaction; a checksum that does not fit spoils nothing."""
        yield

    def execute_many(self, statement: str, rows: Sequence[Sequence[Any] | dict[str, Any]]) -> None:
        """Execute a statement for each of these rows."""
        self._write(lambda: self.db.executemany(statement, rows))

    def rows(self, query: str, parameters: Sequence[Any]) -> list[Any]:
        """Rows of a SELECT, which can be indexed."""
        self._limit.begin()
        try:
            return self.db.execute(query, parameters).fetchall()
        except sqlite3.Error as error:
            if not str(error).startswith(_NO_TEXT):
                raise self._met(failure(self.name, error, run_asked(query, parameters))) from None
        self.db.text_factory = partial(str, encoding="utf-8", errors="replace")  # then its checksum does not fit
        try:
            return self.db.execute(query, parameters).fetchall()
        except sqlite3.Error as error:
            raise self._met(failure(self.name, error, run_asked(query, parameters))) from None
        finally:
            self.db.text_factory = str

    def read(self, query: str, parameters: Sequence[Any]) -> list[dict[str, Any]]:
        """Rows of a SELECT."""
        return [dict(row) for row in self.rows(query, parameters)]


class Limit:
    """How long a question to a file may take, in steps of SQLite's machine: pages that refer to each other can make a
    short file endless. What is in memory is our own, and has no length to compare with.
    """

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._path = path
        self._steps = 0
        if path != MEMORY:
            db.set_progress_handler(self._count, STEPS_BETWEEN)

    def begin(self) -> None:
        """Another question."""
        self._steps = 0

    def _count(self) -> bool:
        """Whether the question is to end."""
        self._steps += STEPS_BETWEEN
        return self._steps > STEPS and self._steps > STEPS + STEPS_PER_BYTE * _size(self._path)


def _size(path: str) -> int:
    """Bytes of a file with its log; 0 if there is none."""
    n_byte = 0
    for file in () if path == MEMORY else (path, f"{path}-wal"):
        with suppress(OSError, ValueError):  # the latter: no path can have such a name
            n_byte += Path(file).stat().st_size
    return n_byte


def connect(path: str, *, read_only: bool) -> sqlite3.Connection:
    """Open a file and look what it is; nothing is written to it. Raises BadInput, StoreFailed."""
    if not read_only and _size(path):  # a writer that closes a file puts its log into it, also if it refuses the file
        connect(path, read_only=True).close()
    file = f"{Path(path).resolve().as_uri()}?mode=ro" if read_only else path
    db = None
    try:
        db = sqlite3.connect(file, uri=read_only, isolation_level=None, check_same_thread=False)
        _distrust(db)
        Limit(db, path)  # the schema is read now, which may be endless, too
        if _version(db, path) == 0 and read_only:
            raise NoStoreYet(f"{path}: an empty file, no store of runs")
    except (sqlite3.Error, UnicodeDecodeError, Failure) as error:  # SQLite quotes what it finds, whatever it is
        if db is not None:
            db.close()
        if getattr(error, "sqlite_errorname", "") == "SQLITE_READONLY_ROLLBACK":
            _roll_back(path)
            return connect(path, read_only=True)
        raise error if isinstance(error, Failure) else refusal(path, error, read_only=read_only) from None
    return db


def _distrust(db: sqlite3.Connection) -> None:
    """Let what a file's schema says do as little as SQLite can be told to.

    Before Python 3.12 there is no defensive mode. It keeps statements from changing a schema by other ways than its
    own; no statement of ours does, and a foreign schema, which could, is refused.
    """
    db.execute("PRAGMA trusted_schema=OFF")
    db.execute("PRAGMA cell_size_check=ON")
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
    if sys.version_info >= (3, 12):
        db.setconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE, True)


def _roll_back(path: str) -> None:
    """Let SQLite undo the transaction that a killed process has left in a rollback journal."""
    try:
        with closing(sqlite3.connect(path)) as db:
            db.execute("PRAGMA user_version")
    except sqlite3.Error as error:
        raise refusal(path, error, read_only=False) from None


def make(db: sqlite3.Connection, path: str) -> None:
    """Make a new file a journal, in one transaction, and every commit durable. Raises sqlite3.Error, BadInput."""
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=FULL")
    db.execute(f"PRAGMA journal_size_limit={LOG_BYTES}")
    db.execute("BEGIN IMMEDIATE")
    is_new = _version(db, path) == 0
    if is_new:
        for statement in statements():
            db.execute(statement)
    # Stamped in any case: a file that can only be read says so now, and not when there are results to keep.
    try:
        db.execute(STAMP)
        db.execute(f"PRAGMA application_id={APPLICATION_ID}")
        db.execute("COMMIT")
    except sqlite3.Error as error:
        if is_new or not _is_for_want_of_room(error):
            raise
        if db.in_transaction:  # what is in it can be read, and its recorder waits for room
            db.execute("ROLLBACK")


def failure(path: str, error: Exception, run: str = "") -> StoreFailed:
    """What SQLite says of a file in use; `run`: the one that was asked about."""
    said, name = str(error), getattr(error, "sqlite_errorname", "")
    if name == "SQLITE_INTERRUPT":
        said = "a question took more steps than so many bytes can need: it is damaged"
    if name == "SQLITE_INTERRUPT" or name.startswith(_DAMAGED):
        return damage(path, f"run {run!r}: {said}" if run else said, run)
    kind = NoRoom if _is_for_want_of_room(error) else Busy if name.startswith("SQLITE_BUSY") else StoreFailed
    return kind(printable(f"{path}: {error}"))


def _is_for_want_of_room(error: Exception) -> bool:
    return getattr(error, "sqlite_errorname", "") in _NO_ROOM


def settle(db: sqlite3.Connection) -> None:
    """Leave one file without a log, unless somebody else has it open now.

    Those who only read a log make files beside it that they cannot remove.
    """
    with suppress(sqlite3.OperationalError):
        db.execute("PRAGMA busy_timeout=0")
        db.execute("PRAGMA journal_mode=DELETE")


def _version(db: sqlite3.Connection, path: str) -> int:
    """Version of a journal; 0 if the file is empty. Raises BadInput if it is anything that cannot be read."""
    (n_table,), (version,), (application,) = (
        db.execute(query).fetchone()
        for query in (
            "SELECT COUNT(*) FROM (SELECT 1 FROM sqlite_master LIMIT 1)",
            "PRAGMA user_version",
            "PRAGMA application_id",
        )
    )
    if n_table == version == application == 0:
        return 0
    if application != APPLICATION_ID:
        raise BadInput(f"{path}: a database of something else, no store of runs")
    if version != SCHEMA_VERSION:
        raise BadInput(f"{path}: store of version {version}, this program reads version {SCHEMA_VERSION}")
    if (found := _foreign(db)) is not None:
        kind, name = found
        text = f"{path}: {kind} {name!r} is not as version {version} makes it; a store has its own tables, unchanged"
        raise BadInput(f"{printable(text)}. Nothing was read; use another copy of the file")
    return int(version)


def _foreign(db: sqlite3.Connection) -> tuple[str, str] | None:
    """Kind and name of what is not as this version makes it, or is missing; what can act comes first. None: nothing."""
    there, own = _schema(db), _own_schema()
    differs = [(str(kind), str(name)) for kind, name, *_ in there ^ own]
    return min(differs, key=lambda found: (_ACTING.find(found[0]), found[1]), default=None)


def _schema(db: sqlite3.Connection) -> frozenset[tuple[str, str, str, str | None]]:
    """What a file has. A table that was made anew stays beside the new one, and must be as it was made."""
    found = set[tuple[str, str, str, str | None]]()
    for kind, name, table, sql in db.execute("SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT 1000"):
        if (kept := KEPT.fullmatch(str(table))) is None:
            found.add((kind, name, table, sql))
        else:
            found.add((kind, name.replace(table, kept[1]), kept[1], sql and sql.replace(f'"{table}"', kept[1], 1)))
    return frozenset(found)


@cache
def _own_schema() -> frozenset[tuple[str, str, str, str | None]]:
    with closing(sqlite3.connect(MEMORY)) as db:
        for statement in statements():
            db.execute(statement)
        return _schema(db)


def refusal(path: str, error: Exception, *, read_only: bool) -> Failure:
    """Why a file cannot be opened: what the system says of it, where SQLite says no more than that it cannot."""
    if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY") or _is_for_want_of_room(error):
        return failure(path, error)
    name = getattr(error, "sqlite_errorname", "")
    if name == "SQLITE_INTERRUPT":
        return BadInput(str(failure(path, error)))
    try:
        Path(path).open("rb" if read_only else "ab").close()
    except OSError as of_system:
        if isinstance(of_system, FileNotFoundError) and read_only:
            files = [str(file) for file in Path(path).parent.glob("*.db")]
            close = get_close_matches(path, files, n=1)
            guess = f"; did you mean {close[0]}?" if close else ""
            return NoStoreYet(f"{path!r}: no such file{guess}")
        return BadInput(f"{path}: {of_system.strerror}")
    is_other = name == "SQLITE_NOTADB"
    if name.startswith(_DAMAGED) and not is_other:
        return BadInput(beyond_cure(path, f"{path}: {error}"))
    said = "no store of runs, but a file of another kind" if is_other else error
    return BadInput(printable(f"{path}: {said}"))  # SQLite quotes what it found in the file
