"""Pages that a server cannot read any more: the run at hand is set aside and named, all others go on."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.store.check import check
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
