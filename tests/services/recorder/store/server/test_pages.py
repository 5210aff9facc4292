"""Pages that a server cannot read any more: the run at hand is set aside and named, all others go on."""

import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psycopg
import pytest
from psycopg import sql
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.store.check import check
from cogradar.services.recorder.store.tables import SCHEMA_VERSION
from cogradar.services.recorder.store.unreadable import most_rows
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Command, Message, RunEnd
from cogradar.shared.protocol.orders import PowerLimit
from cogradar.shared.protocol.recovery import WaveformRecall
from tests.postgresql import Server, running
from tests.services.loop import play, scans, smoke_start

RUNS = ("first", "bad", "worse", "last")


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=60))


@pytest.fixture
def server() -> Iterator[Server]:
    with running() as server:
        yield server


def _filled(server: Server, sent: list[Message]) -> str:
    """A store of runs that go on, one after the other in its pages."""
    url = server.url("runs")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal)
        for run in RUNS:
            for message in sent[:-1]:
                core.handle(message.model_copy(update={"run": run}))
    return url


def _status(journal: Journal) -> dict[str, str]:
    return {row["run"]: row["status"] for row in journal.read("SELECT run, status FROM run")}


def _end(run: str, sent: list[Message]) -> RunEnd:
    last = sent[-1]
    assert isinstance(last, RunEnd)
    return last.model_copy(update={"run": run})


