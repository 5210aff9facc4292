"""A recorder that was frozen or cut off while another one took over: it commits nothing more, and ends itself."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from cogradar.services.errors import BadInput, Deposed, NoRoom
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.full_disk import LOOK_TICKS, Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.database import KEPT_LEADERS, Database
from cogradar.services.recorder.store.lock import JournalLock
from cogradar.services.recorder.store.seal import sealed
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.protocol.messages import MAX_LEADS, Checkpoint, Command, Message
from cogradar.shared.protocol.orders import DropTrack, PowerLimit
from cogradar.shared.protocol.recovery import History, WaveformRecall
from tests.services.loop import checkpoint, scans, smoke_start, waveforms
from tests.services.stored import rows

Begin = Callable[..., Recorder]


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A file whose lock does not hold, as that of a machine whose file system over the network was cut off."""
    monkeypatch.setattr(JournalLock, "_take", lambda self, _: os.open(self._path, os.O_RDWR | os.O_CREAT))
    monkeypatch.setattr("cogradar.services.recorder.store.sqlite.displaced", lambda *_: "")
    return str(tmp_path / "runs.db")


@pytest.fixture
def recorder(path: str) -> Iterator[Begin]:
    """Opens a file for a recorder, until the test is over."""
    with ExitStack() as opened:

        def begin(file: str = path, name: str = "recorder-0") -> Recorder:
            journal = opened.enter_context(closing(Journal(file, owner=name)))
            return Recorder(journal, resume=True)

        yield begin


def _epochs(answers: object) -> set[int]:
    assert isinstance(answers, list)
    return {answer.epoch for answer in answers}


def _content(path: str) -> list[tuple[object, ...]]:
    journal = Journal(path, read_only=True)
    queries = "SELECT * FROM run", "SELECT * FROM message", "SELECT * FROM leader"
    rows = [tuple(row) for query in queries for row in journal.rows(query)]
    journal.close()
    return rows


def test_a_deposed_recorder_commits_not_a_byte(path: str, sent: list[Message], recorder: Begin) -> None:
    first = recorder()
    first.handle(smoke_start(dwells=20))
    second = recorder(name="recorder-1")
    before = _content(path)
    with pytest.raises(Deposed, match=r"^recorder-1 has .*runs\.db with epoch \d+, this recorder has epoch \d"):
        first.handle(scans(sent)[0])
    first.close()
    assert _content(path) == before
    assert second.handle(scans(sent)[0]) == ()  # and the other one goes on
    second.close()


def test_it_ends_within_a_second_without_a_message(recorder: Begin) -> None:
    first = recorder()
    for i in range(2 * LOOK_TICKS):
        first.handle(Tick(0.25 * i))
    recorder()
    for i in range(1, LOOK_TICKS):
        first.handle(Tick(10.0 + 0.25 * i))
    with pytest.raises(Deposed):
        first.handle(Tick(11.0))


def test_it_ends_when_it_hears_of_one_that_leads_another_copy_of_the_file(
    path: str, sent: list[Message], recorder: Begin
) -> None:
    """What it had not committed is undone."""
    first, start = recorder(), smoke_start(dwells=20)
    old = _epochs(first.handle(start))
    shutil.copyfile(path, f"{path}.copy")
    shutil.copyfile(f"{path}-wal", f"{path}.copy-wal")
    second = recorder(f"{path}.copy")
    (new,) = _epochs(second.handle(smoke_start(dwells=20, run="other")))
    assert new > max(old)
    assert first.handle(checkpoint(start, epoch=min(old))) == ()  # its own
    assert second.handle(checkpoint(start, epoch=min(old))) == ()  # an older one's
    first.handle(scans(sent)[0])
    with pytest.raises(Deposed, match=r"^another recorder leads r with epoch"):
        first.handle(checkpoint(start, epoch=new))
    first.close()
    assert not [row for row in _content(path) if "scan" in row]


def test_one_that_waits_for_its_disk_ends_too(monkeypatch: pytest.MonkeyPatch, recorder: Begin) -> None:
    first = recorder()
    first.handle(smoke_start())
    monkeypatch.setattr("cogradar.services.recorder.store.sqlite.displaced", lambda *_: "it was removed")
    said = [first.handle(Tick(0.25 * i)) for i in range(LOOK_TICKS)]
    assert [answer.held for answer in said[-1] if isinstance(answer, Checkpoint)] == [True, True]
    assert _epochs(said[-1]) == {first._journal.epoch}
    with pytest.raises(Deposed):
        first.handle(checkpoint(smoke_start(), epoch=first._journal.epoch + 1))


def test_all_that_a_recorder_says_has_its_epoch(sent: list[Message]) -> None:
    recorder = Recorder(Journal(":memory:"))
    answers = [answer for message in sent for answer in recorder.handle(message)]
    answers += recorder.handle(WaveformRecall(run="r", k=waveforms(sent)[3].k))
    assert {type(answer) for answer in answers} >= {Checkpoint, History}
    assert _epochs(answers) == {recorder._journal.epoch}
    assert recorder._journal.epoch > 0


