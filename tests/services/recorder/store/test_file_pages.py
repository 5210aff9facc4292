"""Pages of a file that SQLite cannot read any more: the runs on them are set aside and named, all others go on."""

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput, Damaged, StoreFailed
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.store.check import check
from cogradar.services.recorder.store.sqlite import SqliteConnection
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.recovery import WaveformRecall
from tests.services.loop import play, scans, smoke_start

NAMES = [f"run-{i:02}" for i in range(24)]


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=60))


def _fill(path: Path, sent: list[Message], n: int = 9, names: list[str] = NAMES) -> None:
    """A store of runs that go on, each with its first messages."""
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal)
        for run in names:
            for message in sent[:n]:
                core.handle(message.model_copy(update={"run": run}))


def _pages(path: Path, table: str) -> list[int]:
    """The leaves of a table or an index, from left to right; SQLite counts from 1."""
    with closing(sqlite3.connect(path)) as db:
        query = "SELECT pageno FROM dbstat WHERE name = ? AND pagetype = 'leaf' ORDER BY path"
        return [page for (page,) in db.execute(query, [table])]


def _middle(path: Path) -> list[int]:
    """A page with messages of a run or two."""
    pages = _pages(path, "message")
    return [pages[len(pages) // 2]]


def _spoil(path: Path, *pages: int) -> None:
    """Of each page the first bytes, which say what is on it, are others."""
    with path.open("r+b") as file:
        for page in pages:
            file.seek(4096 * (page - 1))
            file.write(bytes(16))


def _status(journal: Journal) -> dict[str, str]:
    return {row["run"]: row["status"] for row in journal.read("SELECT run, status FROM run")}


OF_RUN = {
    "run": "SELECT * FROM run WHERE run = ? ORDER BY run",
    "message": "SELECT * FROM message WHERE run = ? ORDER BY run",
}


def _runs_on(path: Path, table: str, pages: list[int]) -> set[str]:
    """The runs of which something is on these pages."""
    found = set()
    with closing(sqlite3.connect(path)) as db:
        for run in NAMES:
            try:
                db.execute(OF_RUN[table], [run]).fetchall()
            except sqlite3.DatabaseError:
                found.add(run)
    assert pages
    return found


@pytest.mark.parametrize("which", [lambda pages: pages[5:6], lambda pages: pages[3:8], lambda pages: pages[-1:]])
def test_a_page_of_the_table_of_runs_sets_the_runs_on_it_aside(
    tmp_path: Path, sent: list[Message], which: Callable[[list[int]], list[int]], caplog: pytest.LogCaptureFixture
) -> None:
    """No row is lost: the old table stays, for programs that can read more of it."""
    path = tmp_path / "runs.db"
    _fill(path, sent)
    _spoil(path, *(pages := which(_pages(path, "run"))))
    bad = _runs_on(path, "run", pages)
    good = [run for run in NAMES if run not in bad]
    assert 0 < len(bad) < 12
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert core.trouble == ""
        for run in [*good, "new"]:
            for message in sent:
                core.handle(message.model_copy(update={"run": run}))
        assert core.handle(scans(sent)[0].model_copy(update={"run": min(bad)})) == ()
        found = _status(journal)
        reasons = {reason for (reason,) in journal.rows("SELECT reason FROM run WHERE status = 'quarantined'")}
        with closing(MetricsCore(str(path))) as metrics:
            metrics.handle(Tick(0.0))
            assert answer(metrics.store, "p_d", {"run": good[-1]})
            assert {row["run"]: row["status"] for row in answer(metrics.store, "runs", {})} == found
            with pytest.raises(BadInput, match=f"run '{min(bad)}', table run: its checksum does not fit"):
                answer(metrics.store, "p_d", {"run": min(bad)})
    assert found == dict.fromkeys([*good, "new"], "complete") | dict.fromkeys(bad, "quarantined")
    (reason,) = reasons
    assert "its row is on a page that cannot be read, in table run_unreadable_" in reason
    assert f"{len(bad)} of 24 rows of table run cannot be read" in caplog.text
    assert {error.run for error in check(str(path)) if error.run} == bad
    saved = str(tmp_path / "saved.db")
    done = CliRunner().invoke(app, ["store", "copy", "--intact", str(path), saved])
    assert done.exit_code == 0, done.output
    assert check(saved) == []
    with closing(Journal(saved, owner="recorder")) as journal:
        assert Recorder(journal, resume=True).trouble == ""
        assert _status(journal).keys() == {*good, "new"}


def test_runs_that_have_only_begun_are_named_too(tmp_path: Path, sent: list[Message]) -> None:
    """By the index of their names."""
    path = tmp_path / "runs.db"
    _fill(path, sent, 1)
    _spoil(path, *(pages := _pages(path, "run")[3:8]))
    bad = _runs_on(path, "run", pages)
    with closing(Journal(str(path), owner="recorder")) as journal:
        assert Recorder(journal, resume=True).trouble == ""
        assert _status(journal) == {run: "quarantined" if run in bad else "running" for run in NAMES}


def test_a_page_that_is_met_while_runs_go_on_sets_the_runs_on_it_aside(tmp_path: Path, sent: list[Message]) -> None:
    path = tmp_path / "runs.db"
    _fill(path, sent)
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        core.handle(Tick(0.0))
        journal.commit()
        journal.rows("PRAGMA wal_checkpoint(TRUNCATE)")
        _spoil(path, *(pages := _pages(path, "run")[5:6]))
        journal.rows("PRAGMA shrink_memory")
        bad = _runs_on(path, "run", pages)
        for message in sent:
            for run in NAMES:
                core.handle(message.model_copy(update={"run": run}))
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        for run in NAMES:  # what is not acknowledged is sent again
            for message in sent:
                core.handle(message.model_copy(update={"run": run}))
        assert core.trouble == ""
        assert _status(journal) == {run: "quarantined" if run in bad else "complete" for run in NAMES}


@pytest.mark.parametrize("resume", [True, False])
def test_a_page_of_messages_sets_the_runs_on_it_aside(tmp_path: Path, sent: list[Message], *, resume: bool) -> None:
    """All runs were held: after damage SQLite writes nothing more in the transaction that has met it."""
    path = tmp_path / "runs.db"
    _fill(path, sent, 60, NAMES[:6])
    _spoil(path, *(pages := _middle(path)))
    bad = _runs_on(path, "message", pages)
    assert 0 < len(bad) < 4
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal, resume=resume)
        assert core.trouble == ""
        for _ in range(2 if resume else 0):  # what is not acknowledged is sent again
            for message in sent[1:]:
                for run in NAMES[:6]:
                    core.handle(message.model_copy(update={"run": run}))
            for tick in range(2 * LOOK_TICKS):
                core.handle(Tick(tick / 4))
        assert core.trouble == ""
        found = _status(journal)
        aside = {run for run, status in found.items() if status == "quarantined"}
        # Without a resume nothing of them is read. The run before has its next messages on the page, too.
        assert (bad if resume else set()) <= aside <= {*bad, NAMES[NAMES.index(min(bad)) - 1]}
        assert {found[run] for run in NAMES[:6] if run not in aside} == {"complete" if resume else "failed"}
        reasons = [reason for (reason,) in journal.rows("SELECT reason FROM run WHERE status = 'quarantined'")]
        assert all("malformed" in reason for reason in reasons)


def test_a_page_of_messages_that_is_met_while_runs_go_on_ends_its_run_only(tmp_path: Path, sent: list[Message]) -> None:
    """By a recall, while messages of others are not committed yet."""
    path = tmp_path / "runs.db"
    _fill(path, sent, 60, NAMES[:6])
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        journal.rows("PRAGMA wal_checkpoint(TRUNCATE)")
        _spoil(path, *(pages := _middle(path)))
        journal.rows("PRAGMA shrink_memory")
        bad = min(_runs_on(path, "message", pages))
        core.handle(sent[0].model_copy(update={"run": "new"}))
        core.handle(scans(sent)[0].model_copy(update={"run": "new"}))  # a transaction is open
        for k in range(60):
            core.handle(WaveformRecall(run=bad, k=k))
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        found = _status(journal)
        assert found[bad] == "quarantined"
        assert {found[run] for run in (NAMES[0], "new")} == {"running"}


@pytest.mark.parametrize("table", ["message", "command"])
def test_runs_on_damaged_pages_are_no_hindrance_to_retention(tmp_path: Path, sent: list[Message], table: str) -> None:
    path = tmp_path / "runs.db"
    _fill(path, sent, len(sent), NAMES[:6])
    _spoil(path, *(_middle(path) if table == "message" else _pages(path, table)))
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = Recorder(journal, resume=True, keep=Retention(runs=1, grace_s=-1))
        for tick in range(20 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        assert "complete" in _status(journal).values() or table == "command"
        for message in sent:
            core.handle(message.model_copy(update={"run": "new"}))
        assert _status(journal)["new"] == "complete"


def test_a_transaction_that_sqlite_undoes_by_itself_after_damage_hinders_no_next_one(
    tmp_path: Path, sent: list[Message]
) -> None:
    """As when the disk fails altogether for a moment: each later statement had the first error, for ever."""
    path = tmp_path / "runs.db"
    _fill(path, sent, 60, NAMES[:6])
    _spoil(path, *_middle(path))
    with closing(Journal(str(path), owner="recorder")) as journal:
        journal.lead()
        with pytest.raises(Damaged):
            journal.rows("SELECT SUM(LENGTH(payload)) FROM message")
        journal.rows("PRAGMA shrink_memory")
        with _unreadable(path), pytest.raises(StoreFailed, match="disk I/O error"):
            journal.rows("SELECT document FROM run")
        assert not journal.has_uncommitted
        journal.rollback()
        journal.lead()
        journal.commit()


def test_a_log_of_a_former_writer_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    with closing(Journal(str(path), owner="recorder")) as journal:
        journal.lead()
        journal.commit()
        connection = journal._connection
        assert isinstance(connection, SqliteConnection)
        connection._has_old_log = True  # as after a takeover beside a reader that held an old state for five seconds
        with _unreadable(path.with_name("runs.db-wal")), pytest.raises(StoreFailed, match=r"runs\.db: disk I/O error"):
            journal.check_room()


@contextmanager
def _unreadable(path: Path) -> Iterator[None]:
    """A file that this process has open can only be written."""
    (file,) = (int(link.name) for link in Path("/proc/self/fd").iterdir() if link.exists() and link.samefile(path))
    kept, write_only = os.dup(file), os.open(path, os.O_WRONLY)
    try:
        os.dup2(write_only, file)
        yield
    finally:
        os.dup2(kept, file)
        os.close(kept)
        os.close(write_only)


def test_only_a_table_as_it_was_made_may_stay_beside_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path)) as db:
        db.execute("CREATE TABLE run_unreadable_1 (run TEXT PRIMARY KEY)")
    with pytest.raises(BadInput, match="is not as version"):
        Journal(str(path))
