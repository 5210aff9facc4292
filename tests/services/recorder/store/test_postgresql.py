"""A store on a server: who may write it, what becomes of those who were cut off, and what is refused."""

import hashlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import cast

import numpy as np
import psycopg
import pytest
from typer.testing import CliRunner

from cogradar.services import process
from cogradar.services.campaigns.campaign import results_digest
from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput, Deposed, InUse, NoStoreYet, StoreFailed, Unreachable
from cogradar.services.metrics import core as following
from cogradar.services.metrics.answers import METRICS, answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.queries import stored
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import postgresql
from cogradar.services.recorder.store.address import Address, shown
from cogradar.services.recorder.store.copy import _add, copy
from cogradar.services.recorder.store.postgresql import PostgresqlConnection
from cogradar.services.recorder.store.tables import numbered
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.services.topology import Start
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message
from cogradar.shared.protocol.orders import PowerLimit
from cogradar.shared.wire.queries import NotNow
from cogradar.shared.wire.runner import Core
from tests.postgresql import Server, running
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import scans, smoke_start

START = smoke_start(dwells=20)


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def _ended(server: Server, journal: Journal) -> None:
    """Let the server end the session of a journal, as it does with one that is silent for its lease."""
    connection = journal._connection
    assert isinstance(connection, PostgresqlConnection)
    with psycopg.connect(server.url("other").partition("&schema")[0], autocommit=True) as db:
        db.execute("SELECT pg_terminate_backend(%s, 5000)", [connection._db.info.backend_pid])


def test_one_process_writes_and_others_are_told_which(postgresql: Server, opened: ExitStack) -> None:
    url = postgresql.url()
    writer = Journal(url, owner="recorder-7")
    writer.add_run(START)
    with pytest.raises(InUse, match=r"in use by recorder-7 \(process \d+ on .*\), since \d{4}-.* UTC$"):
        Journal(url)
    reader = opened.enter_context(closing(Journal(url, read_only=True)))
    assert reader.start("r") is None
    writer.commit()
    assert reader.start("r") == START
    with pytest.raises(StoreFailed, match="read-only transaction"):
        reader.quarantine("r", "")
    reader.rollback()
    writer.close()
    opened.enter_context(closing(Journal(url)))


def test_what_a_lost_session_had_written_is_gone_and_never_looks_committed(postgresql: Server) -> None:
    journal = Journal(postgresql.url())
    journal.add_run(START)
    _ended(postgresql, journal)
    for _ in range(2):
        with pytest.raises(Unreachable):
            journal.commit()
    journal.rollback()
    with pytest.raises(Unreachable):  # what is there now must be looked at first
        journal.add_run(START)
    journal.check_room()
    assert journal.start("r") is None
    journal.close()


def test_a_transaction_that_has_failed_is_not_taken_for_a_commit(postgresql: Server) -> None:
    journal = Journal(postgresql.url())
    journal.add_run(START)
    with pytest.raises(StoreFailed):
        journal.write("INSERT INTO campaign VALUES (NULL)")
    with pytest.raises(StoreFailed, match="undone"):
        journal.commit()
    assert journal.start("r") is None
    journal.close()


def test_a_recorder_whose_session_the_server_ended_is_deposed(
    postgresql: Server, sent: list[Message], opened: ExitStack
) -> None:
    """It was frozen longer than its lease, in the middle of a transaction, and another one leads."""
    url = postgresql.url()
    first = Recorder(opened.enter_context(closing(Journal(url, owner="recorder-0"))))
    first.handle(START)
    first.handle(scans(sent)[0])
    _ended(postgresql, first._journal)
    second = Recorder(opened.enter_context(closing(Journal(url, owner="recorder-1"))), resume=True)
    first.handle(scans(sent)[1])  # all runs are held
    for i in range(LOOK_TICKS - 1):
        first.handle(Tick(0.25 * i))
    with pytest.raises(Deposed, match="recorder-1 has"):
        first.handle(Tick(1.0))
    assert second._journal.read("SELECT COUNT(*) AS n FROM message") == [{"n": 0}]


