"""Bytes of a store that something else has changed are found, named, and not believed; other runs go on."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput, Damaged, StoreFailed
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder import damaged_runs
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.services.recorder.store.check import TABLES, check
from cogradar.services.recorder.store.copy import copy
from cogradar.services.recorder.store.seal import SEALED, damage, sealed
from cogradar.services.recorder.store.tables import described
from cogradar.services.runs import in_process
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message, RunEnd, Scan
from cogradar.shared.protocol.orders import PowerLimit
from cogradar.shared.protocol.recovery import WaveformRecall
from tests.postgresql import Server
from tests.services.loop import play, scans, smoke_start
from tests.services.stored import rows

DWELLS = 12
LIVE, ENDED, KEPT = "live", "ended", "kept"  # runs: one goes on, one is over, of one a campaign has kept the scores
SCORES = ("score", "picture")
KINDS = {(table.name, column.name): column.kind for table, columns in described() for column in columns}
EMPTY = {"INTEGER": 1, "REAL": 1.0, "TEXT": "x"}  # what NULL becomes
COMMANDS = {
    "query": ["query", "p_d", "--run", "{run}", "--store", "{store}"],
    "report": ["report", "--run", "{run}", "{store}"],
    "export": ["export", "{run}", "--out", "{out}.csv", "--store", "{store}"],
    "replay": ["replay", "{run}", "--to", "allocator", "--store", "{store}"],
    "copy": ["store", "copy", "{store}", "{out}.db"],
    "check": ["store", "check", "{store}"],
}


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def _fill(name: str, sent: list[Message]) -> None:
    """A row in each table that has checksums."""
    with closing(Journal(name, owner="recorder")) as journal:
        core = RecorderCore(journal)
        for run, messages in ((ENDED, sent), (LIVE, sent[:-1])):
            for message in messages:
                core.handle(message.model_copy(update={"run": run}))
        core.handle(Command(run=LIVE, id="0" * 32, by="operator", action=PowerLimit(share=0.5), at=0))
        journal.set_snapshot(LIVE, 1, 5, b"what a track was")
        journal.set_campaign({"a": "\u00e4"})
        with closing(in_memory()) as store:
            run = in_process.play(smoke_start(dwells=DWELLS, run=KEPT), store=store).run["run"]
            recording = take(store, run)
        assert recording is not None
        journal.add_recording(recording, 9)


@pytest.fixture(params=["sqlite", "postgresql"])
def name(request: pytest.FixtureRequest, sent: list[Message], tmp_path: Path) -> str:
    found = str(tmp_path / "runs.db")
    if request.param == "postgresql":
        server: Server = request.getfixturevalue("postgresql")
        found = server.url()
    _fill(found, sent)
    return found


def _changed(value: Any, rng: np.random.Generator) -> Any:
    """A value with another byte, or another number."""
    if isinstance(value, bytes):
        at = int(rng.integers(len(value)))
        return value[:at] + bytes([value[at] ^ 1 << int(rng.integers(8))]) + value[at + 1 :]
    if isinstance(value, str) and value:
        at = int(rng.integers(len(value)))
        return value[:at] + chr(ord(value[at]) ^ 1) + value[at + 1 :]
    return "x" if value == "" else value + 1000


def _damage(name: str, table: str, column: str, rng: np.random.Generator, run: str = "") -> None:
    """Change one row of a table, as no program of ours would."""
    with closing(Journal(name, owner="another")) as journal:
        which, values = ("WHERE run = ?", [run]) if run else ("", [])
        listed = journal.read(f"SELECT * FROM {table} {which}", values)
        there = [row for row in listed if row[column] is not None] or listed
        row = there[rng.integers(len(there))]
        key = [one for one in row if row[one] is not None and not isinstance(row[one], float)]
        where = " AND ".join(f"{one} = ?" for one in key)
        value = EMPTY[KINDS[table, column]] if row[column] is None else _changed(row[column], rng)
        statement = f"UPDATE {table} SET {column} = ? WHERE {where}"
        assert journal.write(statement, value, *(row[one] for one in key)) == 1


def test_a_store_that_nothing_has_changed_is_whole(name: str) -> None:
    assert check(name) == []


@pytest.mark.parametrize("table", [*SEALED, *SCORES])
def test_a_byte_of_any_column_is_missed(name: str, table: str) -> None:
    """Each column of each table, each time in a copy of the store."""
    rng = np.random.default_rng(1)
    for column in TABLES[table]:
        with closing(Journal(name, read_only=True)) as journal:
            before = journal.rows(f"SELECT * FROM {table}")
        _damage(name, table, column, rng)
        found = check(name)
        assert found, column
        assert all(isinstance(one, Damaged) and "store check" in str(one) for one in found)
        assert any(f"table{'s' * (table in SCORES)} " in str(one) for one in found)
        with closing(Journal(name, owner="another")) as journal:
            journal.write(f"DELETE FROM {table}")
            journal.write_many(f"INSERT INTO {table} VALUES ({','.join('?' * len(before[0]))})", before)
    assert check(name) == []


def test_no_byte_of_a_file_is_changed_without_notice(sent: list[Message], tmp_path: Path) -> None:
    """Anywhere in it: in rows, in what SQLite finds them by, in free space."""
    whole, file = tmp_path / "whole.db", tmp_path / "file.db"
    _fill(str(whole), sent)
    rng, found, content = np.random.default_rng(1), 0, whole.read_bytes()
    expected = _content(str(whole))
    for _ in range(300):
        at = int(rng.integers(len(content)))
        file.write_bytes(content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :])
        try:
            faults = bool(check(str(file)))
        except BadInput:
            faults = True
        found += faults
        assert faults or _content(str(file)) == expected, at
    assert found > 100


def _content(name: str) -> list[list[tuple[Any, ...]]]:
    with closing(Journal(name, read_only=True)) as journal:
        return [[tuple(row) for row in journal.rows(f"SELECT * FROM {table}")] for table in TABLES]


# The recorder.


@pytest.mark.parametrize(
    ("table", "column"),
    [
        ("message", "payload"),
        ("message", "k"),
        ("command", "action"),
        ("run", "document"),
        ("run", "acknowledged_k"),
        ("run", "status"),
    ],
)
def test_a_recorder_sets_a_damaged_run_aside_and_goes_on_with_the_other(
    name: str, sent: list[Message], table: str, column: str, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(Journal(name, owner="recorder")) as journal:
        core = RecorderCore(journal, resume=True)
        for message in sent[:9]:
            core.handle(message.model_copy(update={"run": "other"}))
    _damage(name, table, column, np.random.default_rng(1), LIVE)
    with closing(Journal(name, owner="recorder")) as journal:
        again = RecorderCore(journal, resume=True)
        told = [answer for tick in range(8) for answer in again.handle(Tick(tick / 4))]
        told += again.handle(RunEnd(run=LIVE, k=len(scans(sent)) - 1, t=DWELLS, status="complete", reason=""))
        for message in sent:
            told += again.handle(message.model_copy(update={"run": "other"}))
        found = {row["run"]: row for row in journal.read("SELECT run, status, reason, digest FROM run")}
        whole = journal.read("SELECT digest FROM run WHERE run = ?", [ENDED])[0]["digest"]
    assert found[LIVE]["status"] == "quarantined"
    assert found[LIVE]["digest"] is None
    assert (found["other"]["status"], found["other"]["digest"]) == ("complete", whole)
    assert f"table {table}" in found[LIVE]["reason"]
    assert found[LIVE]["reason"] in caplog.text
    (row,) = [row for row in _runs(name) if row["run"] == LIVE]
    assert (row["status"], row["reason"]) == ("quarantined", found[LIVE]["reason"])


def test_a_run_whose_row_is_damaged_while_it_goes_on_is_set_aside_at_its_end(name: str, sent: list[Message]) -> None:
    """Its recorder does not read it meanwhile, and writes no checksum that fits what was damaged."""
    with closing(Journal(name, owner="recorder")) as journal:
        core = RecorderCore(journal, resume=True)
        of_it = [message.model_copy(update={"run": "other"}) for message in sent]
        for message in of_it[:20]:
            core.handle(message)
        journal.write("UPDATE run SET seed = seed + 1 WHERE run = 'other'")
        for message in of_it[20:-1]:
            core.handle(message)
        with pytest.raises(Damaged, match="run 'other', table run"):
            journal.stored("run", "WHERE run = 'other'")
        told = core.handle(of_it[-1])
        assert [answer.ended for answer in told if isinstance(answer, Checkpoint)] == [True, True]
        row = journal.read("SELECT status, digest FROM run WHERE run = 'other'")
    assert row == [{"status": "quarantined", "digest": None}]


def test_what_a_tick_says_of_other_runs_is_said_when_it_meets_damage(
    name: str, sent: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run ends with a tick, and the row of the next one, which is to be changed in the same tick, is damaged."""
    with closing(Journal(name, owner="recorder")) as journal:
        core = RecorderCore(journal)
        start, *others = [message.model_copy(update={"run": "paced"}) for message in sent]
        core.handle(start.model_copy(update={"rate_hz": 10.0}))
        for message in others[:-2]:
            core.handle(message)
        core.handle(others[-1])
        core.handle(sent[0].model_copy(update={"run": "later"}))
        journal.commit()
        journal.write("UPDATE run SET seed = seed + 1 WHERE run = 'later'")
        journal._running.clear()
        monkeypatch.setattr(RecordedRun, "forgive", lambda run: run.start.run == "later" and "paced" not in core._runs)
        told = [answer for tick in range(40) for answer in core.handle(Tick(tick / 4))]
        assert {answer.run for answer in told if isinstance(answer, Checkpoint) and answer.ended} == {"paced", "later"}


