"""Which run the feed follows, of those that it hears of."""

import itertools
import threading
import time
from collections.abc import Iterator, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from cogradar.services.errors import NoMetrics
from cogradar.services.feed import source
from cogradar.services.feed.picture import Wanted
from cogradar.services.feed.source import _Connection, _Followed
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

    def close(self) -> None:
        """Nothing is to be closed."""


class _Done(Exception):
    pass


def _heard_by(listener: _Listener) -> _Connection:
    return _Connection(cast("Session", object()), cast("Listener", listener))


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
    followed = _Followed(lambda: _heard_by(_Listener(lots)), None, check, said.append, Wanted())
    with pytest.raises(_Done):
        for _ in followed.pictures():
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


@pytest.mark.parametrize("becomes_of_it", ["it goes on", "it is over", "nobody can be asked"])
def test_a_connection_that_carries_nothing_is_replaced(becomes_of_it: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was seen after a reconnection on a busy machine: a link that was up on both ends, kept alive, and mute."""
    monkeypatch.setattr(source, "SILENT_S", 0.1)
    closed, said, tried, more = list[int](), list[str](), list[int](), _of("a", 5)

    def connect() -> _Connection:
        tried.append(len(tried))
        if len(tried) == 2:
            raise NoMetrics("no router")
        lots = [[_of("a")]] if len(tried) == 1 else [[more]] * 5
        session, listener = SimpleNamespace(close=partial(closed.append, tried[-1])), _Listener(lots)
        return _Connection(cast("Session", session), cast("Listener", listener))

    def row(_: _Followed, run: str | None, *_within_s: float) -> dict[str, Any]:
        if run is not None and becomes_of_it == "nobody can be asked":
            raise NoMetrics("no metrics service")
        return _row("a") | {"status": "complete" if run and becomes_of_it == "it is over" else "running"}

    def check() -> None:
        if len(tried) > 3 or (followed and followed[0]._now is None and closed):
            raise _Done

    monkeypatch.setattr(_Followed, "_row", row)
    followed = list[_Followed]()
    followed.append(_Followed(connect, None, check, said.append, Wanted()))
    with pytest.raises(_Done):
        for _ in followed[0].pictures():
            pass
    silent = "nothing was heard of a for 0.1 s; connecting anew"
    assert said[:2] == ["following a", silent]
    assert closed[0] == 0
    assert said.count(silent) == (1 if becomes_of_it == "it is over" else 2)  # once until it is heard again
    assert len(tried) == (3 if becomes_of_it == "it is over" else 4)


def test_a_run_that_began_meanwhile_is_not_over_with_the_one_that_fell_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both answers of metrics are there at once: that the silent run is over, and that another one goes on."""
    monkeypatch.setattr(source, "SILENT_S", 0.1)
    asked, followed = threading.Event(), list[_Followed]()

    def connect() -> _Connection:
        lots = [[_of("b")]] * 5 if followed else [[_of("a")]]
        session, listener = SimpleNamespace(close=lambda: None), _Listener(lots)
        return _Connection(cast("Session", session), cast("Listener", listener))

    def row(_: _Followed, run: str | None, *_within_s: float) -> dict[str, Any]:
        if run == "a":
            time.sleep(0.1)  # messages of the other one come by the new connection meanwhile
        asked.set() if run == "b" else None
        return _row(run or "a") | {"status": "complete" if run == "a" else "running"}

    def check() -> None:
        if asked.is_set():
            time.sleep(0.05)
            looks.append(1)
        if len(looks) > 3:
            raise _Done

    looks = list[int]()
    monkeypatch.setattr(_Followed, "_row", row)
    followed.append(_Followed(connect, None, check, lambda _: None, Wanted()))
    with pytest.raises(_Done):
        for _ in followed[0].pictures():
            pass
    assert followed[0]._now is not None
    assert followed[0]._now.run == "b"


def test_nothing_is_kept_of_runs_that_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    said = [message for message in _messages() if not isinstance(message, Checkpoint)]
    _, followed = _followed([[_of("r", 1)], [], [_of("r", 3, ended=True)], said, said], monkeypatch)
    assert len(followed._kept) == 0


def _messages() -> list[Message]:
    said = play(smoke_start(dwells=2))
    return [*plans(said), *waveforms(said)]
