"""The store file: made once, whole, and never out of what belongs to somebody else."""

import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.errors import BadInput, Damaged, NoRoom, StoreFailed
from cogradar.services.recorder import journal as journals
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.store.sqlite import APPLICATION_ID, SqliteConnection
from cogradar.services.recorder.store.tables import SCHEMA_VERSION
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import RunEnd
from tests.services.loop import smoke_start
from tests.services.stored import rows, seal


def _foreign(path: Path, *statements: str) -> bytes:
    db = sqlite3.connect(path)
    for statement in statements:
        db.execute(statement)
    db.commit()
    db.close()
    return path.read_bytes()


FOREIGN = {
    "another table": ["CREATE TABLE person (name TEXT)"],
    "another table, our version": ["CREATE TABLE person (name TEXT)", f"PRAGMA user_version={SCHEMA_VERSION}"],
    "a table of our name": ["CREATE TABLE run (run TEXT)", f"PRAGMA user_version={SCHEMA_VERSION}"],
    "another application": ["PRAGMA application_id=7"],
    "a version without tables": ["PRAGMA user_version=1"],
}


@pytest.mark.parametrize("statements", FOREIGN.values(), ids=FOREIGN.keys())
@pytest.mark.parametrize("read_only", [True, False])
def test_a_database_of_something_else_is_refused_and_left_as_it_is(
    statements: list[str], read_only: bool, tmp_path: Path
) -> None:
    path = tmp_path / "theirs.db"
    before = _foreign(path, *statements)
    with pytest.raises(BadInput, match=r"theirs\.db: a database of something else"):
        Journal(str(path), read_only=read_only)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["theirs.db"]


@pytest.mark.parametrize("read_only", [True, False])
@pytest.mark.parametrize("version", [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1])
def test_a_store_of_another_version_is_refused_and_left_as_it_is(version: int, read_only: bool, tmp_path: Path) -> None:
    path = tmp_path / "old.db"
    Journal(str(path)).close()
    before = _foreign(path, f"PRAGMA user_version={version}")
    with pytest.raises(BadInput, match=rf"old\.db: store of version {version}.* {SCHEMA_VERSION}"):
        Journal(str(path), read_only=read_only)
    assert path.read_bytes() == before


def test_of_a_long_run_few_messages_are_read_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    journal, sizes = Journal(":memory:"), list[int]()
    for k in range(1000):
        journal.add_message("r", k, "scan", 0, b"%d" % k)
    read = journal.rows

    def noted(*asked: Any) -> list[Any]:
        found = read(*asked)
        sizes.append(len(found))
        return found

    monkeypatch.setattr(journal, "rows", noted)
    assert list(journal.messages("r", ["scan"])) == [b"%d" % k for k in range(1000)]
    assert max(sizes) <= 256


@pytest.mark.usefixtures("either_store")
def test_a_snapshot_is_replaced_by_newer_ones_only() -> None:
    store = Journal(":memory:")
    store.add_run(smoke_start())
    for k in (511, 255, 767, 511):
        store.set_snapshot("r", 1, k, b"%d" % k)
    assert store.snapshot("r", 1, 0) == store.snapshot("r", 1, 767) == (767, b"767")
    assert store.snapshot("r", 1, 768) is None
    assert store.snapshot("r", 2, 0) is None


def test_a_new_store_is_stamped_and_survives_reopening(tmp_path: Path) -> None:
    path = str(tmp_path / "new.db")
    for _ in range(2):
        store = Journal(path)
        store.add_run(smoke_start())
        store.close()
    assert rows(path, "PRAGMA application_id") == [{"application_id": APPLICATION_ID}]


def test_an_empty_file_becomes_a_store_for_a_writer_only(tmp_path: Path) -> None:
    path = tmp_path / "empty.db"
    path.touch()
    with pytest.raises(BadInput, match=r"empty\.db: an empty file"):
        Journal(str(path), read_only=True)
    Journal(str(path)).close()
    assert rows(path, "SELECT * FROM run") == []


@pytest.mark.parametrize("read_only", [True, False])
@pytest.mark.parametrize(
    ("name", "reason"),
    [("runs.db/no.db", "Not a directory"), (".", "Is a directory"), ("x" * 300, "File name too long")],
)
def test_a_file_that_cannot_be_opened_is_named_with_the_reason(
    name: str, reason: str, read_only: bool, tmp_path: Path
) -> None:
    (tmp_path / "runs.db").touch()
    path = str(tmp_path / name)
    with pytest.raises(BadInput) as caught:
        Journal(path, read_only=read_only)
    assert str(caught.value) == f"{path}: {reason}"


def test_of_a_file_that_is_not_there_a_similar_one_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.db").touch()
    for name, guess in (("mien.db", "; did you mean mine.db?"), ("no such", ""), ("nowhere/x.db", "")):
        with pytest.raises(BadInput) as caught:
            Journal(name, read_only=True)
        assert str(caught.value) == f"{name!r}: no such file{guess}"
    with pytest.raises(BadInput, match=r"^nowhere/x\.db: there is no folder /.*/nowhere: make it first$"):
        Journal("nowhere/x.db")


