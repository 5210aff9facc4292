"""A store that somebody else has made or changed runs nothing of theirs, and is left as it is."""

import hashlib
import os
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import sqlite, tables

FOREIGN = {  # how a file is made foreign, and what is said of it
    "trigger": ("CREATE TRIGGER forge AFTER UPDATE ON run BEGIN DELETE FROM message; END", "trigger 'forge'"),
    "view": (
        "DROP TABLE score; CREATE VIEW score AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        " SELECT 'r' AS run, i AS t FROM n",
        "view 'score'",
    ),
    "other view": ("CREATE VIEW mine AS SELECT * FROM run", "view 'mine'"),
    "generated column": (
        "ALTER TABLE run ADD COLUMN more TEXT GENERATED ALWAYS AS (hex(zeroblob(1000000000))) VIRTUAL",
        "table 'run'",
    ),
    "index on an expression": ("CREATE INDEX slow ON run (hex(zeroblob(dwells)))", "index 'slow'"),
    "index": ("CREATE INDEX fast ON run (seed)", "index 'fast'"),
    "virtual table": ("CREATE VIRTUAL TABLE words USING fts5(word)", "table 'words'"),
    "table": ("CREATE TABLE person (name TEXT)", "table 'person'"),
    "missing table": ("DROP TABLE campaign", "table 'campaign'"),
    "default": (
        "PRAGMA writable_schema=ON; UPDATE sqlite_master SET sql = replace(sql, '''running''', '''complete''')",
        "table 'run'",
    ),
    "check": (
        "PRAGMA writable_schema=ON; UPDATE sqlite_master SET sql = replace(sql, 'run TEXT PRIMARY KEY -- its name',"
        " 'run TEXT PRIMARY KEY CHECK (run <> ''a'') -- its name') WHERE name = 'dropped'",
        "table 'dropped'",
    ),
    "statistics": ("ANALYZE", "table 'sqlite_stat1'"),
}
COMMANDS = {
    "query": ["query", "runs", "--store"],
    "report": ["report"],
    "figures": ["figures"],
    "export": ["export", "--out", "other.csv", "--store"],
    "feed": ["feed", "--to", "geojson", "--out", "-", "--store"],
    "replay": ["replay", "--to", "allocator", "--store"],
    "run": ["run", "smoke", "--in-process", "--store"],
    "run over Zenoh": ["run", "smoke", "--store"],
    "recorder": ["service", "recorder", "--store"],
    "metrics": ["service", "metrics", "--http", "127.0.0.1:0", "--store"],
    "campaign": ["campaign", "smoke", "--runs", "1", "--resume", "--store"],
    "sweep": ["sweep", "smoke", "--over", "radar.array.n_tx=16", "--runs", "1", "--resume", "--store"],
}


@pytest.fixture(params=FOREIGN)
def foreign(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """A foreign file, and what is said of it."""
    path = tmp_path / "other.db"
    Journal(str(path)).close()
    statements, said = FOREIGN[request.param]
    with closing(sqlite3.connect(path)) as db:
        db.executescript(statements)
        db.commit()
    return path, said


@pytest.mark.parametrize("is_read_only", [False, True])
@pytest.mark.parametrize("kind", ["pipe", "/dev/full"])
def test_what_is_no_regular_file_is_not_opened(kind: str, is_read_only: bool, tmp_path: Path) -> None:
    """Whoever opens a pipe waits for one who writes into it."""
    path = kind if kind.startswith("/") else str(tmp_path / "pipe.db")
    if not kind.startswith("/"):
        os.mkfifo(path)
    with pytest.raises(BadInput, match="not a regular file, must be a store of runs or the name of a new one"):
        Journal(path, read_only=is_read_only)
    assert not Path(f"{path}.lock").exists()


@pytest.mark.parametrize("is_read_only", [True, False])
def test_a_foreign_file_is_refused_and_left_as_it_is(foreign: tuple[Path, str], is_read_only: bool) -> None:
    path, said = foreign
    before = path.read_bytes()
    with pytest.raises(BadInput, match=rf"other\.db: .*{said}"):
        Journal(str(path), read_only=is_read_only)
    assert path.read_bytes() == before


@pytest.mark.parametrize("is_read_only", [True, False])
def test_the_log_of_a_foreign_file_is_not_put_into_it(tmp_path: Path, is_read_only: bool) -> None:
    path, copy = tmp_path / "live.db", tmp_path / "other.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA journal_mode=WAL")
        db.executescript(FOREIGN["trigger"][0])
        for end in ("", "-wal"):
            shutil.copyfile(f"{path}{end}", f"{copy}{end}")
    before = copy.read_bytes()
    with pytest.raises(BadInput, match="trigger 'forge'"):
        Journal(str(copy), read_only=is_read_only)
    assert copy.read_bytes() == before


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_opens_one(command: str, tmp_path: Path) -> None:
    path = tmp_path / "other.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path)) as db:
        db.executescript(FOREIGN["trigger"][0])
    before = path.read_bytes()
    found = CliRunner().invoke(app, [*COMMANDS[command], str(path)], catch_exceptions=True)
    assert "trigger 'forge'" in found.output + str(found.exception or ""), found.output
    assert found.exit_code == 2 or isinstance(found.exception, BadInput), found.output
    assert path.read_bytes() == before


