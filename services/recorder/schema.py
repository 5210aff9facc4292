"""The file of a store: its tables, and which files are stores. Made once, whole, never out of somebody else's."""

import sqlite3
from pathlib import Path

from services.errors import BadInput, Failure, StoreFailed

SCHEMA_VERSION = 3  # 2 had no snapshots: read as it is, and brought up to date in place by who writes
APPLICATION_ID = 0x636F6772  # "cogr"; stores made before it was written have 0

_SNAPSHOT = """
CREATE TABLE snapshot (
    run TEXT NOT NULL, target INTEGER NOT NULL, k INTEGER NOT NULL, payload BLOB NOT NULL,
    PRIMARY KEY (run, target))
"""
_TABLES = f"""
CREATE TABLE run (
    run TEXT PRIMARY KEY, scenario TEXT NOT NULL, document TEXT NOT NULL, strategy TEXT NOT NULL, seed INTEGER NOT NULL,
    dwells INTEGER NOT NULL, rate_hz REAL NOT NULL, n_target INTEGER NOT NULL, acquisition_scans INTEGER,
    conflicts INTEGER NOT NULL DEFAULT 0,
    status TEXT NOT NULL DEFAULT 'running', reason TEXT NOT NULL DEFAULT '', last_k INTEGER, digest TEXT);
CREATE TABLE message (
    run TEXT NOT NULL, k INTEGER NOT NULL, topic TEXT NOT NULL, item INTEGER NOT NULL, payload BLOB NOT NULL,
    PRIMARY KEY (run, k, topic, item)) WITHOUT ROWID;
CREATE TABLE score (
    run TEXT NOT NULL, k INTEGER NOT NULL, t INTEGER NOT NULL, target INTEGER NOT NULL, track INTEGER NOT NULL,
    true_bin INTEGER NOT NULL, bin INTEGER NOT NULL, detected INTEGER NOT NULL, snr_db REAL NOT NULL,
    x REAL NOT NULL, vx REAL NOT NULL, y REAL NOT NULL, vy REAL NOT NULL,
    x_hat REAL NOT NULL, vx_hat REAL NOT NULL, y_hat REAL NOT NULL, vy_hat REAL NOT NULL, share REAL NOT NULL,
    late INTEGER NOT NULL, stale INTEGER NOT NULL,
    PRIMARY KEY (run, t, target)) WITHOUT ROWID;
CREATE TABLE campaign (document TEXT NOT NULL);
{_SNAPSHOT}
"""
_BEFORE = {"run", "message", "score", "campaign"}
_NAMES = {2: _BEFORE, 3: _BEFORE | {"snapshot"}}  # of the tables, in each version that can be read


def connect(path: str, *, read_only: bool) -> sqlite3.Connection:
    """Open a store; a writer makes a new or empty file one.

    Raises BadInput for a file that is none or cannot be opened, which is left as it was; StoreFailed if it is locked.
    """
    file = f"{Path(path).resolve().as_uri()}?mode=ro" if read_only else path
    try:
        db = sqlite3.connect(file, uri=read_only, isolation_level=None)
    except sqlite3.Error as error:
        raise _refusal(path, error, "rb" if read_only else "ab") from None
    try:
        if not read_only:
            _make(db, path)
        elif _version(db, path) == 0:
            raise BadInput(f"{path}: an empty file, no store of runs")
    except Failure:
        db.close()
        raise
    except sqlite3.Error as error:
        db.close()
        raise _refusal(path, error, "rb" if read_only else "ab") from None
    return db


def _version(db: sqlite3.Connection, path: str) -> int:
    """Version of a store; 0 if the file is empty. Raises BadInput if it is anything that cannot be read."""
    names = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE name NOT LIKE 'sqlite_%'")}
    (version,), (application,) = (
        db.execute(f"PRAGMA {name}").fetchone() for name in ("user_version", "application_id")
    )
    if not names and version == application == 0:
        return 0
    if application not in {0, APPLICATION_ID} or names not in _NAMES.values():
        raise BadInput(f"{path}: a database of something else, no store of runs")
    if names != _NAMES.get(version):
        raise BadInput(
            f"{path}: store of version {version}, this program reads versions {min(_NAMES)} to {SCHEMA_VERSION}"
        )
    return int(version)


def _make(db: sqlite3.Connection, path: str) -> None:
    """Make a new file a store, or an old store one of today, in one transaction; look before anything is written."""
    _version(db, path)
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=NORMAL")
    db.execute("BEGIN IMMEDIATE")
    there = _version(db, path)  # another process may have been first
    if there != SCHEMA_VERSION:
        for statement in (_SNAPSHOT if there else _TABLES).split(";"):
            db.execute(statement)
    # Stamped in any case: a file that can only be read says so now, and not when there are results to keep.
    db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    db.execute(f"PRAGMA application_id={APPLICATION_ID}")
    db.execute("COMMIT")


def _refusal(path: str, error: sqlite3.Error, mode: str) -> Failure:
    """Why a file cannot be opened: what the system says of it, where SQLite says no more than that it cannot."""
    if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
        return StoreFailed(f"{path}: {error}")
    try:
        Path(path).open(mode).close()
    except OSError as of_system:
        return BadInput(f"{path}: {of_system.strerror}")
    return BadInput(f"{path}: {error}")
