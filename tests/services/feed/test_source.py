"""Which run the feed follows, of those that it hears of."""

import itertools
import time
from collections.abc import Iterator, Sequence
from typing import Any, cast

import pytest

from cogradar.services.feed.picture import Wanted
from cogradar.services.feed.source import _Followed
from cogradar.shared.protocol.messages import Checkpoint, Message
from cogradar.shared.wire.session import Session
from cogradar.shared.wire.zenoh_bus import Listener
from tests.services.feed.made import SITE
from tests.services.loop import checkpoint, plans, play, smoke_start, waveforms


class _Listener:
    """Hears what a script says, one lot after the other, and then nothing."""

    def __init__(self, lots: Sequence[Sequence[Message]]) -> None:
        self._lots = iter(lots)

    def receive(self, _timeout_s: float) -> Iterator[Message]:
        time.sleep(0.01)
        return iter(next(self._lots, ()))


class _Done(Exception):
    pass


def _of(run: str, k: int = 0, *, ended: bool = False) -> Checkpoint:
    return checkpoint(smoke_start(run=run), k, 0, ended=ended)


def _row(run: str) -> dict[str, Any]:
    document = smoke_start(run=run).scenario | {"site": SITE.model_dump()}
    return {"run": run, "status": "running", "document": document}


def _followed(
    lots: Sequence[Sequence[Message]], monkeypatch: pytest.MonkeyPatch, newest: str | None = None, answer_s: float = 0.0
) -> tuple[list[str], _Followed]:
    """What the feed says of the runs that it hears of, and what it holds at the end."""
    said, looks = list[str](), itertools.count()

    def row(_: _Followed, run: str | None, *_within_s: float) -> dict[str, Any] | None:
        time.sleep(answer_s if run else 0.0)
        name = run or newest
        return None if name is None else _row(name)

    def check() -> None:
        if next(looks) > len(lots) + 40:
            raise _Done

    monkeypatch.setattr(_Followed, "_row", row)
    followed = _Followed(cast("Session", object()), None, check, said.append, Wanted())
    with pytest.raises(_Done):
        for _ in followed.pictures(cast("Listener", _Listener(lots))):
            pass
    return said, followed


def test_a_run_that_ends_while_metrics_is_asked_about_it_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    said, followed = _followed([[_of("a")], [_of("a", 4, ended=True)]], monkeypatch, answer_s=0.1)
    assert not any("following" in line for line in said)
    assert followed._now is None


def test_the_newest_run_is_not_left_for_an_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    said, followed = _followed([[_of("older", 32)], [_of("new", 16)], [_of("older", 48)]], monkeypatch, newest="new")
    assert [line for line in said if "following" in line] == ["following new"]
    assert followed._now is not None


def test_a_run_that_begins_is_followed_though_another_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    lots: list[list[Message]] = [[_of("one", 16)], [_of("two")], [], [_of("one", 32)], [_of("two", 2)]]
    said, _ = _followed(lots, monkeypatch, newest="one")
    assert [line for line in said if "following" in line] == ["following one", "following two"]


def test_nothing_is_kept_of_runs_that_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    said = [message for message in _messages() if not isinstance(message, Checkpoint)]
    _, followed = _followed([[_of("r", 1)], [], [_of("r", 3, ended=True)], said, said], monkeypatch)
    assert len(followed._kept) == 0


def _messages() -> list[Message]:
    said = play(smoke_start(dwells=2))
    return [*plans(said), *waveforms(said)]
