"""A sync that fails: what the system holds of the log then may never reach the disk, though every process reads it."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.sqlite import SqliteConnection
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message
from tests.services.loop import play, smoke_start


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=60))


def _log(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


@pytest.mark.parametrize("is_followed", [False, True])
def test_what_is_acknowledged_after_a_sync_that_failed_is_on_the_disk(
    tmp_path: Path, sent: list[Message], is_followed: bool
) -> None:
    """The recorder ends with such an error, and the log stays as long as another process reads the journal. Its
    successor finds the transaction in the log, and would put its own ones behind what a power cut takes away.
    """
    path, cut = tmp_path / "runs.db", tmp_path / "cut.db"
    journal = Journal(str(path), owner="recorder")
    core = Recorder(journal)
    for message in sent[:40]:
        core.handle(message)
    journal.commit()
    synced = _log(path).stat().st_size
    for message in sent[40:80]:
        core.handle(message)
    journal.commit()  # of which the system says that it failed
    lost = _log(path).read_bytes()[synced:]
    assert lost
    follower = Journal(str(path), read_only=True) if is_followed else None
    if follower is not None:
        follower.read("SELECT run FROM run")
    for end in ("", "-wal", "-shm", ".lock"):  # the process is gone, and has not put its log into the file
        if (file := tmp_path / f"runs.db{end}").exists() and not is_followed:
            shutil.copyfile(file, tmp_path / f"next.db{end}")
    if is_followed:
        connection = journal._connection
        assert isinstance(connection, SqliteConnection)
        connection.lose_lock()  # as the end of the process does
    name = path if is_followed else tmp_path / "next.db"
    with closing(Journal(str(name), owner="recorder")) as after:
        again, k = Recorder(after, resume=True), 0
        for message in sent[60:-1]:
            k = max([k, *(one.k for one in again.handle(message) if isinstance(one, Checkpoint))])
        for tick in range(8):
            k = max([k, *(one.k for one in again.handle(Tick(tick / 4)) if isinstance(one, Checkpoint))])
        assert k > 0
        for end in ("", "-wal"):
            shutil.copyfile(f"{name}{end}", f"{cut}{end}")
        if follower is not None:
            follower.close()
    content = _log(cut).read_bytes()
    if content[synced : synced + len(lost)] == lost:
        _log(cut).write_bytes(content[:synced] + bytes(len(lost)) + content[synced + len(lost) :])
    with closing(sqlite3.connect(cut)) as db:
        ((acknowledged,),) = db.execute("SELECT acknowledged_k FROM run")
    assert acknowledged >= k
    journal.close()