def test_checkpoints_say_how_far_a_run_is_and_was_when_each_epoch_began(sent: list[Message]) -> None:
    """Dwells and commands. A recorder that had no room for a while has a new epoch: what comes back may be older."""
    journal, said = Journal(":memory:"), dict[tuple[int, int, tuple[int, ...]], None]()  # in their order, each once

    def note(answers: object) -> None:
        assert isinstance(answers, list | tuple)
        told = [one for one in answers if type(one) is Checkpoint]
        assert all(one.leads[-1].epoch == one.epoch == journal.epoch for one in told)
        said.update({(one.k, one.revision, tuple(lead.revision for lead in one.leads)): None for one in told})

    first = Recorder(journal)
    for message in [smoke_start(dwells=300), *sent[1 : sent.index(waveforms(sent)[3]) + 1]]:
        note(first.handle(message))
    note([*first.handle(Tick(0.0)), *first.handle(Tick(0.25))])
    note(first.handle(Command(run="r", id="0" * 32, by="somebody", action=PowerLimit(share=0.5))))
    assert [*said] == [(0, 0, (0,)), (4, 4, (0,)), (4, 5, (0,))]
    first.handle(Command(run="r", id="1" * 32, by="somebody", action=DropTrack(track=7)))  # refused: it counts, too
    note([answer for i in range(8) for answer in first.handle(Tick(0.5 + 0.25 * i))])
    assert [*said][3:] == [(4, 6, (0,))]
    said.clear()
    before = journal.epoch
    first._end(NoRoom("full"))
    note(first._held())
    first._begin()
    note(first.lead())
    assert [*said] == [(4, 6, (0,)), (4, 6, (0, 6))]
    assert journal.epoch > before


def test_a_recorder_that_has_room_again_says_first_how_far_its_runs_are(sent: list[Message]) -> None:
    """What comes back may be older. In real time no dwell is repeated, and nothing is said."""
    recorder = Recorder(Journal(":memory:"))
    for message in [smoke_start(dwells=300), *sent[1 : sent.index(waveforms(sent)[3]) + 1]]:
        recorder.handle(message)
    recorder.handle(smoke_start(run="by-the-clock").model_copy(update={"rate_hz": 10.0}))
    before = recorder.epoch
    recorder._end(NoRoom("full"))
    said = [answer for i in range(LOOK_TICKS) for answer in recorder.handle(Tick(1.0 + 0.25 * i))]
    assert {(type(one).__name__, one.run, one.epoch > before) for one in said if isinstance(one, Checkpoint)} == {
        ("Checkpoint", "r", True),
        ("EmulatorCheckpoint", "r", True),
    }


def test_the_last_epochs_of_a_run_are_kept(sent: list[Message]) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for message in [smoke_start(dwells=300), *sent[1 : sent.index(waveforms(sent)[3]) + 1]]:
        core.handle(message)
    core.handle(Tick(0.0)), core.handle(Tick(0.25))
    found = []
    for _ in range(MAX_LEADS):
        (told, *_) = RecorderCore(journal, resume=True).lead()
        assert isinstance(told, Checkpoint)
        assert told.leads[-1].epoch == journal.epoch
        found.append([lead.revision for lead in told.leads])
    assert found == [[0] + n * [4] for n in range(1, MAX_LEADS)] + [MAX_LEADS * [4]]


def test_what_is_no_list_of_epochs_sets_its_run_aside(recorder: Begin) -> None:
    first = recorder()
    first.handle(smoke_start())
    first._journal._change("r", leads="[[1]]")
    first.close()
    second = recorder()
    assert second.lead() == []
    ((status, reason),) = second._journal.rows("SELECT status, reason FROM run")
    assert status == "quarantined"
    assert reason


def test_each_recorder_has_a_higher_epoch_whatever_the_clock_says(
    path: str, monkeypatch: pytest.MonkeyPatch, recorder: Begin
) -> None:
    """Also on an older copy, which does not know of the last ones, if the clock is right."""
    found = []
    for now_us in (1000, 5000, 10, 10):
        monkeypatch.setattr(Database, "_now_us", lambda _, now_us=now_us: now_us)
        if now_us == 5000:
            shutil.copyfile(path, f"{path}.old")
        opened = recorder()
        opened.close()
        found.append(opened._journal.epoch)
    assert found == [1000, 5000, 5001, 5002]
    monkeypatch.setattr(Database, "_now_us", lambda _: 9000)
    assert recorder(f"{path}.old")._journal.epoch == 9000


def test_of_many_recorders_the_last_ones_are_kept(path: str) -> None:
    epochs = []
    for _ in range(KEPT_LEADERS + 5):
        journal = Journal(path)
        journal.lead()
        epochs.append(journal.epoch)
        journal.close()
    assert [row["epoch"] for row in rows(path, "SELECT epoch FROM leader")] == epochs[5:] == sorted(epochs[5:])


def test_an_epoch_that_nobody_can_follow_is_refused(path: str, recorder: Begin) -> None:
    journal = Journal(path)
    journal.add_rows("leader", [sealed("leader", {"epoch": MAX_EPOCH, "name": "x"})])
    journal.close()
    with pytest.raises(BadInput, match=r"runs\.db: leader\.epoch = \d+: must be below \d+"):
        recorder()
