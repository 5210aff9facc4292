"""A store that somebody else has made or changed runs nothing of theirs, and is left as it is."""

import hashlib
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
from cogradar.services.recorder import schema
from cogradar.services.recorder.journal import Journal

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
    monkeypatch.setattr(schema, "STEPS", 2_000_000)
    path = str(tmp_path / "run.db")
    Journal(path).close()
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT {} FROM n"
    with closing(Journal(path, read_only=is_read_only)) as journal:
        with pytest.raises(StoreFailed, match=r"run\.db: .*more steps"):
            journal.read(endless.format("max(i)"))
        for _ in range(50):  # each question has all its steps
            journal.read(endless.format("i") + " LIMIT 20000")


def test_schema_is_not_trusted(tmp_path: Path) -> None:
    path = str(tmp_path / "run.db")
    Journal(path).close()
    with closing(Journal(path, read_only=True)) as journal:
        assert journal.read("PRAGMA trusted_schema") == [{"trusted_schema": 0}]
        if sys.version_info >= (3, 12):
            assert journal._db.getconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE)


def test_a_new_schema_is_a_new_version() -> None:
    """A file's tables are compared word for word, comments too: whoever changes a word raises the version."""
    assert (schema.SCHEMA_VERSION, hashlib.sha256(schema._TABLES.encode()).hexdigest()[:16]) == (17, "77699d4e739b1add")