def test_a_recorder_sets_the_runs_on_damaged_pages_aside_and_goes_on(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    server.spoil(url, "message", "bad", "worse")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert core.trouble == ""
        for run in RUNS:
            core.handle(_end(run, sent))
        found = _status(journal)
        ((reason,),) = journal.rows("SELECT reason FROM run WHERE run = 'worse'")
    assert found == {"first": "complete", "bad": "quarantined", "worse": "quarantined", "last": "complete"}
    assert "run 'worse': invalid page in block" in reason
    with closing(MetricsCore(url)) as metrics:
        metrics.handle(Tick(0.0))
        assert answer(metrics.store, "p_d", {"run": "last"})
        with pytest.raises(BadInput, match="run 'bad': invalid page in block"):
            answer(metrics.store, "p_d", {"run": "bad"})
        told = {row["run"]: row["status"] for row in answer(metrics.store, "runs", {})}
        assert told == found


def test_a_run_on_a_damaged_page_is_set_aside_when_it_is_recalled(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        for run in RUNS:
            core.handle(_end(run, sent))
    server.spoil(url, "message", "bad")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        core.handle(sent[0].model_copy(update={"run": "new"}))
        core.handle(scans(sent)[0].model_copy(update={"run": "new"}))  # a transaction is open
        assert core.handle(WaveformRecall(run="bad", k=30)) == []
        assert core.trouble == ""
        assert _status(journal) == dict.fromkeys(RUNS, "complete") | {"bad": "quarantined", "new": "running"}
        assert len(journal.rows("SELECT 1 FROM message WHERE run = 'new'")) == 1


@pytest.mark.parametrize("table", ["message", "command"])
def test_runs_on_damaged_pages_are_no_hindrance_to_retention(server: Server, sent: list[Message], table: str) -> None:
    url = _filled(server, sent)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        for run in RUNS:
            if run == "bad":
                core.handle(Command(run=run, id="0" * 32, by="operator", action=PowerLimit(share=0.5), at=0))
            core.handle(_end(run, sent))
    server.spoil(url, table, "bad")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True, keep=Retention(runs=1, grace_s=-1))
        for tick in range(20):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        assert _status(journal) == {"last": "complete"} | ({"bad": "quarantined"} if table == "command" else {})
        assert {run for (run,) in journal.rows("SELECT run FROM dropped")} == ({"bad"} - _status(journal).keys())
        for run in ("first", "worse"):
            assert journal.rows("SELECT COUNT(*) FROM message WHERE run = ?", [run]) == [(0,)]


def test_a_recorder_whose_writes_meet_a_damaged_page_holds_all_runs(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    server.spoil(url, "message", "last")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        new = [message.model_copy(update={"run": "new"}) for message in sent]
        core.handle(new[0])
        for scan in new[1:]:
            core.handle(scan)
        assert "invalid page in block" in core.trouble
        assert core.trouble.endswith("all runs are held")
        for tick in range(3 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert _status(journal) == dict.fromkeys(RUNS, "running") | {"last": "quarantined", "new": "running"}


@pytest.mark.parametrize(("resume", "n_byte"), [(True, 1900), (False, 1900), (True, 30_000)])
def test_a_damaged_snapshot_ends_its_run_only(
    server: Server, sent: list[Message], n_byte: int, *, resume: bool
) -> None:
    """Of a long one the server has pages of its own, which are not read with the others."""
    url, rng = server.url("runs"), np.random.default_rng(1)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal)
        for run in ("bad", "last"):
            for message in sent[:-1]:
                core.handle(message.model_copy(update={"run": run}))
            for target in range(1, 4):
                journal.set_snapshot(run, target, 5, rng.bytes(n_byte if run == "bad" else 1900))
            journal.set_snapshot(run, 4, 5, bytes(1000))
    if n_byte > 1900:
        server.spoil_long(url, "snapshot")
    else:
        server.spoil(url, "snapshot", "bad")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=resume)
        core.handle(_end("last", sent))
        assert core.trouble == ""
        assert _status(journal) == {"bad": "quarantined", "last": "complete" if resume else "failed"}


def _many(server: Server, sent: list[Message], long: str = "") -> tuple[str, list[str], list[str]]:
    """A store whose table of runs has several pages; the runs on one of them, and others.

    long : a run whose document is so long that the server keeps it on pages of its own
    """
    url = server.url("runs")
    names = [f"run-{i:02}" for i in range(24)]
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal)
        for run in names:
            for message in sent[: 9 if run != names[0] else None]:
                core.handle(message.model_copy(update={"run": run}))
        journal.write("UPDATE run SET document = ? WHERE run = ?", np.random.default_rng(1).bytes(20_000).hex(), long)
        journal.commit()
        rows = journal.rows("SELECT run, ctid::text FROM run ORDER BY run")
    pages = {run: ctid.partition(",")[0] for run, ctid in rows}
    bad = [run for run in names if pages[run] == pages[names[-1]]]  # where the server puts new rows
    assert 0 < len(bad) < len(names) - 2
    assert long not in bad
    return url, bad, [run for run in names if run not in bad]


def test_a_page_of_the_table_of_runs_sets_the_runs_on_it_aside(server: Server, sent: list[Message]) -> None:
    """A metrics that may only read goes on reading, and no row is lost: the page stays, for who can read more of it."""
    url, bad, good = _many(server, sent)
    with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
        db.execute("CREATE ROLE metrics LOGIN; GRANT USAGE ON SCHEMA runs TO metrics")
        db.execute("GRANT SELECT ON ALL TABLES IN SCHEMA runs TO metrics; GRANT SELECT ON runs.run TO PUBLIC")
    server.spoil(url, "run", *bad)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert core.trouble == ""
        for run in [*good, "new"]:
            for message in sent:
                core.handle(message.model_copy(update={"run": run}))
        assert core.handle(scans(sent)[0].model_copy(update={"run": bad[0]})) == ()
        found = _status(journal)
        reasons = {reason for (reason,) in journal.rows("SELECT reason FROM run WHERE status = 'quarantined'")}
        assert not core.handle(Tick(0.0))
    assert found == dict.fromkeys([*good, "new"], "complete") | dict.fromkeys(bad, "quarantined")
    (reason,) = reasons
    assert "its row is on a page that cannot be read, in table run_unreadable_" in reason
    assert "invalid page in block" in reason
    with closing(MetricsCore(url.replace("radar@", "metrics@"))) as metrics:
        metrics.handle(Tick(0.0))
        assert answer(metrics.store, "p_d", {"run": good[-1]})
        assert {row["run"]: row["status"] for row in answer(metrics.store, "runs", {})} == found
        with pytest.raises(BadInput, match=f"run '{bad[0]}', table run: its checksum does not fit"):
            answer(metrics.store, "p_d", {"run": bad[0]})
    with psycopg.connect(url.partition("&schema")[0]) as db:
        ((old,),) = db.execute(
            "SELECT relname FROM pg_class WHERE relkind = 'r' AND relname LIKE 'run\\_unreadable%'"
        ).fetchall()
        with pytest.raises(psycopg.errors.DataCorrupted):
            db.execute(sql.SQL("SELECT * FROM runs.{}").format(sql.Identifier(old)))
    assert {error.run for error in check(url)} == set(bad)


