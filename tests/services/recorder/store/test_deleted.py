"""`cogradar store delete`: one run is taken out of a store, with all that belongs to it."""

from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.check import OF_RUNS, check
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
    assert (done.returncode, "run a is deleted, " in done.stdout.replace("\n", " ")) == (0, True), done
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
    assert (done.returncode, "has not ended" in done.stderr) == (2, True)
    assert len(_rows(file)["run"]) == 3


@pytest.mark.parametrize("arguments", [("runs.db",), ("runs.db", "a", "--intact"), ("runs.db", "a")], ids=" ".join)
def test_what_is_no_deletion_is_refused_and_makes_no_store(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert here("store", "delete", *arguments).returncode == 2
    assert list(tmp_path.iterdir()) == []
