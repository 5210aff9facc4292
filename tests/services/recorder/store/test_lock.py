"""One writer per journal: a second one is refused with the name of the first, whatever the command."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from itertools import count
from pathlib import Path
from typing import cast

import pytest

from cogradar.services import process
from cogradar.services.errors import BadInput, InUse
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import sqlite
from cogradar.services.recorder.store.followed import Followed
from cogradar.services.recorder.store.lock import JournalLock, inode_in_use, is_written
from cogradar.services.topology import Start
from cogradar.shared.wire.runner import Core
from tests.services.loop import smoke_start

COGRADAR = [sys.executable, "-m", "cogradar"]


def test_a_second_writer_is_refused_with_the_owner_of_the_first(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    first = Journal(path, owner="recorder-7")
    RecorderCore(first).handle(smoke_start())
    with pytest.raises(BadInput, match=rf"runs\.db: in use by recorder-7 \(process {os.getpid()} on .*, since 20"):
        Journal(path)
    assert first.read("SELECT status FROM run") == [{"status": "running"}]
    first.close()
    Journal(path).close()


def test_the_lock_is_of_the_file_whatever_it_is_called(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    first = Journal(str(path))
    (tmp_path / "other.db").symlink_to(path)
    with pytest.raises(BadInput, match="in use"):
        Journal(str(tmp_path / "other.db"))
    first.close()


def test_one_that_is_refused_makes_no_file_where_it_was_moved_away(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    first = Journal(str(path))
    assert inode_in_use(str(path)) == path.stat().st_ino
    path.rename(tmp_path / "away.db")
    with pytest.raises(InUse):
        Journal(str(path))
    assert not path.exists()
    (tmp_path / "away.db").rename(path)
    first.check_place()
    first.close()


def test_one_that_stands_by_waits_while_the_file_is_away(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Also if its lock was moved away with it."""
    path, lock, looks = tmp_path / "runs.db", tmp_path / "runs.db.lock", count()
    first = Journal(str(path))

    def check() -> None:
        look = next(looks)
        for file in (path, lock) if look in {1, 4} else ():
            away = file.with_name(f"{file.name}-away")
            file.rename(away) if look == 1 else away.rename(file)
        if look == 3:
            assert not path.exists()
        elif look == 5:
            first.close()

    start = Start("recorder-1", store=str(path), check=check)
    made = process._made(lambda start: cast("Core", Journal(start.store)), start)
    cast("Journal", made).close()
    assert next(looks) == 6
    assert caplog.text.count("was removed; this one stands by") == 1


def test_one_that_stands_by_makes_the_file_that_its_holder_died_before_making(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    holder = JournalLock(str(path), "recorder-0")
    start = Start("recorder-1", store=str(path), check=holder.lose)
    made = cast("Journal", process._made(lambda start: cast("Core", Journal(start.store)), start))
    assert path.exists()
    made.close()


def test_one_that_could_never_take_over_is_told_at_once(tmp_path: Path) -> None:
    """The file is of another version: after an upgrade its recorder goes on, of the older program."""
    path = tmp_path / "runs.db"
    Journal(str(path)).close()
    with closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA user_version=3")
    holder = JournalLock(str(path), "recorder-0")
    with pytest.raises(BadInput, match="version 3") as refused:
        Journal(str(path))
    assert not isinstance(refused.value, InUse)
    holder.release()


def test_a_store_below_a_file_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    followed = Followed(str(tmp_path / "file" / "runs.db"))
    assert (followed.identity(), followed.is_lost()) == (None, False)


def test_readers_need_no_lock_and_leave_none(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    writer = Journal(path)
    reader = Journal(path, read_only=True)
    assert reader.read("SELECT * FROM run") == []
    reader.close()
    with pytest.raises(BadInput, match="in use"):
        Journal(path)
    writer.close()
    assert [file.name for file in tmp_path.iterdir()] == ["runs.db"]


def test_who_has_the_lock_is_read_without_the_byte_that_windows_keeps_to_its_holder(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    writer = Journal(path, owner="recorder-7")
    assert (inode_in_use(path), is_written(path)) == (Path(path).stat().st_ino, True)
    with Path(f"{path}.lock").open("r+b") as file:
        file.write(b"\xff")
    assert inode_in_use(path) == Path(path).stat().st_ino
    with pytest.raises(BadInput, match="in use by recorder-7"):
        Journal(path)
    writer.close()
    assert not is_written(path)


def test_the_lock_of_a_process_that_was_killed_is_free(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    program = (
        "import sys, time; from cogradar.services.recorder.journal import Journal; "
        "journal = Journal(sys.argv[1], owner='victim'); print('there', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", program, path], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "there\n"
        with pytest.raises(BadInput, match=rf"in use by victim \(process {process.pid}"):
            Journal(path)
        process.kill()
        process.wait()
    assert json.loads(Path(f"{path}.lock").read_text())["name"] == "victim"  # its file is left, and means nothing
    Journal(path).close()


def test_many_that_want_it_at_once_have_it_one_after_the_other(tmp_path: Path) -> None:
    path, holders, most = str(tmp_path / "runs.db"), list[int](), list[int]()

    def take() -> None:
        for _ in range(20):
            try:
                journal = Journal(path)
            except BadInput:
                continue
            holders.append(1)
            most.append(len(holders))
            time.sleep(0.001)
            holders.pop()
            journal.close()

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(most) == {1}


@pytest.fixture
def busy(tmp_path: Path) -> Iterator[Path]:
    """A file to which a run of another process goes."""
    file = tmp_path / "busy.db"
    command = [*COGRADAR, "run", "smoke", "--in-process", "--dwells", "1000000", "--store", str(file)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        deadline = time.monotonic() + 120
        while not (file.exists() and _running(file)):
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.1)
        yield file
        assert process.poll() is None  # nothing happened to it
        assert _running(file)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)


def _running(file: Path) -> bool:
    try:
        journal = Journal(str(file), read_only=True)
    except BadInput:
        return False
    found = journal.read("SELECT 1 FROM run WHERE status = 'running'")
    journal.close()
    return bool(found)


def test_other_commands_are_refused_and_the_first_run_goes_on(busy: Path) -> None:
    for command in ("run smoke", "run smoke --in-process", "campaign smoke --runs 1"):
        arguments = [*COGRADAR, *command.split(), "--store", str(busy)]
        done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"{busy}: in use by cogradar run (process " in done.stderr


def test_the_log_of_a_file_is_cut_once_a_long_question_is_over(tmp_path: Path) -> None:
    """While somebody reads, as a backup does, all that is written stays in the log; SQLite would keep it as long."""
    file, log = tmp_path / "runs.db", tmp_path / "runs.db-wal"
    with closing(sqlite3.connect(file, isolation_level=None)) as db, closing(sqlite3.connect(file)) as reader:
        sqlite.make(db, str(file))
        reader.execute("BEGIN")
        reader.execute("SELECT * FROM run").fetchall()
        write = "UPDATE leader SET name = ?"
        db.execute("INSERT INTO leader VALUES (1, '', 0)")
        for i in range(3):
            db.execute(write, (str(i) * sqlite.LOG_BYTES,))
        assert log.stat().st_size > 2 * sqlite.LOG_BYTES
        reader.rollback()
        for i in range(3):
            db.execute(write, (str(i),))
        assert log.stat().st_size <= sqlite.LOG_BYTES
