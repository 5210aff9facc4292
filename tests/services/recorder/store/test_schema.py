"""A store says itself what its tables and columns are."""

import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.errors import Failure
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import MEMORY


def test_every_table_and_column_has_its_comment_in_the_file() -> None:
    journal = Journal(MEMORY)
    tables = {row["name"]: row["sql"] for row in journal.read("SELECT * FROM sqlite_master WHERE type = 'table'")}
    for table, text in tables.items():
        columns = [row["name"] for row in journal.read("SELECT name FROM pragma_table_info(?)", [table])]
        assert re.search(rf"CREATE TABLE {table} \( -- \S", text)
        assert re.findall(r"^ *([a-z]\w*) .* -- \S", text, re.MULTILINE) == columns


def test_a_store_whose_writer_was_killed_in_the_middle_is_read_as_it_was_before(tmp_path: Path) -> None:
    """SQLite's log of what to undo lies beside it, which a reader that may not write cannot apply."""
    path, killed = tmp_path / "runs.db", tmp_path / "killed.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("PRAGMA cache_size=1")
        db.execute("BEGIN")
        db.execute("INSERT INTO dropped VALUES (?)", ["x" * 1_000_000])
        for end in ("", "-journal"):
            shutil.copyfile(f"{path}{end}", f"{killed}{end}")
    journal = Journal(str(killed), read_only=True)
    assert journal.read("SELECT run FROM dropped") == []
    journal.close()


def test_what_is_wrong_with_a_damaged_file_can_be_printed(tmp_path: Path) -> None:
    """SQLite quotes the damaged place, whatever stands there."""
    path = tmp_path / "runs.db"
    Journal(str(path)).close()
    content = path.read_bytes()
    at = content.index(b"CREATE TABLE score")
    path.write_bytes(content[: at + 13] + b"\x15" + content[at + 14 :])
    with pytest.raises(Failure, match=r"malformed database schema.*\?") as told:
        Journal(str(path), read_only=True)
    assert str(told.value).isprintable()