def test_a_page_of_the_table_of_runs_that_is_met_while_they_go_on_sets_the_runs_on_it_aside(
    server: Server, sent: list[Message]
) -> None:
    url, bad, good = _many(server, sent)
    server.spoil(url, "run", *bad)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        assert _status(journal) == dict.fromkeys(good, "running") | dict.fromkeys(bad, "quarantined") | {
            good[0]: "complete"
        }


def test_a_run_without_a_message_is_named_by_what_else_there_is_of_it(
    server: Server, sent: list[Message], caplog: pytest.LogCaptureFixture
) -> None:
    """As one of a campaign, of which there are scores. Of one that has only begun nothing else is there."""
    url, *_ = _many(server, sent)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        for run in ("kept", "bare"):
            core.handle(sent[0].model_copy(update={"run": run}))
        journal.set_snapshot("kept", 1, 5, b"what a track was")
        journal.commit()
        rows = journal.rows("SELECT run, (ctid::text::point)[0] FROM run")
    pages = {page for run, page in rows if run in {"kept", "bare"}}
    bad = {run for run, page in rows if page in pages} - {"bare"}
    server.spoil(url, "run", *bad, "bare")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert core.trouble == ""
        assert {run for run, status in _status(journal).items() if status == "quarantined"} == bad
        core.handle(sent[0].model_copy(update={"run": "bare"}))
        assert _status(journal)["bare"] == "running"
    lost = r"[12] of \d+ pages of 8192 bytes of table run cannot be read, and stay in table run_unreadable_"
    assert re.search(lost, caplog.text)
    assert "A run that has only begun may be on them, too: begin it again" in caplog.text


def test_all_rows_of_a_page_are_looked_for_whatever_its_size(postgresql: Server) -> None:
    """A server says how large its blocks are. A row takes 28 bytes of one at least."""
    with psycopg.connect(postgresql.url().partition("&schema")[0]) as db:
        db.execute("CREATE TEMP TABLE least ()")
        db.execute("INSERT INTO least SELECT FROM generate_series(1, 1000)")
        ((block_bytes,),) = db.execute("SELECT current_setting('block_size')::int").fetchall()
        ((most,),) = db.execute("SELECT max((ctid::text::point)[1])::int FROM least").fetchall()
    assert most <= most_rows(block_bytes) <= most + 65
    assert most_rows(32768) >= 1000


def test_a_row_that_cannot_be_read_to_its_end_is_set_aside_with_the_page(server: Server, sent: list[Message]) -> None:
    url, bad, good = _many(server, sent, long="run-03")
    server.spoil_long(url, "run")
    server.spoil(url, "run", *bad)
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert core.trouble == ""
        found = _status(journal)
    assert {run for run, status in found.items() if status == "quarantined"} == {*bad, "run-03"}
    assert found.keys() == {*bad, *good}


