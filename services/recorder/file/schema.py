"""The file of a journal: its tables, and which files are journals. Made once, whole, never out of another program's.

A file may come from anywhere. SQLite runs what a schema holds (triggers, views, expressions) inside our own statements,
so a file whose schema is not word for word ours is refused before it is asked anything.

Tables `run`, `message`, `snapshot`, `command`, `dropped` and `leader` are the recorder's, `score`, `picture` and
`campaign` a campaign's, whose store has few messages. Targets and tracks count from 1.
"""

import os
import shutil
import sqlite3
import sys
from contextlib import closing, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

from cogradar.services.errors import BadInput, Failure, NoRoom, StoreFailed
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scoring.columns import PICTURE, SCORE, definition

# The only one that is read; one more whenever what a payload holds, or when tracks begin, has changed.
SCHEMA_VERSION = 18
APPLICATION_ID = 0x636F6772  # "cogr"
STAMP = f"PRAGMA user_version={SCHEMA_VERSION}"  # writes to the file even if it says so already
MAX_COMMANDS = 10_000  # of a run; the order book says what may be the last ones
MEMORY = ":memory:"
ROOM_BYTES = 1 << 20  # free on a disk that was full, before it is written to again
MAX_VALUE = 64 << 20  # bytes of one value of a file; a message has at most 4 MiB
STEPS_BETWEEN = 1_000_000  # of SQLite's machine, some 10 ms, between two looks at how many a question took
STEPS, STEPS_PER_BYTE = 200_000_000, 20  # that a question may take: some seconds, and longer for a long file
_ACTING = "trigger view index table"  # what a schema holds, in the order in which it is named
_NO_ROOM = {"SQLITE_FULL", "SQLITE_IOERR_WRITE", "SQLITE_IOERR_SHMSIZE"}  # a disk, a quota, and the index of the log

