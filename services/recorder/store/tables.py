"""The tables of a store, and which version of them this program reads.

Tables `run`, `message`, `snapshot`, `command`, `dropped` and `leader` are the recorder's, `score`, `picture` and
`campaign` a campaign's, whose store has few messages. Targets and tracks count from 1.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from cogradar.shared.scoring.columns import PICTURE, SCORE, definition

# The only one that is read; one more whenever what a payload holds, or when tracks begin, has changed.
SCHEMA_VERSION = 22
MAX_COMMANDS = 10_000  # of a run; the order book says what may be the last ones
MEMORY = ":memory:"
KINDS = {"TEXT": "text", "INTEGER": "bigint", "REAL": "double precision", "BLOB": "bytea"}  # of SQLite, and here
ALL_ROWS = 2**62  # as a LIMIT

# In the words of SQLite, from which other stores have theirs. Comments stay in a file's own description of itself
# (`.schema` of sqlite3), and make the page of the reference. In brackets the unit. None may hold a semicolon. Files are
# compared with these words: to change one is a new version.
SCORE_KEY, PICTURE_KEY = "run, t, target", "run, t"
TABLES = f"""
CREATE TABLE run ( -- one row per run
    run TEXT PRIMARY KEY, -- name, opaque
    place INTEGER NOT NULL UNIQUE, -- among the runs of the store, in the order in which they began
    scenario TEXT NOT NULL, -- name of the scenario
    document TEXT NOT NULL, -- [JSON] the whole scenario, every key with its value
    strategy TEXT NOT NULL, -- how the power is spread
    seed INTEGER NOT NULL, -- of the world. The radar's is a one-way function of it
    dwells INTEGER NOT NULL, -- [dwells] that were asked for, after the acquisition, 2147483647: no end
    dt_s REAL NOT NULL, -- [s] between dwells, by the run's own clock
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
    ended_s INTEGER, -- [s] when it ended, since 1970 in UTC
    messages INTEGER NOT NULL DEFAULT 0, -- [messages] of dwells k below acknowledged_k in the file
    commands INTEGER NOT NULL DEFAULT 0, -- [commands] to it in the file
    leads TEXT NOT NULL DEFAULT '[]', -- [JSON] last epochs, and acknowledged_k plus n of the last command as each began
    scores_checksum INTEGER, -- CRC-32 of its rows of score and picture, null if none are kept
    document_checksum INTEGER NOT NULL, -- CRC-32 of its document
    checksum INTEGER NOT NULL -- CRC-32 of all of the row but its document
    );
CREATE TABLE message ( -- every message of a run, as it was sent, a campaign's store has the waveforms of few dwells
    run TEXT NOT NULL, -- its run
    k INTEGER NOT NULL, -- its dwell
    topic TEXT NOT NULL, -- scan, truth, plan or waveform
    item INTEGER NOT NULL, -- of a plan its track, of others 0
    payload BLOB NOT NULL, -- [MessagePack] as on the wire, where tracks count from 0
    checksum INTEGER NOT NULL, -- CRC-32 of the row
    PRIMARY KEY (run, k, topic, item)) WITHOUT ROWID;
CREATE TABLE snapshot ( -- what a track was, of runs that go on
    run TEXT NOT NULL, -- its run
    target INTEGER NOT NULL, -- its track
    k INTEGER NOT NULL, -- after this dwell
    payload BLOB NOT NULL, -- [MessagePack] the newest one, gone when the run has ended
    checksum INTEGER NOT NULL, -- CRC-32 of the row
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
    checksum INTEGER NOT NULL, -- CRC-32 of the row
    PRIMARY KEY (run, n), UNIQUE (run, id)) WITHOUT ROWID;
CREATE TABLE dropped ( -- ended runs whose messages are being deleted
    run TEXT PRIMARY KEY -- its name
    );
CREATE TABLE leader ( -- the recorders that led the runs of this file, one after the other
    epoch INTEGER PRIMARY KEY, -- [us] when it began, since 1970 in UTC, or later, the highest one leads
    name TEXT NOT NULL, -- of its process
    checksum INTEGER NOT NULL -- CRC-32 of the row
    );
CREATE TABLE score ( -- how each target fared in each dwell, in a campaign's store. Of other runs it is derived
{definition(SCORE, SCORE_KEY)}) WITHOUT ROWID;
CREATE TABLE picture ( -- all tracks and targets of each dwell together, like score
{definition(PICTURE, PICTURE_KEY)}) WITHOUT ROWID;
CREATE TABLE campaign ( -- what a campaign was asked to be
    document TEXT NOT NULL, -- [JSON] scenarios, strategies, seeds, and a digest of the program
    checksum INTEGER NOT NULL -- CRC-32 of the row
    );
"""


@dataclass(frozen=True)
class Recording:
    """A finished run as rows of a store: its own, its scores, and those messages that are to be kept."""

    run: dict[str, Any]
    scores: list[dict[str, Any]]
    picture: list[dict[str, Any]]
    messages: list[dict[str, Any]]


class Described(NamedTuple):
    """A table of a store, or a column of one."""

    name: str
    kind: str  # of a column: its type in SQL
    unit: str
    meaning: str


def statements() -> list[str]:
    """What makes each table."""
    return [text.strip() for text in TABLES.split(";") if text.strip()]


def described() -> Iterator[tuple[Described, list[Described]]]:
    """Each table with its columns, in order."""
    for text in statements():
        ((name, meaning),) = re.findall(r"CREATE TABLE (\w+) \( -- (.*)", text)
        columns = re.findall(r"^ *([a-z]\w*) (\w+).*?,? -- (?:\[(.*?)\] )?(.*)$", text, re.MULTILINE)
        yield Described(name, "", "", meaning), [Described(*column) for column in columns]


def definitions() -> list[str]:
    """What makes the tables on a server, with their comments."""
    made = ["CREATE TABLE store (version BIGINT NOT NULL)", "COMMENT ON TABLE store IS 'of these tables'"]
    for statement in statements():
        text = re.sub(r"-- .*", "", statement).replace("WITHOUT ROWID", "")
        for kind, own in KINDS.items():
            text = re.sub(rf"\b{kind}\b", 'text COLLATE "C"' if kind == "TEXT" else own, text)
        made.append(text)
    for one, columns in described():
        made.append(f"COMMENT ON TABLE {one.name} IS {_quoted(one.meaning)}")
        for column in columns:
            unit = f"[{column.unit}] " if column.unit else ""
            made.append(f"COMMENT ON COLUMN {one.name}.{column.name} IS {_quoted(unit + column.meaning)}")
    # Numbers in MessagePack hardly shrink.
    return [*made, "ALTER TABLE message ALTER payload SET STORAGE EXTERNAL"]


@lru_cache(maxsize=512)
def numbered(statement: str) -> bytes:
    """A statement with parameters as a server has them; tables of this process, from which `main.` tells others, it
    has none.
    """
    first, *others = statement.replace("main.", "").split("?")
    return "".join([first, *(f"${i}{part}" for i, part in enumerate(others, 1))]).encode()


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