def test_a_page_of_the_leaders_holds_all_runs_until_they_are_deleted(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    server.spoil_all(url, "leader")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert "invalid page in block 0" in core.trouble
        with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
            db.execute("TRUNCATE runs.leader")
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        assert _status(journal) == dict.fromkeys(RUNS, "running")


def test_a_store_whose_version_cannot_be_read_is_opened_when_it_is_written_again(
    server: Server, sent: list[Message]
) -> None:
    url = _filled(server, sent)
    server.spoil_all(url, "store")
    with pytest.raises(BadInput, match="invalid page in block 0"):
        Journal(url, owner="recorder")
    with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
        db.execute("TRUNCATE runs.store")
        db.execute("INSERT INTO runs.store VALUES (%s)", [SCHEMA_VERSION])
    guide = Path(__file__).parents[5] / "docs" / "howto" / "postgresql.md"
    assert f"cogradar.store VALUES ({SCHEMA_VERSION})" in guide.read_text(encoding="utf-8")
    with closing(Journal(url, owner="recorder")) as journal:
        assert Recorder(journal, resume=True).trouble == ""


@pytest.mark.parametrize("index", ["run_pkey", "run_place_key", "leader_pkey"])
def test_a_damaged_index_holds_all_runs_until_it_is_made_anew(server: Server, sent: list[Message], index: str) -> None:
    url = _filled(server, sent)
    server.spoil_all(url, index)
    table = index.partition("_")[0]
    cure = f"index {index} of table {table}: invalid page in block 0 of relation base/"
    done = CliRunner().invoke(app, ["store", "check", url])
    said = " ".join(done.output.split())
    assert (done.exit_code, cure in said, f'REINDEX INDEX "runs"."{index}"' in said) == (2, True, True), said
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert cure in core.trouble
        assert f'`REINDEX INDEX "runs"."{index}"` makes the index anew from its table' in core.trouble
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert cure in core.trouble
        with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
            db.execute(f'REINDEX INDEX "runs"."{index}"'.encode())
        for tick in range(2 * LOOK_TICKS):
            core.handle(Tick(tick / 4))
        assert core.trouble == ""
        assert _status(journal) == dict.fromkeys(RUNS, "running")


def test_a_damaged_index_of_messages_is_named_with_its_cure(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    server.spoil_all(url, "message_pkey")
    with closing(Journal(url, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        reasons = [reason for (reason,) in journal.rows("SELECT reason FROM run")]
    assert core.trouble == ""
    assert all('REINDEX INDEX "runs"."message_pkey"' in reason for reason in reasons), reasons
    with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
        db.execute('REINDEX INDEX "runs"."message_pkey"')
    assert check(url) == []
    done = CliRunner().invoke(app, ["store", "copy", "--intact", url, target := str(server.url("saved"))])
    assert done.exit_code == 0, done.output
    with closing(Journal(target, read_only=True)) as journal:
        assert _status(journal).keys() == {*RUNS}


def test_a_check_names_all_runs_on_damaged_pages(server: Server, sent: list[Message]) -> None:
    url = _filled(server, sent)
    server.spoil(url, "message", "bad", "worse")
    assert [error.run for error in check(url) if error.run] == ["bad", "worse"]
    done = CliRunner().invoke(app, ["store", "check", url])
    said = " ".join(done.output.split())
    assert (done.exit_code, "run 'bad': invalid page" in said, "run 'worse': invalid page" in said) == (2, True, True)
    target = str(server.url("saved"))
    done = CliRunner().invoke(app, ["store", "copy", "--intact", url, target])
    assert done.exit_code == 0, done.output
    with closing(Journal(target, read_only=True)) as journal:
        assert _status(journal).keys() == {"first", "last"}


def test_no_question_is_compiled(server: Server) -> None:
    """Without an index a question seems dear to the server, which spent a tenth of a second on machine code for it."""
    with closing(Journal(server.url("runs"), owner="recorder")) as journal:
        plan = journal.rows("EXPLAIN ANALYZE SELECT run FROM run WHERE status = ?", ["complete"])
    assert "Seq Scan" in plan[0][0]
    assert not [line for (line,) in plan if "JIT" in line]
