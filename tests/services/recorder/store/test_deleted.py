"""`cogradar store delete`: one run is taken out of a store, with all that belongs to it."""

import json
import signal
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.cli.console import Lines
from cogradar.services.errors import Damaged
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.delete import delete
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.check import OF_RUNS, check, held_still
from cogradar.services.runs import in_process
from tests.postgresql import Server
from tests.services.cli.here import here
from tests.services.loop import smoke_start


def _two_runs(name: str) -> None:
    with closing(Store(Journal(name))) as store:
        for run in ("a", "b"):
            in_process.play(smoke_start(run=run, dwells=5), store=store)


def _rows(name: str, of: str = "") -> dict[str, list[str]]:
    with closing(Journal(name, read_only=True)) as journal:
        found = {table: journal.rows(f"SELECT * FROM {table} {of}") for table in OF_RUNS}
    return {table: sorted(str(tuple(row)) for row in rows) for table, rows in found.items()}


def _is_deleted(name: str) -> None:
    _two_runs(name)
    before = _rows(name, "WHERE run = 'b'")
    done = here("store", "delete", name, "a")
    assert (done.returncode, "run a is deleted" in done.stdout.replace("\n", " ")) == (0, True), done
    assert _rows(name) == before
    assert len(before["message"]) > 10
    assert check(name) == []
    again = here("store", "delete", name, "a")
    assert again.returncode == 2
    assert "no such run: a; `cogradar query runs --store` lists them" in again.stderr.replace("\n", " ")


def test_a_run_is_deleted_from_a_file(tmp_path: Path) -> None:
    _is_deleted(str(tmp_path / "runs.db"))


def test_a_run_is_deleted_from_a_server(postgresql: Server) -> None:
    _is_deleted(postgresql.url())


def test_no_run_is_deleted_that_has_not_ended_or_while_a_process_writes_the_store(tmp_path: Path) -> None:
    file = str(tmp_path / "runs.db")
    _two_runs(file)
    with closing(Journal(file, owner="recorder-0")) as journal:
        journal.add_run(smoke_start(run="c", dwells=5))
        journal.commit()
        for run, said in (("a", "in use by recorder-0"), ("c", "run c has not ended: end it with `cogradar cancel c`")):
            done = here("store", "delete", file, run)
            assert (done.returncode, said in done.stderr) == (2, True), done
    done = here("store", "delete", file, "c")
    assert (done.returncode, "`cogradar run --store` on it marks it as failed" in done.stderr) == (2, True)
    assert len(_rows(file)["run"]) == 3
    assert here("run", "smoke", "--in-process", "--dwells", "3", "--store", file).returncode == 0  # the other cure
    done = here("store", "delete", file, "c")
    assert done.returncode == 0, done
    assert {row["run"] for row in _runs(file)} > {"a", "b"}


def _runs(name: str) -> list[dict[str, str]]:
    rows: list[dict[str, str]] = json.loads(here("query", "runs", "--store", name, "--json").stdout)
    return rows


def _is_deleted_in_steps(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each in a transaction of its own, so that the log of a file does not grow as large as the run."""
    monkeypatch.setattr("cogradar.services.recorder.journal.DELETED_DWELLS", 2)
    _two_runs(name)
    before, left, told = _rows(name, "WHERE run = 'b'"), list[int](), list[int]()

    def report(n: int) -> None:
        rows = _rows(name, "WHERE run = 'a'")  # as another process sees it
        assert {table for table, found in rows.items() if found} <= {"message"}
        left.append(len(rows["message"]))
        told.append(n)

    delete(name, "a", report)
    assert left[0] > left[1] > left[2] > left[-1] == 0
    assert [n + n_left for n, n_left in zip(told, left, strict=True)] == [left[0]] * len(left)
    assert _rows(name) == before
    with closing(Journal(name, read_only=True)) as journal:
        assert journal.dropped() == []


def _is_interrupted_and_finished(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.recorder.journal.DELETED_DWELLS", 2)
    _two_runs(name)
    before, commits, commit = _rows(name, "WHERE run = 'b'"), list[None](), Journal.commit

    def second_by_user(journal: Journal) -> None:
        commit(journal)
        commits.append(None)
        if len(commits) == 2:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patched:
        patched.setattr(Journal, "commit", second_by_user)
        done = here("store", "delete", name, "a")
    said = done.stderr.replace("\n", " ")
    assert (done.returncode, "the next recorder or `store delete` deletes the rest" in said) == (130, True), done
    assert [row["run"] for row in _runs(name)] == ["b"]
    assert len(_rows(name)["message"]) > len(before["message"])
    assert check(name) == []
    assert here("store", "delete", name, "a").returncode == 0  # the same once more
    assert _rows(name) == before
    assert here("store", "delete", name, "a").returncode == 2


def test_messages_of_a_file_are_deleted_in_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _is_deleted_in_steps(str(tmp_path / "runs.db"), monkeypatch)


def test_messages_of_a_server_are_deleted_in_steps(postgresql: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    _is_deleted_in_steps(postgresql.url(), monkeypatch)


def test_an_interrupted_deletion_of_a_file_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _is_interrupted_and_finished(str(tmp_path / "runs.db"), monkeypatch)


def test_an_interrupted_deletion_of_a_server_is_finished(postgresql: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    _is_interrupted_and_finished(postgresql.url(), monkeypatch)


def test_progress_is_on_standard_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    each = Lines.__init__
    monkeypatch.setattr(Lines, "__init__", lambda lines, _each_s: each(lines, 0.0))
    file = str(tmp_path / "runs.db")
    _two_runs(file)
    done = here("store", "delete", file, "a")
    assert "run a, 0 messages deleted" in done.stderr.replace("\n", " "), done


def test_while_another_process_reads_a_file_the_cure_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, connect = str(tmp_path / "runs.db"), sqlite3.connect
    _two_runs(file)
    monkeypatch.setattr(sqlite3, "connect", lambda name, **options: connect(name, timeout=0.0, **options))
    with held_still(file) as store:
        store.rows("SELECT run FROM run")
        done = here("store", "delete", file, "a")
    said = "another process reads or writes this store; try again when it is over"
    assert (done.returncode, said in done.stderr.replace("\n", " ")) == (2, True), done
    assert here("store", "delete", file, "a").returncode == 0


def test_damage_among_the_messages_is_told_and_hinders_no_other_deletion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, write = str(tmp_path / "runs.db"), Journal.write
    _two_runs(file)

    def damaged(journal: Journal, statement: str, *parameters: object) -> int:
        if statement.startswith("DELETE FROM message") and parameters[0] == "a":
            raise Damaged("x", "a")
        return write(journal, statement, *parameters)

    monkeypatch.setattr(Journal, "write", damaged)
    with pytest.raises(Damaged, match="run 'a' is deleted, but not all of its messages"):
        delete(file, "a")
    delete(file, "b")
    assert {table for table, rows in _rows(file).items() if rows} == {"message"}


@pytest.mark.parametrize("arguments", [("runs.db",), ("runs.db", "a", "--intact"), ("runs.db", "a")], ids=" ".join)
def test_what_is_no_deletion_is_refused_and_makes_no_store(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert here("store", "delete", *arguments).returncode == 2
    assert list(tmp_path.iterdir()) == []
