"""The file of a journal: its tables, and which files are journals. Made once, whole, never out of somebody else's.

Tables `run`, `message` and `snapshot` are the recorder's, `score` and `campaign` those of a campaign's store, which has
few messages. Targets and tracks count from 1. docs/reference/store.md says what each column means.
"""

import sqlite3
from pathlib import Path

from services.errors import BadInput, Failure, StoreFailed

SCHEMA_VERSION = 5  # the only one that is read
APPLICATION_ID = 0x636F6772  # "cogr"
MEMORY = ":memory:"

SCORE_COLUMNS = """
    run TEXT NOT NULL, k INTEGER NOT NULL, t INTEGER NOT NULL, target INTEGER NOT NULL, track INTEGER,
    true_bin INTEGER, bin INTEGER, detected INTEGER NOT NULL, snr_db REAL,
    x REAL, vx REAL, y REAL, vy REAL,
    x_hat REAL, vx_hat REAL, y_hat REAL, vy_hat REAL, share REAL NOT NULL,
    signature_power REAL, late INTEGER NOT NULL, stale INTEGER,
    PRIMARY KEY (run, t, target)"""  # services.metrics.scores says what they mean
_TABLES = f"""
CREATE TABLE run (
    run TEXT PRIMARY KEY, scenario TEXT NOT NULL, document TEXT NOT NULL, strategy TEXT NOT NULL, seed INTEGER NOT NULL,
    dwells INTEGER NOT NULL, rate_hz REAL NOT NULL, n_target INTEGER NOT NULL, has_truth INTEGER NOT NULL,
    acknowledged_k INTEGER NOT NULL DEFAULT 0, acknowledged_t INTEGER NOT NULL DEFAULT 0, acquisition_scans INTEGER,
    conflicts INTEGER NOT NULL DEFAULT 0,
    status TEXT NOT NULL DEFAULT 'running', reason TEXT NOT NULL DEFAULT '', digest TEXT, ended_s INTEGER);
CREATE TABLE message (
    run TEXT NOT NULL, k INTEGER NOT NULL, topic TEXT NOT NULL, item INTEGER NOT NULL, payload BLOB NOT NULL,
    PRIMARY KEY (run, k, topic, item)) WITHOUT ROWID;
CREATE TABLE snapshot (
    run TEXT NOT NULL, target INTEGER NOT NULL, k INTEGER NOT NULL, payload BLOB NOT NULL,
    PRIMARY KEY (run, target));
CREATE TABLE dropped (run TEXT PRIMARY KEY);
CREATE TABLE score ({SCORE_COLUMNS}) WITHOUT ROWID;
CREATE TABLE campaign (document TEXT NOT NULL);
"""


class NoStoreYet(BadInput):
    """There is no file, or an empty one: somebody may be about to make it a store."""


def connect(path: str, *, read_only: bool) -> sqlite3.Connection:
    """Open a file and look what it is; nothing is written to it. Raises BadInput, StoreFailed."""
    file = f"{Path(path).resolve().as_uri()}?mode=ro" if read_only else path
    db = None
    try:
        db = sqlite3.connect(file, uri=read_only, isolation_level=None, check_same_thread=False)
        if _version(db, path) == 0 and read_only:
            raise NoStoreYet(f"{path}: an empty file, no store of runs")
    except (sqlite3.Error, Failure) as error:
        if db is not None:
            db.close()
        raise error if isinstance(error, Failure) else refusal(path, error, read_only=read_only) from None
    return db


def make(db: sqlite3.Connection, path: str) -> None:
    """Make a new file a journal, in one transaction, and every commit durable. Raises sqlite3.Error, BadInput."""
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=FULL")
    db.execute("BEGIN IMMEDIATE")
    if _version(db, path) == 0:
        for statement in _TABLES.split(";"):
            db.execute(statement)
    # Stamped in any case: a file that can only be read says so now, and not when there are results to keep.
    db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    db.execute(f"PRAGMA application_id={APPLICATION_ID}")
    db.execute("COMMIT")


def _version(db: sqlite3.Connection, path: str) -> int:
    """Version of a journal; 0 if the file is empty. Raises BadInput if it is anything that cannot be read."""
    (n_table,), (version,), (application,) = (
        db.execute(query).fetchone()
        for query in ("SELECT COUNT(*) FROM sqlite_master", "PRAGMA user_version", "PRAGMA application_id")
    )
    if n_table == version == application == 0:
        return 0
    if application != APPLICATION_ID:
        raise BadInput(f"{path}: a database of something else, no store of runs")
    if version != SCHEMA_VERSION:
        raise BadInput(f"{path}: store of version {version}, this program reads version {SCHEMA_VERSION}")
    return int(version)


def refusal(path: str, error: sqlite3.Error, *, read_only: bool) -> Failure:
    """Why a file cannot be opened: what the system says of it, where SQLite says no more than that it cannot."""
    if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
        return StoreFailed(f"{path}: {error}")
    try:
        Path(path).open("rb" if read_only else "ab").close()
    except OSError as of_system:
        kind = NoStoreYet if isinstance(of_system, FileNotFoundError) else BadInput
        return kind(f"{path}: {of_system.strerror}")
    return BadInput(f"{path}: {error}")