def test_without_the_lock_no_commit_comes_after_one_of_a_successor(postgresql: Server, opened: ExitStack) -> None:
    """As behind something that shares sessions: the row of the leader is locked in each transaction."""
    url = postgresql.url()
    journals = list[Journal]()
    for i in range(2):
        journal = opened.enter_context(closing(Journal(url, owner=f"recorder-{i}")))
        journal.rows("SELECT pg_advisory_unlock_all()")
        journals.append(journal)
    first, second = journals
    first.lead()
    first.commit()
    first.add_run(START)  # its transaction is open
    second.rows("SELECT set_config('lock_timeout', '100ms', false)")
    with pytest.raises(Unreachable, match="lock timeout"):
        second.lead()
    second.rollback()
    first.commit()
    second.lead()
    second.commit()
    with pytest.raises(Deposed):
        first.acknowledge("r", 5, 3, 0)
    assert second.read("SELECT acknowledged_k FROM run") == [{"acknowledged_k": 0}]


_LEADER = """
import sys, time
from cogradar.services.errors import Failure
from cogradar.services.recorder import full_disk
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
full_disk.LEASE_S = 1.0
recorder = full_disk.Recorder(Journal(sys.argv[1], owner="first"))
try:
    for i in range(10**6):
        recorder.handle(Tick(time.monotonic()))
        if i == full_disk.LOOK_TICKS:
            print("leads", flush=True)
        time.sleep(0.05)
except Failure as error:
    sys.exit(error.exit_code)
"""


def test_a_frozen_process_loses_the_store_after_its_lease_and_ends_when_it_wakes(postgresql: Server) -> None:
    url = postgresql.url()
    first = subprocess.Popen([sys.executable, "-c", _LEADER, url], stdout=subprocess.PIPE)
    assert first.stdout is not None
    first.stdout.readline()
    with pytest.raises(BadInput, match="in use by first"):
        Journal(url)
    first.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    while time.monotonic() < began + 30.0:
        with suppress(BadInput):
            second = Journal(url, owner="second")
            break
    recorder = Recorder(second)
    first.send_signal(signal.SIGCONT)
    assert first.wait(30.0) == Deposed.exit_code
    first.stdout.close()
    recorder.close()