# Comments stay in a file's own description of itself (`.schema` of sqlite3), and make the page of the reference. In
# brackets the unit. None may hold a semicolon. Files are compared with these words: to change one is a new version.
SCORE_KEY, PICTURE_KEY = "run, t, target", "run, t"
_TABLES = f"""
CREATE TABLE run ( -- one row per run
    run TEXT PRIMARY KEY, -- name, opaque
    scenario TEXT NOT NULL, -- name of the scenario
    document TEXT NOT NULL, -- [JSON] the whole scenario, every key with its value
    strategy TEXT NOT NULL, -- how the power is spread
    seed INTEGER NOT NULL, -- of the world. The radar's is a one-way function of it
    dwells INTEGER NOT NULL, -- [dwells] that were asked for, after the acquisition, 2147483647: no end
    rate_hz REAL NOT NULL, -- [1/s] dwells per second in real time, 0 in lockstep
    n_target INTEGER NOT NULL, -- targets of the world, whenever they are there, without truth n_track or 0
    n_track INTEGER, -- tracks of the radar, null if nobody tells it their number
    has_truth INTEGER NOT NULL, -- [0, 1] the front end was a simulation and told where the targets were
    acknowledged_k INTEGER NOT NULL DEFAULT 0, -- [dwells] all messages of dwells k below this are in the file
    acknowledged_t INTEGER NOT NULL DEFAULT 0, -- [dwells] the clock t of the last of them
    kept_k INTEGER NOT NULL DEFAULT 0, -- [dwells] messages of dwells k below this were cut, of a run without an end
    acquisition_scans INTEGER, -- [scans] up to the last track's confirmation, null before, 0 of an unknown number
    conflicts INTEGER NOT NULL DEFAULT 0, -- [messages] that differed from the first of their kind
    status TEXT NOT NULL DEFAULT 'running', -- running, complete, stopped, failed or quarantined
    reason TEXT NOT NULL DEFAULT '', -- why it ended before its last dwell
    digest TEXT, -- SHA-256 over scans, plans and waveforms, once complete
    began_s INTEGER NOT NULL, -- [s] when its start was recorded, since 1970 in UTC
    ended_s INTEGER -- [s] when it ended, since 1970 in UTC
    );
CREATE TABLE message ( -- every message of a run, as it was sent, a campaign's store has the waveforms of few dwells
    run TEXT NOT NULL, -- its run
    k INTEGER NOT NULL, -- its dwell
    topic TEXT NOT NULL, -- scan, truth, plan or waveform
    item INTEGER NOT NULL, -- of a plan its track, of others 0
    payload BLOB NOT NULL, -- [MessagePack] as on the wire, where tracks count from 0
    PRIMARY KEY (run, k, topic, item)) WITHOUT ROWID;
CREATE TABLE snapshot ( -- what a track was, of runs that go on
    run TEXT NOT NULL, -- its run
    target INTEGER NOT NULL, -- its track
    k INTEGER NOT NULL, -- after this dwell
    payload BLOB NOT NULL, -- [MessagePack] the newest one, gone when the run has ended
    PRIMARY KEY (run, target));
CREATE TABLE command ( -- what somebody asked of a run that went on
    run TEXT NOT NULL, -- its run
    n INTEGER NOT NULL, -- its number in the run, from 1
    id TEXT NOT NULL, -- of the command, unique
    asker TEXT NOT NULL, -- who asked
    asked_s INTEGER NOT NULL, -- [s] when the recorder received it, since 1970 in UTC
    action TEXT NOT NULL, -- [JSON] what was asked for, where tracks count from 0
    k INTEGER, -- the first dwell under it, null if it was refused
    reason TEXT NOT NULL DEFAULT '', -- why it was refused
    over_k INTEGER, -- [dwells] no dwell from this one on is shaped by it, null before
    PRIMARY KEY (run, n), UNIQUE (run, id)) WITHOUT ROWID;
CREATE TABLE dropped ( -- ended runs whose messages are being deleted
    run TEXT PRIMARY KEY -- its name
    );
CREATE TABLE leader ( -- the recorders that led the runs of this file, one after the other
    epoch INTEGER PRIMARY KEY, -- [us] when it began, since 1970 in UTC, or later, the highest one leads
    name TEXT NOT NULL -- of its process
    );
CREATE TABLE score ( -- how each target fared in each dwell, in a campaign's store. Of other runs it is derived
{definition(SCORE, SCORE_KEY)}) WITHOUT ROWID;
CREATE TABLE picture ( -- all tracks and targets of each dwell together, like score
{definition(PICTURE, PICTURE_KEY)}) WITHOUT ROWID;
CREATE TABLE campaign ( -- what a campaign was asked to be
    document TEXT NOT NULL -- [JSON] scenarios, strategies, seeds, and a digest of the program
    );
"""


@dataclass(frozen=True)
class Recording:
    """A finished run as rows of a store: its own, its scores, and those messages that are to be kept."""

    run: dict[str, Any]
    scores: list[dict[str, Any]]
    picture: list[dict[str, Any]]
    messages: list[dict[str, Any]]


class NoStoreYet(BadInput):
    """There is no file, or an empty one: somebody may be about to make it a store."""


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
    db.execute("BEGIN IMMEDIATE")
    is_new = _version(db, path) == 0
    if is_new:
        for statement in _TABLES.split(";"):
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


def failure(path: str, error: Exception) -> StoreFailed:
    """What SQLite says of a file in use."""
    if getattr(error, "sqlite_errorname", "") == "SQLITE_INTERRUPT":
        return StoreFailed(printable(f"{path}: a question took more steps than so many bytes can need: it is damaged"))
    return (NoRoom if _is_for_want_of_room(error) else StoreFailed)(printable(f"{path}: {error}"))


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
    return frozenset(db.execute("SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT 1000"))


@cache
def _own_schema() -> frozenset[tuple[str, str, str, str | None]]:
    with closing(sqlite3.connect(MEMORY)) as db:
        for statement in _TABLES.split(";"):
            db.execute(statement)
        return _schema(db)


def refusal(path: str, error: Exception, *, read_only: bool) -> Failure:
    """Why a file cannot be opened: what the system says of it, where SQLite says no more than that it cannot."""
    if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY") or _is_for_want_of_room(error):
        return failure(path, error)
    if getattr(error, "sqlite_errorname", "") == "SQLITE_INTERRUPT":
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
    return BadInput(printable(f"{path}: {error}"))  # SQLite quotes what it found in the file
