"""The file of a store: its tables, and which files are stores. Made once, whole, never out of somebody else's."""

import sqlite3
from pathlib import Path

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


class StoreError(RuntimeError):
    """The store cannot be opened or written; the text names the file."""


class NotAStore(StoreError):
    """The file holds something else, or the store of another version; it was left as it is."""


def connect(path: str, *, read_only: bool) -> sqlite3.Connection:
    """Open a store; a writer makes a new or empty file one. Raises StoreError."""
    file = f"{Path(path).resolve().as_uri()}?mode=ro" if read_only else path
    try:
        db = sqlite3.connect(file, uri=read_only, isolation_level=None)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: {error}") from None
    try:
        if not read_only:
            _make(db, path)
        elif _version(db, path) == 0:
            raise NotAStore(f"{path}: an empty file, no store of runs")
    except StoreError:
        db.close()
        raise
    except sqlite3.Error as error:
        db.close()
        kind = NotAStore if getattr(error, "sqlite_errorname", "") == "SQLITE_NOTADB" else StoreError
        raise kind(f"{path}: {error}") from None
    return db


def _version(db: sqlite3.Connection, path: str) -> int:
    """Version of a store; 0 if the file is empty. Raises NotAStore if it is anything that cannot be read."""
    names = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE name NOT LIKE 'sqlite_%'")}
    (version,), (application,) = (
        db.execute(f"PRAGMA {name}").fetchone() for name in ("user_version", "application_id")
    )
    if not names and version == application == 0:
        return 0
    if application not in {0, APPLICATION_ID} or names not in _NAMES.values():
        raise NotAStore(f"{path}: a database of something else, no store of runs")
    if names != _NAMES.get(version):
        raise NotAStore(
            f"{path}: store of version {version}, this program reads versions {min(_NAMES)} to {SCHEMA_VERSION}"
        )
    return int(version)


def _make(db: sqlite3.Connection, path: str) -> None:
    """Make a new file a store, or an old store one of today, in one transaction; look before anything is written."""
    there = _version(db, path)
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=NORMAL")
    if there == SCHEMA_VERSION:
        return
    db.execute("BEGIN IMMEDIATE")
    there = _version(db, path)  # another process may have been first
    if there != SCHEMA_VERSION:
        for statement in (_SNAPSHOT if there else _TABLES).split(";"):
            db.execute(statement)
        db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
        db.execute(f"PRAGMA application_id={APPLICATION_ID}")
    db.execute("COMMIT")
