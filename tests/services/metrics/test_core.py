"""The metrics service: it follows a journal that somebody else writes, wherever that is in its life."""

import json
from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.metrics.core import COMMANDED_S, MAX_COMMANDS, MetricsCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Command, Message
from cogradar.shared.protocol.orders import PowerLimit
from tests.services.loop import play, smoke_start

DWELLS = 40


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def _n(core: MetricsCore) -> list[int]:
    return [row["n"] for row in json.loads(core.answer("p_d", {}))]


def test_it_waits_for_a_file_that_is_not_there_yet(sent: list[Message], tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    core = MetricsCore(str(path))
    assert json.loads(core.answer("runs", {"run": "r"})) == []
    path.touch()
    assert core.handle(Tick(0.0)) == ()
    assert json.loads(core.answer("p_d", {})) == []
    path.unlink()
    journal = Journal(str(path))
    RecorderCore(journal).handle(sent[0])
    core.handle(Tick(0.25))
    assert [row["run"] for row in json.loads(core.answer("runs", {}))] == ["r"]
    core.close()
    journal.close()


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "text.db"
    path.write_text("dear diary, " * 200)
    with pytest.raises(BadInput, match=r"text\.db"):
        MetricsCore(str(path))


def test_it_answers_of_the_present_and_a_restarted_one_of_the_past(sent: list[Message], tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    recorder, core = RecorderCore(journal), MetricsCore(path)
    seen: list[int] = []
    for message in sent:
        for answer in recorder.handle(message):
            if type(answer) is Checkpoint:
                assert core.handle(answer) == ()
                seen += _n(core)[:1]
                with closing(MetricsCore(path)) as restarted:
                    assert _n(restarted)[:1] == _n(core)[:1]
    assert seen == sorted(seen)
    assert seen[-1] == DWELLS
    assert len(set(seen)) >= 3
    core.close()
    journal.close()


def test_a_checkpoint_scores_some_dwells_and_a_question_all(
    sent: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cogradar.services.metrics.core.FOLLOW_DWELLS", 5)
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    recorder = RecorderCore(journal)
    last = [answer for message in sent for answer in recorder.handle(message)][-2]
    core = MetricsCore(path)
    core.handle(last)
    assert core.store.read("SELECT MAX(k) AS k FROM score") == [{"k": 4}]
    assert _n(core) == [DWELLS, DWELLS]
    core.close()
    journal.close()


def test_the_past_is_scored_while_nobody_asks(
    sent: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cogradar.services.metrics.core.FOLLOW_DWELLS", 30)
    path = str(tmp_path / "runs.db")
    for run in ("old", "new"):
        journal = Journal(path)
        recorder = RecorderCore(journal)
        for message in sent:
            recorder.handle(message.model_copy(update={"run": run}))
        journal.close()
    core, seen = MetricsCore(path), []
    while core.has_deferred:
        core.handle(Tick(0.0))
        seen.append({row["run"]: row["k"] for row in core.store.read("SELECT run, MAX(k) AS k FROM score GROUP BY 1")})
    assert [sorted(runs) for runs in seen] == [["new"], ["new"], ["new", "old"], ["new", "old"]]
    assert len(set(seen[-1].values())) == 1
    core.close()


def test_a_file_that_is_put_in_the_place_of_another_is_opened(sent: list[Message], tmp_path: Path) -> None:
    path, other = str(tmp_path / "runs.db"), str(tmp_path / "other.db")
    for file, n in ((path, len(sent)), (other, 1)):
        journal = Journal(file)
        recorder = RecorderCore(journal)
        for message in sent[:n]:
            recorder.handle(message)
        journal.close()
    core = MetricsCore(path)
    assert _n(core) == [DWELLS, DWELLS]
    Path(other).replace(path)
    assert _n(core) == []
    core.close()


def test_commands_wait_for_the_recorder_and_those_that_are_too_many_are_refused(
    sent: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    RecorderCore(journal).handle(sent[0])
    core = MetricsCore(path)
    commands = [
        Command(run="r", id=f"{n:032x}", by="me", action=PowerLimit(share=0.5)) for n in range(MAX_COMMANDS + 1)
    ]
    assert [core.command(one) for one in commands[:3]] == [True] * 3
    assert core.handle(Tick(0.0)) == tuple(commands[:3])
    assert [core.command(one) for one in commands[3:]] == [True] * (MAX_COMMANDS - 3) + [False]
    assert core.handle(Tick(0.25)) == tuple(commands[:MAX_COMMANDS])

    def fails(*_: object) -> None:
        raise StoreFailed("runs.db: disk I/O error")

    with monkeypatch.context() as broken:
        broken.setattr(core.store, "read", fails)
        assert len(core.handle(Tick(0.5))) == MAX_COMMANDS
    assert core.handle(Tick(0.5 + COMMANDED_S)) == ()
    assert core.command(commands[-1])
    core.close()
    journal.close()