def test_a_store_that_can_only_be_read_is_refused_to_a_writer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As SQLite opens a file without permission to write: it says nothing until something is written."""
    path, connect = tmp_path / "archived.db", sqlite3.connect
    Journal(str(path)).close()

    def read_only(file: str, **options: Any) -> sqlite3.Connection:
        if path.name in str(file):  # and not a schema that is made in memory, for comparison
            file, options = f"{path.as_uri()}?mode=ro", options | {"uri": True}
        opened: sqlite3.Connection = connect(file, **options)
        return opened

    monkeypatch.setattr(sqlite3, "connect", read_only)
    with pytest.raises(BadInput, match=r"archived\.db: attempt to write a readonly database"):
        Journal(str(path))


def test_a_store_that_another_process_holds_is_no_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, connect = str(tmp_path / "busy.db"), sqlite3.connect
    Journal(path).close()
    holder = connect(path)  # not through the lock, as a backup program might
    holder.execute("BEGIN IMMEDIATE")
    monkeypatch.setattr(sqlite3, "connect", lambda file, **options: connect(file, timeout=0.0, **options))
    with pytest.raises(StoreFailed, match=r"busy\.db: database is locked") as caught:
        Journal(path)
    assert not isinstance(caught.value, BadInput)
    holder.close()


def _odd_files(folder: Path) -> dict[str, Path]:
    """What somebody might name by mistake."""
    odd = {name: folder / name for name in ("nothing", "empty", "text", "folder", "foreign", "torn")}
    odd["empty"].touch()
    odd["text"].write_text("dear diary, " * 200)
    odd["folder"].mkdir()
    _foreign(odd["foreign"], "CREATE TABLE person (name TEXT)")
    Journal(str(folder / "whole.db")).close()
    odd["torn"].write_bytes((folder / "whole.db").read_bytes()[:5000])
    return odd


@pytest.mark.parametrize("name", ["nothing", "empty", "text", "folder", "foreign", "torn"])
def test_asking_an_odd_file_is_exit_code_2_and_one_line(name: str, tmp_path: Path) -> None:
    file = _odd_files(tmp_path)[name]
    before = file.read_bytes() if file.is_file() else b""
    command = [sys.executable, "-m", "cogradar", "query", "p_d", "--store", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert str(file) in done.stderr
    assert (file.read_bytes() if file.is_file() else b"") == before


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("run smoke", "nowhere/x.db"),
        ("run smoke --in-process", "folder"),
        ("campaign smoke", "nowhere/x.db"),
        ("campaign smoke", "foreign"),
        ("service recorder", "text"),
        ("service metrics", "text"),
    ],
)
def test_no_store_to_write_is_exit_code_2_and_one_line_before_anything_is_started(
    command: str, name: str, tmp_path: Path
) -> None:
    _odd_files(tmp_path)
    file = tmp_path / name
    before = file.read_bytes() if file.is_file() else b""
    arguments = [sys.executable, "-m", "cogradar", *command.split(), "--store", str(file)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert str(file) in done.stderr
    assert (file.read_bytes() if file.is_file() else b"") == before


def test_what_is_not_committed_is_not_seen_and_can_be_undone(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    reader = Journal(path, read_only=True)
    journal.add_run(smoke_start())
    assert journal.has_uncommitted
    assert (journal.start("r"), reader.start("r")) == (smoke_start(), None)
    journal.commit()
    assert reader.start("r") == smoke_start()
    journal.acknowledge("r", 5, 3, 0)
    journal.rollback()
    assert [journal.has_uncommitted] == [False]
    columns = "SELECT acknowledged_k AS k, acknowledged_t AS t, acquisition_scans AS n FROM run"
    assert journal.read(columns) == [{"k": 0, "t": 0, "n": None}]
    journal.acknowledge("r", 5, 3, 0)
    journal.close()
    assert reader.read(columns) == [{"k": 5, "t": 3, "n": 2}]
    reader.close()


def _end(core: RecorderCore, run: str, dwells: int = 3) -> None:
    core.handle(smoke_start(run=run))
    for k in range(dwells):
        core._journal.add_message(run, k, "truth", 0, b"x" * 5000)
    core.handle(RunEnd(run=run, k=0, t=0, status="stopped" if run in "ac" else "failed", reason="x"))


def _runs(journal: Journal) -> tuple[list[str], list[str]]:
    """Those that the journal holds, and those of which it holds messages."""
    held, written = (
        [row["run"] for row in journal.read(query)]
        for query in ("SELECT run FROM run ORDER BY run", "SELECT DISTINCT run FROM message ORDER BY run")
    )
    return held, written


@pytest.mark.usefixtures("either_store")
def test_ended_runs_beyond_a_number_are_dropped_little_by_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tick deletes some dwells; a run that goes on is never dropped."""
    monkeypatch.setattr(journals, "DELETED_DWELLS", 2)
    journal = Journal(":memory:")
    core = RecorderCore(journal, keep=Retention(runs=2, grace_s=0))
    core.handle(smoke_start(run="on"))
    for name in "abcd":
        _end(core, name)
    left = []
    for _ in range(6):
        core.handle(Tick(0.0))
        left.append(journal.read("SELECT COUNT(*) AS n FROM message WHERE run IN ('a', 'b')")[0]["n"])
    assert left == [4, 3, 3, 1, 0, 0]
    assert _runs(journal) == (["c", "d", "on"], ["c", "d"])
    assert journal.read("SELECT * FROM dropped") == []