@pytest.mark.parametrize("column", ["seed", "acknowledged_k"])
def test_a_damaged_row_never_gets_a_checksum_that_fits(name: str, column: str) -> None:
    """Whatever is written to it once its run is set aside."""
    _damage(name, "run", column, np.random.default_rng(1), LIVE)
    with closing(Journal(name, owner="recorder")) as journal:
        damaged_runs.set_aside(journal)
        journal.quarantine(LIVE, "again")
        with pytest.raises(Damaged, match=f"run '{LIVE}', table run"):
            journal.hinder(LIVE, "late")
        with pytest.raises(Damaged, match=f"run '{LIVE}', table run"):
            journal.add_conflict(LIVE)
        journal.commit()
        (row,) = journal.read("SELECT * FROM run WHERE run = ?", [LIVE])
    assert (row["status"], row["reason"]) == ("quarantined", "again")
    assert sealed("run", row)["checksum"] != row["checksum"]


def _runs(name: str) -> list[dict[str, Any]]:
    with closing(Store(Journal(name, read_only=True))) as store:
        return answer(store, "runs", {})


def test_a_message_that_is_damaged_when_it_is_recalled_ends_its_run(name: str) -> None:
    with closing(Journal(name, owner="recorder")) as journal:
        core = RecorderCore(journal, resume=True)
        journal.write("UPDATE message SET checksum = checksum + 1 WHERE run = ? AND k = 3 AND topic = 'waveform'", LIVE)
        journal.commit()
        told = core.handle(WaveformRecall(run=LIVE, k=3))
        assert [answer.ended for answer in told if isinstance(answer, Checkpoint)]
        assert journal.read("SELECT status FROM run WHERE run = ?", [LIVE]) == [{"status": "quarantined"}]
        journal.write("UPDATE message SET checksum = checksum + 1 WHERE run = ? AND k = 3", ENDED)
        assert core.handle(WaveformRecall(run=ENDED, k=3)) == []
        assert journal.read("SELECT status FROM run WHERE run = ?", [ENDED]) == [{"status": "quarantined"}]


