"""A store on a server: who may write it, what becomes of those who were cut off, and what is refused."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress

import psycopg
import pytest

from cogradar.services.errors import BadInput, Deposed, InUse, StoreFailed, Unreachable
from cogradar.services.metrics.queries import stored
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.address import Address
from cogradar.services.recorder.store.postgresql import PostgresqlConnection
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message
from tests.postgresql import Server
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


def test_one_that_could_never_take_over_is_told_at_once(postgresql: Server) -> None:
    url = postgresql.url()
    first = Journal(url)
    first.write("UPDATE store SET version = 3")
    first.commit()
    with pytest.raises(BadInput, match="version 3") as refused:
        Journal(url)
    assert not isinstance(refused.value, InUse)
    first.close()


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
