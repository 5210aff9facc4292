"""Whose requests are answered: those with the token, not those of other pages, nor too many, nor half ones."""

import socket
import time
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web import app as guarded
from cogradar.services.web.address import TOKEN_FILE_VARIABLE, TOKEN_VARIABLE, Admitted, listen, token
from cogradar.services.web.app import create
from cogradar.services.web.server import Server
from tests.services.web.conftest import FAST_S, ask

TOKEN = "a-token-of-the-radar"  # noqa: S105 - of this test
RUNS = "/api/v1/runs"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        ({"Authorization": f"Bearer {TOKEN}"}, 200),
        ({"Authorization": f"bearer {TOKEN}"}, 200),
        ({"Cookie": f"theme=dark; cogradar={TOKEN}"}, 200),
        ({"Authorization": f"Bearer {TOKEN}x"}, 401),
        ({"Authorization": f"Bearer {TOKEN[:-1]}"}, 401),
        ({"Authorization": f"Basic {TOKEN}"}, 401),
        ({"Cookie": "cogradar="}, 401),
        ({"Cookie": 'cogradar="\\'}, 401),
    ],
)
def test_with_a_token_every_request_needs_it(core: MetricsCore, headers: dict[str, str], status: int) -> None:
    app = create(core, Admitted(None, TOKEN), FAST_S)
    for path in (RUNS, "/", "/page/main.js", "/metrics", f"{RUNS}?token={TOKEN}" if status == 401 else RUNS):
        found = ask(app, path, **headers)
        assert found.status_code == status, path
        assert ("www-authenticate" in found.headers) == (status == 401)
    for path in ("/healthz", "/readyz"):
        assert ask(app, path).status_code == 200


def test_a_browser_shows_the_token_once_and_gets_a_cookie(core: MetricsCore) -> None:
    app = create(core, Admitted(None, TOKEN), FAST_S)
    found = ask(app, f"/?token={TOKEN}")
    assert (found.status_code, found.headers["location"]) == (303, "/")
    cookie = found.headers["set-cookie"]
    assert cookie.startswith(f"cogradar={TOKEN};")
    assert {part.strip().lower() for part in cookie.split(";")} >= {"httponly", "samesite=strict"}
    assert ask(app, "/", Cookie=cookie.partition(";")[0]).status_code == 200
    assert ask(app, f"/?token={TOKEN}x").status_code == 401
    assert ask(create(core, None, FAST_S), "/?token=").status_code == 200  # nobody is asked for one


def test_pages_elsewhere_are_refused(core: MetricsCore) -> None:
    app = create(core, None, FAST_S)
    for origin, status in (("http://radar:8080", 200), ("http://evil.example", 403), ("null", 403), ("http://[", 403)):
        assert ask(app, RUNS, Host="radar:8080", Origin=origin).status_code == status, origin


def test_an_address_elsewhere_may_ask_so_often_and_others_still_may(
    core: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guarded, "BURST", 5.0)
    monkeypatch.setattr(guarded, "RATE_HZ", 0.001)
    guard = guarded._Guard(create(core, None, FAST_S), Admitted(None, is_limited=True))
    found = [guard._has_left("10.0.0.1") for _ in range(8)]
    assert found == 5 * [True] + 3 * [False]
    assert guard._has_left("10.0.0.2")
    for i in range(2 * guarded.MAX_ADDRESSES):
        guard._has_left(f"10.1.{i // 256}.{i % 256}")
    assert len(guard._left) == guarded.MAX_ADDRESSES
    app = create(core, Admitted(None, is_limited=True), FAST_S)
    answers = [ask(app, "/healthz") for _ in range(8)]
    assert [answer.status_code for answer in answers] == 5 * [200] + 3 * [429]
    assert answers[-1].headers["retry-after"] == "1"


def test_half_a_request_is_let_go_and_a_slow_answer_is_not(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guarded, "HEAD_WITHIN_S", 0.3)
    listener = listen("127.0.0.1:0")
    assert listener is not None
    place = listener.getsockname()[:2]
    server = Server(core, listener, FAST_S)
    httpx.get(f"http://{place[0]}:{place[1]}/healthz", timeout=30.0)
    try:
        for sent in (b"", b"GET / HTTP/1.1\r\nHost: local", b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /"):
            began = time.monotonic()  # the server's time begins between this and what is sent
            with socket.create_connection(place, timeout=10.0) as connection:
                connection.sendall(sent)
                while _read(connection):
                    pass
                assert 0.2 < time.monotonic() - began < 5.0
        with socket.create_connection(place, timeout=10.0) as connection:  # a stream: its head has come
            connection.sendall(f"GET {RUNS}/begun/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            began = time.monotonic()
            while time.monotonic() - began < 1.0:
                connection.settimeout(0.2)
                with suppress(TimeoutError):
                    assert connection.recv(1 << 16), "it was let go"
    finally:
        server.close()


def _read(connection: socket.socket) -> bytes:
    try:
        return connection.recv(1 << 16)
    except ConnectionResetError:
        return b""


def test_a_token_is_of_the_environment_or_of_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert token() == ""
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    monkeypatch.setenv(TOKEN_FILE_VARIABLE, str(file))
    assert token() == TOKEN
    for text, said in (
        ("", "must be 16 to 256"),
        ("short", "must be 16 to 256"),
        (f"{TOKEN} two", "must be 16 to 256"),
    ):
        file.write_text(text)
        with pytest.raises(BadInput, match=f"{TOKEN_FILE_VARIABLE}: {file}: {said}"):
            token()
    file.unlink()
    with pytest.raises(BadInput, match=r"(?i)no such file"):
        token()
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    assert token() == TOKEN
    monkeypatch.setenv(TOKEN_VARIABLE, "short")
    with pytest.raises(BadInput, match=f"{TOKEN_VARIABLE}: must be"):
        token()


def test_what_is_open_says_so(core: MetricsCore, caplog: pytest.LogCaptureFixture) -> None:
    for place, given, is_said in (("127.0.0.1:0", "", False), ("0.0.0.0:0", "", True), ("0.0.0.0:0", TOKEN, False)):
        listener = listen(place)
        assert listener is not None
        caplog.clear()
        Server(core, listener, FAST_S, token=given).close()
        assert ("HTTP is open: any client may read every run" in caplog.text) == is_said