def test_a_snapshot_that_is_damaged_is_not_believed(name: str) -> None:
    _damage(name, "snapshot", "payload", np.random.default_rng(1))
    with closing(Journal(name, read_only=True)) as journal, pytest.raises(Damaged, match="track 1, dwell 5"):
        journal.snapshot(LIVE, 1, 0)


def test_what_is_damaged_and_no_single_run_s_holds_all_runs(name: str) -> None:
    _damage(name, "leader", "name", np.random.default_rng(1))
    with closing(Journal(name, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        assert "table leader" in core.trouble
        assert core.trouble.endswith("all runs are held")
        journal.write("DELETE FROM leader")
        journal.commit()
        for tick in range(LOOK_TICKS + 1):
            core.handle(Tick(float(tick)))
        assert core.trouble == ""


# Commands, and questions.


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_names_what_is_damaged_and_what_to_do(name: str, command: str, tmp_path: Path) -> None:
    _damage(name, "message", "payload", np.random.default_rng(2), ENDED)
    values = {"store": name, "run": ENDED, "out": str(tmp_path / "out")}
    done = CliRunner().invoke(app, [part.format(**values) for part in COMMANDS[command]])
    assert done.exit_code == 2, done.output
    said = " ".join(done.output.split())
    assert f"run '{ENDED}', table message, dwell " in said
    assert name.partition("?")[0] in said.replace(" ", "")
    assert ("store copy --intact" if command == "check" else "store check") in said
    assert "Traceback" not in said


@pytest.mark.parametrize("table", SCORES)
def test_a_report_believes_no_score_that_was_changed(name: str, table: str) -> None:
    _damage(name, table, "k", np.random.default_rng(3))
    done = CliRunner().invoke(app, ["report", "--run", KEPT, name])
    assert done.exit_code == 2, done.output
    assert f"run '{KEPT}', tables score and picture" in " ".join(done.output.split())
    assert done.stdout == ""


@pytest.mark.parametrize(("table", "column"), [("score", "k"), ("run", "seed"), ("run", "document")])
def test_reports_are_of_the_other_runs_and_name_the_damaged_one(
    name: str, table: str, column: str, tmp_path: Path
) -> None:
    """Of two equal runs the newer one is damaged: the older one counts then."""
    _damage(name, table, column, np.random.default_rng(3), KEPT)
    done = CliRunner().invoke(app, ["report", "--json", name])
    assert done.exit_code == 2, done.output
    assert json.loads(done.stdout)["first"]["digest"] == _digest(name, ENDED)
    said = " ".join(done.stderr.split())
    assert f"run '{KEPT}', table" in said
    assert (said.count(f"run {KEPT!r}"), said.count("store check"), said.endswith("left out: 1")) == (1, 1, True)
    page = tmp_path / "page.md"
    page.write_text("<!-- report -->\n")
    into = CliRunner().invoke(app, ["report", "--into", str(page), name])
    assert (into.exit_code, into.stdout, page.read_text()) == (2, "", "<!-- report -->\n")
    other = CliRunner().invoke(app, ["report", "--run", ENDED, name])
    assert (other.exit_code, other.stderr) == (0, "")


@pytest.mark.parametrize(("table", "column"), [("score", "k"), ("run", "document")])
def test_figures_are_of_the_other_runs_too(name: str, table: str, column: str, tmp_path: Path) -> None:
    _damage(name, table, column, np.random.default_rng(3), KEPT)
    drawn = CliRunner().invoke(app, ["figures", "--out", str(tmp_path / "figures"), name])
    assert (drawn.exit_code, drawn.stderr.split()[:2]) == (2, ["left", "out:"])
    assert list((tmp_path / "figures").glob("*.png"))


def _digest(name: str, run: str) -> str:
    (found,) = [row["digest"] for row in _runs(name) if row["run"] == run]
    return str(found)


def test_the_runs_that_are_intact_can_be_copied(name: str, tmp_path: Path) -> None:
    _damage(name, "message", "payload", np.random.default_rng(2), ENDED)
    target = str(tmp_path / "saved.db")
    done = CliRunner().invoke(app, ["store", "copy", "--intact", name, target])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert ("left out: " in said, f"run '{ENDED}', table message, dwell " in said) == (True, True)
    assert [row["run"] for row in rows(target, "SELECT run FROM run ORDER BY place")] == [LIVE, KEPT]
    assert check(target) == []
    done = CliRunner().invoke(app, ["store", "check", target])
    assert (done.exit_code, "2 runs, all as they were written" in " ".join(done.output.split())) == (0, True)


@pytest.mark.parametrize("table", ["leader", "campaign"])
def test_runs_can_be_saved_from_a_store_that_no_recorder_can_lead(name: str, table: str, tmp_path: Path) -> None:
    _damage(name, table, {"leader": "name", "campaign": "document"}[table], np.random.default_rng(1))
    target = str(tmp_path / "saved.db")
    with pytest.raises(Damaged, match=f"table {table}"):
        copy(name, target)
    copy(name, target, only_intact=True)
    assert check(target) == []
    assert {row["run"] for row in rows(target, "SELECT run FROM run")} == {LIVE, ENDED, KEPT}
    with closing(Journal(target, owner="recorder")) as journal:
        assert Recorder(journal, resume=True).trouble == ""


def test_damage_of_no_run_is_blamed_on_none(name: str, sent: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(*_: object) -> None:
        raise damage(name, "database disk image is malformed")

    with closing(Journal(name, owner="recorder")) as journal:
        core = Recorder(journal, resume=True)
        before = journal.read("SELECT run, status FROM run")
        monkeypatch.setattr(RecorderCore, "_take", damaged)
        core.handle([one for one in sent if isinstance(one, Scan)][-1].model_copy(update={"run": LIVE}))
        assert core.trouble.endswith("all runs are held")
        assert journal.read("SELECT run, status FROM run") == before


def test_other_runs_are_answered_and_the_damaged_one_is_shown_as_such(name: str) -> None:
    _damage(name, "message", "payload", np.random.default_rng(2), ENDED)
    metrics = MetricsCore(name)
    metrics.handle(Tick(0.0))
    assert answer(metrics.store, "p_d", {"run": KEPT})
    with pytest.raises(StoreFailed, match=f"run '{ENDED}', table message"):
        answer(metrics.store, "p_d", {"run": ENDED})
    found = {row["run"]: row["status"] for row in answer(metrics.store, "runs", {})}
    assert (found[ENDED], found[KEPT]) == ("quarantined", "complete")
    metrics.close()


@pytest.mark.parametrize(
    ("of", "runs"),
    [
        ("", set()),
        ("run", set()),
        ("sqlite_autoindex_run_2", {LIVE, ENDED, KEPT}),  # the places of runs in the list
        ("sqlite_autoindex_dropped_1", {LIVE, ENDED, KEPT}),
    ],
)
def test_a_page_that_sqlite_cannot_read_costs_what_is_on_it_and_is_said_with_what_to_do(
    sent: list[Message], tmp_path: Path, of: str, runs: set[str]
) -> None:
    path = tmp_path / "runs.db"
    _fill(str(path), sent)
    with closing(sqlite3.connect(path)) as db:
        ((size,),) = db.execute("PRAGMA page_size")
        page = next((root for (root,) in db.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", [of])), 1)
    content = bytearray(path.read_bytes())
    content[(page - 1) * size + 100 * (page == 1) : page * size] = bytes(size - 100 * (page == 1))
    path.write_bytes(content)
    saved = str(tmp_path / "saved.db")
    for command in (["check", str(path)], ["copy", "--intact", str(path), saved]):
        done = CliRunner().invoke(app, ["store", *command])
        said = " ".join(done.output.split())
        assert "Traceback" not in said
        assert "store check" not in said  # no command advises itself
        if runs and command[0] == "copy":
            assert done.exit_code == 0, said
            assert {row["run"] for row in rows(saved, "SELECT run FROM run")} == runs
            assert check(saved) == []
        else:
            assert done.exit_code == 2, said
            assert ("copy --intact" if runs else ".recover` may find") in said
            assert f"': {path}" not in said  # once is enough