def test_a_recorder_that_freezes_while_it_begins_loses_the_store_too(
    postgresql: Server, opened: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that is suspended before its first tick: it had the lock for as long as its session lived."""
    monkeypatch.setattr("cogradar.services.recorder.full_disk.LEASE_S", 1.0)
    monkeypatch.setattr("cogradar.services.recorder.store.postgresql.TAKE_WITHIN_S", 5.0)
    url = postgresql.url()
    frozen = Recorder(opened.enter_context(closing(Journal(url, owner="recorder-7"))))
    successor = Recorder(opened.enter_context(closing(Journal(url, owner="recorder-8"))))
    assert (frozen.trouble, successor.trouble) == ("", "")
    assert frozen.epoch < successor.epoch


def test_a_run_has_the_same_digest_and_scores_bit_for_bit(postgresql: Server) -> None:
    url, alone = postgresql.url(), in_process.play(START)
    with closing(Store(Journal(url))) as store:
        played = in_process.play(START, store=store)
    assert (played.run["digest"], played.targets, played.picture) == (
        alone.run["digest"],
        alone.targets,
        alone.picture,
    )
    with closing(Store(Journal(url, read_only=True))) as reader:
        assert answer(reader, "summary", {})[0]["run"] == "r"
        assert reader.journal.n_byte() > 0


def test_what_a_campaign_has_kept_is_answered_the_same(postgresql: Server, tmp_path: Path) -> None:
    played = in_memory()
    in_process.play(START, store=played)
    recording = take(played, "r")
    assert recording is not None
    found = []
    filters: list[dict[str, str]] = [
        {},
        {"strategy": START.strategy},
        {"seed": str(START.seed)},
        {"scenario": START.scenario["name"]},
    ]
    for name in (str(tmp_path / "c.db"), postgresql.url()):
        with closing(Journal(name)) as journal:
            journal.add_recording(recording, 7)
            journal.add_recording(recording, 8)  # it is there
        with closing(Store(Journal(name, read_only=True))) as store:
            answers = [answer(store, metric, {"run": "all"} | asked) for metric in METRICS for asked in filters]
            found.append((answers, results_digest(store), store.read("SELECT place FROM run")))
    assert found[0] == found[1]
    assert found[0][2] == [{"place": 7}]


@pytest.mark.parametrize("mode", ["fast", "immediate"])
def test_a_run_outlives_a_restart_of_the_server(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postgresql, "RETRY_S", 0.0)  # here time passes in ticks, of which a second has thousands
    expected = in_process.play(START).run["digest"]
    with running() as server:
        url = server.url()
        journal = Journal(url)
        network = FaultyNetwork(START, 2, np.random.default_rng(1), journal=journal)
        network.store = Store(Journal(url, read_only=True))

        def restart() -> None:
            server.stop(mode)
            recorder = network.processes["recorder-0"].core
            assert isinstance(recorder, Recorder)
            for i in range(3 * LOOK_TICKS):
                recorder.handle(Tick(100.0 + i))
            assert "all runs are held" in recorder.trouble
            server.start()

        assert play(network, {60: restart, 150: restart}) == expected
        network.store.close()
        journal.close()


def test_one_that_stands_by_outlives_a_restart_of_the_server_and_takes_over(caplog: pytest.LogCaptureFixture) -> None:
    with running() as server:
        first, looks = Journal(server.url("runs")), count()

        def check() -> None:
            look = next(looks)
            if look == 0:
                server.stop()
            elif look == 1:
                server.start()
                first.close()

        start = Start("recorder-1", store=server.url("runs"), check=check)
        cast("Journal", process._made(lambda start: cast("Core", Journal(start.store)), start)).close()
        with pytest.raises(NoStoreYet):  # who has not begun to stand by is refused
            process._made(
                lambda start: cast("Core", Journal(start.store)), replace(start, store=server.url() + "&port=1")
            )
    assert "stands by until it answers again" in caplog.text


def test_one_that_could_never_take_over_is_told_at_once(postgresql: Server) -> None:
    url = postgresql.url()
    first = Journal(url)
    first.write("UPDATE store SET version = 3")
    first.commit()
    with pytest.raises(BadInput, match="version 3") as refused:
        Journal(url)
    assert not isinstance(refused.value, InUse)
    first.close()


@pytest.mark.slow
@pytest.mark.zenoh
def test_real_processes_outlive_a_restart_of_the_server_with_the_same_digest() -> None:
    """Metrics, which asks for progress, and the recorder are cut off; no password is on a command line."""
    start = smoke_start(dwells=200)
    expected = in_process.play(start).run["digest"]
    with running() as server:
        url = server.url().replace("radar@", "radar:hunter2@")
        restarts = iter([None])

        def report(now: Progress) -> None:
            if now.t > 10 and next(restarts, now) is None:
                server.stop("immediate")
                server.start()
                for file in Path("/proc").glob("[0-9]*/cmdline"):
                    with suppress(OSError):  # it ended meanwhile
                        assert b"hunter2" not in file.read_bytes()

        played = cluster.play(
            start, LocalProcesses(2, url), report=report, notify=lambda _: None, stop=threading.Event()
        )
        assert played.run["digest"] == expected
        assert next(restarts, "done") == "done"


def test_a_lease_that_is_set_in_a_transaction_outlives_its_rollback(postgresql: Server) -> None:
    journal = Journal(postgresql.url())
    journal.add_run(START)
    journal.expire_after(10.0)
    journal.rollback()
    assert journal.rows("SHOW idle_session_timeout") == [("10s",)]
    journal.close()


def test_messages_come_in_the_order_of_their_dwells(postgresql: Server) -> None:
    with closing(Store(Journal(postgresql.url()))) as store:
        for k in (3, 1, 2):
            store.journal.add_message("r", k, "scan", 0, b"")
        for way in ("enable_indexscan", "enable_bitmapscan"):  # which would happen to sort them
            store.journal.rows("SELECT set_config(?, 'off', false)", [way])
        assert [row["k"] for row in stored(store, "r", "scan", [3, 2, 1], 0, "k")] == [1, 2, 3]


def test_a_server_that_is_away_at_first_is_told_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "RETRY_S", 0.0)
    with running() as server:
        url = server.url()
        server.stop()
        core = MetricsCore(url)
        for i in range(3):
            core.handle(Tick(1.0 * i))
        assert caplog.text.count("there is no journal yet") == 1
        server.start()
        Journal(url).close()
        core.handle(Tick(9.0))
        assert (core.trouble, core.is_open) == ("", True)
        core.close()


def test_metrics_says_that_a_server_is_away_and_goes_on_when_it_is_back() -> None:
    with running() as server:
        url = server.url()
        Journal(url).close()
        core = MetricsCore(url)
        core.handle(Tick(0.0))
        assert (core.trouble, core.answer("runs", {})) == ("", b"[]")
        server.stop()
        core.handle(Tick(1.0))
        assert core.trouble.startswith(f"held: {shown(url)}: ")
        with pytest.raises(NotNow):
            core.answer("runs", {})
        assert "journal_bytes" not in core.measures()
        server.start()
        time.sleep(0.5)  # until it is asked again
        core.handle(Tick(2.0))
        assert (core.trouble, core.answer("runs", {})) == ("", b"[]")
        assert core.measures()["journal_bytes"]
        core.close()


def test_a_schema_of_something_else_is_refused_and_left_as_it_is(postgresql: Server) -> None:
    url = postgresql.url("theirs")
    with pytest.raises(BadInput, match="no store of runs in schema theirs"):
        Journal(url, read_only=True)
    with psycopg.connect(url.partition("&schema")[0], autocommit=True) as db:
        db.execute("CREATE SCHEMA theirs; CREATE TABLE theirs.person (name TEXT)")
        for read_only in (True, False):
            with pytest.raises(BadInput, match="holds something else"):
                Journal(url, read_only=read_only)
        own = postgresql.url()
        Journal(own).close()
        schema = Address.of(own).schema
        db.execute(f"ALTER TABLE {schema}.run RENAME COLUMN seed TO sown".encode())
        with pytest.raises(BadInput, match="table 'run' is not as version"):
            Journal(own)
        db.execute(f"SET search_path TO {schema}".encode())
        db.execute("UPDATE store SET version = 1")
        with pytest.raises(BadInput, match="store of version 1, this program reads"):
            Journal(own, read_only=True)


def test_stores_are_copied_both_ways_and_only_into_empty_ones(postgresql: Server, tmp_path: Path) -> None:
    file, url, back = str(tmp_path / "a.db"), postgresql.url(), str(tmp_path / "b.db")
    with closing(Store(Journal(file))) as store:
        digest = in_process.play(START, store=store).run["digest"]
        store.journal.set_campaign({"a": "\u00e4"})
    assert copy(file, url) == copy(url, back)
    tables = ("run", "message", "snapshot", "command", "leader", "campaign")
    contents = []
    for name in (file, url, back):
        with closing(Journal(name, read_only=True)) as journal:
            contents.append(
                [[tuple(row) for row in journal.rows(" ".join(["SELECT * FROM", table]))] for table in tables]
            )
    assert sorted(contents[1][1]) == contents[0][1] == contents[2][1]
    assert [c[0] for c in contents] == [contents[0][0]] * 3
    assert digest in contents[0][0][0]
    done = CliRunner().invoke(app, ["store", "copy", file, url])
    assert (done.exit_code, "has rows: copy to a new file or an empty schema" in done.output) == (2, True)


@pytest.mark.parametrize("table", ["run", "command"])
def test_a_text_that_no_server_can_hold_is_refused_and_named(postgresql: Server, tmp_path: Path, table: str) -> None:
    file, url = str(tmp_path / "a.db"), postgresql.url()
    with closing(Journal(file)) as journal:
        journal.add_run(START)
        action = PowerLimit(share=0.5)
        journal.add_command(
            Command(run="r", id="0" * 32, by="me", action=action, at=0), 1, None, "no\0" * (table != "run")
        )
        journal.hinder("r", "late\0" * (table == "run"))
    with pytest.raises(BadInput, match=rf"run 'r', table {table}, column reason: a text with U\+0000"):
        copy(file, url)
    with closing(Journal(url)) as journal:
        assert journal.start("r") is None
    copy(file, str(tmp_path / "b.db"))


def test_values_of_a_row_are_told_apart() -> None:
    rows = [(1, 23), (12, 3), (b"1", 23), ("1", 23), (None, 123)]
    digests = [hashlib.sha256() for _ in rows]
    for digest, row in zip(digests, rows, strict=True):
        _add(digest, [row])
    assert len({digest.digest() for digest in digests}) == len(rows)


def test_a_copy_that_is_interrupted_leaves_nothing(postgresql: Server, tmp_path: Path) -> None:
    file, url = str(tmp_path / "a.db"), postgresql.url()
    with closing(Store(Journal(file))) as store:
        in_process.play(START, store=store)

    def stop(table: str, _: int) -> None:
        if table == "message":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        copy(file, url, stop)
    copy(file, url)


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://radar:hunter2@127.0.0.1:1/db",
        "postgresql://radar@127.0.0.1:1/db?password=hunter2",
        "postgresql://radar:hunter2@127.0.0.1:port/db",
        "postgresql://radar:hunter2@127.0.0.1:1/db?nonsense=1",
        "postgresql://radar:hunter2@127.0.0.1:1/db?schema=Hunter",
        "postgresql://[radar:hunter2@/db",
        *(f"postgresql://radar:hunter2{end}x@127.0.0.1:1/db" for end in ("/", "#", "?", "@", "?schema=")),
        "postgresql://radar:x/hunter2@127.0.0.1:1/db",
    ],
)
def test_no_password_is_said(url: str) -> None:
    done = CliRunner().invoke(app, ["query", "runs", "--store", url])
    assert (done.exit_code, len(done.output.splitlines()), "hunter2" in done.output) == (2, 1, False)


@pytest.mark.parametrize(
    "name",
    [
        "postgresql://radar:hunter2@127.0.0.1:1/db",
        "Recorded:postgresql://radar:hunter2@127.0.0.1:1/db",
        "recorded: postgresql://radar:hunter2@127.0.0.1:1/db",
        "recorded:postgresql:/radar:hunter2@127.0.0.1:1/db",
        "recorded:postgresql://radar@127.0.0.1:1/db?password=top#hunter2",
    ],
)
def test_no_password_of_an_address_at_a_wrong_place_is_said(name: str) -> None:
    done = CliRunner().invoke(app, ["run", "smoke", "--in-process", "--front-end", name])
    assert (done.exit_code, len(done.output.splitlines()), "hunter2" in done.output) == (2, 1, False)


def test_addresses() -> None:
    found = Address.of("postgresql://me:a%40b@h1,h2:5/db?schema=x&sslmode=require")
    assert found.shown == "postgresql://me@h1,h2:5/db?schema=x&sslmode=require"
    assert (found.url, found.schema, found.password) == (
        "postgresql://me:a%40b@h1,h2:5/db?sslmode=require",
        "x",
        "a@b",
    )
    assert Address.of("postgresql://me@h/db?password=a%40b").password == found.password
    local = Address.of("postgres:///db?host=/run/pg&options=-c%20geqo%3Doff&schema=y")
    assert local.url == "postgresql:///db?host=/run/pg&options=-c%20geqo%3Doff"
    assert repr(found) == f"Address({found.shown!r})"
    assert numbered("SELECT * FROM main.score WHERE a = ? AND b = ?") == b"SELECT * FROM score WHERE a = $1 AND b = $2"


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cogradar.services.recorder.store.postgresql", None)
    with pytest.raises(BadInput, match=r"pip install 'cogradar\[postgres\]'"):
        Journal("postgresql://radar@127.0.0.1:1/db")


def test_held_runs_are_told_nothing_that_may_not_be_durable(postgresql: Server) -> None:
    recorder = Recorder(Journal(postgresql.url()))
    (first, *_) = recorder.handle(START)
    assert isinstance(first, Checkpoint)
    _ended(postgresql, recorder._journal)
    said = [one for i in range(LOOK_TICKS) for one in recorder.handle(Tick(0.25 * i))]
    assert said == []
    said = [one for i in range(2 * LOOK_TICKS) for one in recorder.handle(Tick(10.0 + 0.25 * i))]
    assert not recorder.trouble
    recorder.close()
