"""Asking from the command line: what comes back, and what each failure turns into."""

import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.errors import BadInput, NoMetrics
from cogradar.services.metrics import client as asking
from cogradar.services.metrics.client import ask_service, source
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.wire.queries import BadRequest, NoAnswer
from cogradar.shared.wire.session import run_router
from tests.services.loop import play, smoke_start

Answer = Callable[[str, dict[str, str]], bytes]


class FakeSession:
    """Stands for a session; remembers where it was opened and whether it was closed."""

    def __init__(self) -> None:
        self.endpoints: list[str] = []
        self.closed = 0

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> Callable[[Answer], FakeSession]:
    """A network on which metrics answers like this."""

    def install(answer: Answer) -> FakeSession:
        session = FakeSession()

        def open_session(endpoints: list[str], *_: Any, **__: Any) -> FakeSession:
            session.endpoints = endpoints
            return session

        def ask(_: FakeSession, metric: str, parameters: dict[str, str], timeout_s: float) -> bytes:
            assert 0.0 < timeout_s <= 10.0
            return answer(metric, parameters)

        monkeypatch.setattr(asking, "open_session", open_session)
        monkeypatch.setattr(asking, "ask", ask)
        return session

    return install


def test_a_service_is_asked_at_every_endpoint_given(answering: Callable[[Answer], FakeSession]) -> None:
    session = answering(lambda metric, parameters: json.dumps([{metric: parameters}]).encode())
    assert ask_service("tcp/a:1,tcp/b:2", "p_d", {"target": "2"}) == [{"p_d": {"target": "2"}}]
    assert (session.endpoints, session.closed) == (["tcp/a:1", "tcp/b:2"], 1)


@pytest.mark.parametrize(
    ("failure", "expected", "words"),
    [
        (NoAnswer("nobody"), NoMetrics, "no metrics service answers at tcp/a:1"),
        (BadRequest("target = '0': must be a number from 1"), BadInput, "target = '0'"),
    ],
)
def test_a_failure_is_told_apart_and_the_session_closed(
    answering: Callable[[Answer], FakeSession], failure: Exception, expected: type[Exception], words: str
) -> None:
    def fail(_: str, __: dict[str, str]) -> bytes:
        raise failure

    session = answering(fail)
    with pytest.raises(expected, match=words):
        ask_service("tcp/a:1", "p_d", {})
    assert session.closed == 1


def test_no_router_is_no_metrics_service(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "CONNECT_WITHIN_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        there = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        for endpoint, words in (
            ("tcp/127.0.0.1:1", "no Zenoh router at tcp/127.0.0.1:1 within 0.1 s: connection refused"),
            (there, f"no Zenoh router at {there} within 0.1 s: what listens there is no Zenoh router"),
            ("tcp/a..b:1", "no Zenoh router at tcp/a..b:1 within 0.1 s: not the name of a host"),
            ("tcp/127.0.0.1", "no Zenoh router at tcp/127.0.0.1 within 0.1 s: no answer"),
            ("somewhere", "somewhere: not an endpoint, such as tcp/127.0.0.1:7447"),
        ):
            with pytest.raises(NoMetrics) as caught:
                ask_service(endpoint, "p_d", {})
            assert str(caught.value) == f"no metrics service: {words}{asking.CURE}"


def test_a_router_that_cannot_listen_says_what_the_system_says() -> None:
    with socket.create_server(("127.0.0.1", 0)) as there:
        endpoint = f"tcp/127.0.0.1:{there.getsockname()[1]}"
        with pytest.raises(ConnectionError) as caught:
            run_router(endpoint, threading.Event())
    assert str(caught.value) == f"cannot listen on {endpoint}: address already in use"


def test_a_store_file_answers_like_the_service_that_follows_it(tmp_path: Path) -> None:
    path = str(tmp_path / "runs.db")
    journal = Journal(path)
    recorder, core = RecorderCore(journal), MetricsCore(path)
    for message in play(smoke_start(dwells=3)):
        recorder.handle(message)
    for metric in ("runs", "tracks", "p_d", "rmse", "summary"):
        with source(path, "") as ask:
            rows = ask(metric, {"strategy": "power-aware"})
        assert rows == json.loads(core.answer(metric, {"strategy": "power-aware"}))
        assert rows
    core.close()
    journal.close()


def test_a_file_that_is_no_store_is_a_bad_query(tmp_path: Path) -> None:
    text = tmp_path / "text.db"
    text.write_text("dear diary, " * 200)
    for path, words in (
        (tmp_path / "nothing.db", "no such file"),
        (tmp_path, "Is a directory"),
        (text, "no store of runs, but a file of another kind"),
    ):
        with pytest.raises(BadInput, match=words) as caught, source(str(path), "") as ask:
            ask("runs", {})
        assert str(path) in str(caught.value)