def test_neither_does_metrics(tmp_path: Path) -> None:
    path = tmp_path / "other.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path)) as db:
        db.executescript(FOREIGN["view"][0])
    with pytest.raises(BadInput, match="view 'score'"):
        MetricsCore(str(path))


@pytest.mark.parametrize("is_read_only", [True, False])
def test_no_question_is_endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_read_only: bool) -> None:
    """Rows are numbered without end here; in a file, pages that refer to each other can do the same."""
    monkeypatch.setattr(sqlite, "STEPS", 2_000_000)
    path = str(tmp_path / "run.db")
    Journal(path).close()
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT {} FROM n"
    with closing(Journal(path, read_only=is_read_only)) as journal:
        with pytest.raises(StoreFailed, match=r"run\.db: .*more steps"):
            journal.read(endless.format("max(i)"))
        for _ in range(50):  # each question has all its steps
            journal.read(endless.format("i") + " LIMIT 20000")


def _page(children: list[int], start: int = 0) -> bytes:
    """An inner page of a table: these pages are below it."""
    cells = [child.to_bytes(4) + bytes([0x81, i % 128]) for i, child in enumerate(children[:-1])]
    at = [4096 - 6 * (i + 1) for i in range(len(cells))]
    head = bytes([5, 0, 0, *len(cells).to_bytes(2), *min(at).to_bytes(2), 0, *children[-1].to_bytes(4)])
    head += b"".join(place.to_bytes(2) for place in at)
    return bytes(start) + head + bytes(4096 - start - len(head) - 6 * len(cells)) + b"".join(reversed(cells))


def _make_schema_endless(path: Path) -> None:
    """Let the pages of a file's schema refer to each other: 200^5 times the same row of it."""
    data = bytearray(path.read_bytes())
    n_page = len(data) // 4096
    size = 100 + (12 if data[100] == 5 else 8) + 2 * int.from_bytes(data[103:105])
    own = bytes(data[100:size]) + bytes(100) + bytes(data[size:4096])  # what was in the first page, moved to its start
    with closing(sqlite3.connect(path)) as db:
        name, table, root = db.execute(
            "SELECT name, tbl_name, rootpage FROM sqlite_master WHERE type = 'index'"
        ).fetchone()
    text = f"index{name}{table}".encode()
    record = bytes([6, 23, 13 + 2 * len(name), 13 + 2 * len(table), 1, 0]) + text + bytes([root])
    cell = bytes([len(record), 100]) + record
    leaf = bytes([13, 0, 0, 0, 1, *(4096 - len(cell)).to_bytes(2), 0, *(4096 - len(cell)).to_bytes(2)])
    leaf += bytes(4096 - len(leaf) - len(cell)) + cell
    inner = [_page(200 * [n_page + 2 + i]) for i in range(5)]
    data[100:4096] = _page([n_page + 1, n_page + 7], start=100)[100:]
    data[28:32] = (n_page + 7).to_bytes(4)
    data[92:96] = data[24:28]
    path.write_bytes(bytes(data) + own + leaf + b"".join(inner))


@pytest.mark.parametrize("is_read_only", [True, False])
def test_the_schema_of_a_file_is_not_endless(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_read_only: bool
) -> None:
    monkeypatch.setattr(sqlite, "STEPS", 2_000_000)
    path = tmp_path / "run.db"
    Journal(str(path)).close()
    _make_schema_endless(path)
    with pytest.raises(BadInput, match=r"run\.db: .*more steps"):
        Journal(str(path), read_only=is_read_only)


def test_what_is_in_memory_may_take_as_long_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite, "STEPS", 2_000_000)
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 400000) SELECT max(i) AS i FROM n"
    with closing(Journal(tables.MEMORY)) as journal:
        assert journal.read(numbers) == [{"i": 400_000}]


def test_schema_is_not_trusted(tmp_path: Path) -> None:
    path = str(tmp_path / "run.db")
    Journal(path).close()
    with closing(Journal(path, read_only=True)) as journal:
        assert journal.read("PRAGMA trusted_schema") == [{"trusted_schema": 0}]
        if sys.version_info >= (3, 12):
            assert isinstance(journal._connection, sqlite.SqliteConnection)
            assert journal._connection.db.getconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE)


def test_a_new_schema_is_a_new_version() -> None:
    """A file's tables are compared word for word, comments too: whoever changes a word raises the version."""
    assert (tables.SCHEMA_VERSION, hashlib.sha256(tables.TABLES.encode()).hexdigest()[:16]) == (22, "7b88ca6a31eae574")
