"""A journal whose file is taken away, replaced or made read-only: nothing is acknowledged that would be lost."""

import json
import logging
import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.errors import StoreFailed
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Refused
from tests.services.loop import smoke_start

START = smoke_start(dwells=20)
TICKS = 20  # five seconds


def _move(path: Path) -> None:
    path.rename(path.with_name("away.db"))


def _replace(path: Path) -> None:
    shutil.copyfile(path, path.with_name("copy.db"))
    path.with_name("copy.db").replace(path)


DISPLACE: dict[str, tuple[Callable[[Path], None], str]] = {
    "removed": (lambda path: path.unlink(), "run.db was removed"),
    "moved": (_move, "run.db was removed"),
    "replaced": (_replace, "run.db was replaced"),
    "read-only": (lambda path: path.chmod(0o444), "run.db was made read-only"),
    "its log removed": (lambda path: path.with_name("run.db-wal").unlink(), "run.db-wal was removed"),
    "its lock removed": (lambda path: path.with_name("run.db.lock").unlink(), "run.db.lock was removed"),
}
SEEN = ("removed", "moved", "replaced", "read-only")  # by metrics, which only reads


def _begun(path: Path) -> Recorder:
    recorder = Recorder(Journal(str(path)))
    recorder.handle(START)
    return recorder


def _ticks(core: Recorder | MetricsCore, n: int = TICKS) -> list[Checkpoint]:
    answers = [answer for i in range(n) for answer in core.handle(Tick(0.25 * i))]
    return [answer for answer in answers if isinstance(answer, Checkpoint)]


@pytest.mark.parametrize("how", DISPLACE)
def test_runs_are_held_within_five_seconds(how: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "run.db"
    recorder = _begun(path)
    displace, said = DISPLACE[how]
    assert not any(checkpoint.held for checkpoint in _ticks(recorder))
    displace(path)
    with caplog.at_level(logging.ERROR):
        assert any(checkpoint.held for checkpoint in _ticks(recorder))
    assert said in recorder.trouble
    assert caplog.text.count(said) == 1
    assert recorder.measures()["journal_full"] == 1
    with pytest.raises(Refused, match="was "):
        recorder.handle(START.model_copy(update={"run": "other"}))
    recorder.close()


@pytest.mark.parametrize("how", ["moved", "read-only"])
def test_the_same_file_put_back_goes_on(how: str, tmp_path: Path) -> None:
    path = tmp_path / "run.db"
    recorder = _begun(path)
    DISPLACE[how][0](path)
    _ticks(recorder)
    path.chmod(0o644) if how == "read-only" else path.with_name("away.db").rename(path)
    assert not _ticks(recorder)[-1].held
    assert recorder.trouble == ""
    recorder.close()
    with closing(Journal(str(path), read_only=True)) as journal:
        assert journal.unfinished() == [START.run]


def test_another_file_in_its_place_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "run.db"
    recorder = _begun(path)
    other = Journal(str(tmp_path / "other.db"))
    other.close()
    before = (tmp_path / "other.db").read_bytes()
    (tmp_path / "other.db").replace(path)
    _ticks(recorder)
    recorder.close()
    assert path.read_bytes() == before


@pytest.mark.parametrize("how", SEEN)
def test_metrics_says_so(how: str, tmp_path: Path) -> None:
    """Also if no run goes on, of which a checkpoint could say that it is held."""
    path = tmp_path / "run.db"
    recorder = Recorder(Journal(str(path)))
    with closing(MetricsCore(str(path))) as metrics:
        _ticks(metrics)
        assert metrics.trouble == ""
        DISPLACE[how][0](path)
        _ticks(metrics)
        assert DISPLACE[how][1] in metrics.trouble
        assert metrics.trouble.startswith("held: ")
    recorder.close()


@pytest.mark.parametrize("how", ["replaced", "read-only"])
def test_a_journal_that_nobody_writes_is_not_held(how: str, tmp_path: Path) -> None:
    """It is a copy, or is kept where its recorder was killed."""
    path, lock = tmp_path / "run.db", tmp_path / "run.db.lock"
    journal = Journal(str(path))
    left = lock.read_bytes()
    journal.close()
    lock.write_bytes(left)
    DISPLACE[how][0](path)
    with closing(MetricsCore(str(path))) as metrics:
        _ticks(metrics)
        assert metrics.trouble == ""


def test_a_run_in_process_ends_with_the_reason(tmp_path: Path) -> None:
    """There the core has the journal alone, and nobody who would wait."""
    path = tmp_path / "run.db"
    journal = Journal(str(path))
    core = RecorderCore(journal)
    path.unlink()
    with pytest.raises(StoreFailed, match=r"run\.db was removed while it was in use"):
        core.handle(START)
    journal.rollback()
    journal.close()


def test_a_lock_of_another_process_stays(tmp_path: Path) -> None:
    path, lock = tmp_path / "run.db", tmp_path / "run.db.lock"
    first = Journal(str(path))
    lock.unlink()
    second = Journal(str(path), owner="second")
    first.close()
    assert json.loads(lock.read_bytes())["name"] == "second"
    second.close()
    assert not lock.exists()