@pytest.mark.usefixtures("either_store")
def test_a_run_is_kept_until_whoever_began_it_can_have_seen_its_end() -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal, keep=Retention(runs=1, days=0.0))
    for name in "abc":
        _end(core, name)
    core.handle(Tick(0.0))
    assert _runs(journal)[0] == ["a", "b", "c"]
    journal.write("UPDATE run SET ended_s = ended_s - 61 WHERE run IN ('a', 'b')")
    core.handle(Tick(0.0))
    assert _runs(journal)[0] == ["c"]


@pytest.mark.usefixtures("either_store")
def test_ended_runs_beyond_an_age_are_dropped_and_a_recorder_that_comes_back_goes_on_deleting() -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for name in "ab":
        _end(core, name)
    journal.write("UPDATE run SET ended_s = ended_s - 90000 WHERE run = 'a'")
    seal(journal)
    RecorderCore(journal, resume=True, keep=Retention(days=1.0))
    assert _runs(journal) == (["b"], ["a", "b"])
    again = RecorderCore(journal, resume=True)
    for _ in range(2):
        again.handle(Tick(0.0))
    assert _runs(journal) == (["b"], ["b"])


def test_the_space_of_dropped_runs_is_used_again(tmp_path: Path) -> None:
    journal = Journal(str(tmp_path / "runs.db"))
    core, pages = RecorderCore(journal, keep=Retention(runs=1, grace_s=0)), list[int]()
    for i in range(12):
        _end(core, f"r{i}", 100)
        for _ in range(4):
            core.handle(Tick(0.0))
        pages.append(journal.read("PRAGMA page_count")[0]["page_count"])
    assert max(pages) <= 1.1 * pages[3]
    journal.close()


def test_a_store_that_was_closed_is_one_file_and_stays_one_for_readers(tmp_path: Path) -> None:
    """Those who only read a write-ahead log make files beside it that they cannot remove."""
    path = tmp_path / "runs.db"
    for _ in range(2):
        Journal(str(path)).close()
        Journal(str(path), read_only=True).close()
        assert [file.name for file in tmp_path.iterdir()] == ["runs.db"]


def test_a_reader_neither_hinders_nor_delays_the_end_of_a_writer(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    writer = Journal(path)
    start = smoke_start()
    writer.add_run(start)
    writer.commit()
    reader = Journal(path, read_only=True)
    assert reader.unfinished() == [start.run]
    writer.read("PRAGMA busy_timeout=600000")  # as long would it wait, if it waited for the reader
    began = time.monotonic()
    writer.close()
    assert time.monotonic() - began < 60.0
    again = Journal(path)
    again.give_up_unfinished()
    again.commit()
    assert reader.unfinished() == []
    reader.close()
    again.close()
    assert [file.name for file in tmp_path.iterdir()] == ["runs.db"]


def test_a_statement_that_undoes_the_transaction_is_no_damage_of_one_run(tmp_path: Path) -> None:
    """SQLite undoes all that is not committed when a change takes too long. What was undone was acknowledged."""
    with closing(Journal(str(tmp_path / "x.db"), owner="recorder")) as journal:
        journal.lead()
        for k in range(4000):
            journal.add_message("old", k, "plan", 0, b"x")
        journal.write("INSERT INTO dropped VALUES ('old')")
        journal.commit()
        journal.add_message("new", 0, "plan", 0, b"x")
        connection = journal._connection
        assert isinstance(connection, SqliteConnection)
        connection.db.set_progress_handler(lambda: 1, 100)
        with pytest.raises(NoRoom, match="took more steps"):
            journal.delete_dropped()
        connection.db.set_progress_handler(None, 0)
        assert journal.rows("SELECT COUNT(*) FROM message WHERE run = 'new'")[0][0] == 0


def test_an_endless_question_about_a_run_is_damage_of_that_run(tmp_path: Path) -> None:
    """All runs were held for it: it spoils the transaction, and the next one has to know which run to set aside."""
    with closing(Journal(str(tmp_path / "x.db"), owner="recorder")) as journal:
        journal.lead()
        for k in range(4000):
            journal.add_message("old", k, "plan", 0, b"x")
        connection = journal._connection
        assert isinstance(connection, SqliteConnection)
        connection.db.set_progress_handler(lambda: 1, 100)
        with pytest.raises(Damaged, match="run 'old': a question took more steps") as caught:
            journal.rows("SELECT SUM(LENGTH(payload)) FROM message WHERE run = ?", ["old"])
        connection.db.set_progress_handler(None, 0)
        assert caught.value.run == "old"
        journal.rollback()


def test_a_store_without_a_name_is_refused() -> None:
    with pytest.raises(BadInput, match="the store has no name: name a file"):
        Journal("")
