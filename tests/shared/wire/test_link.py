"""A link that is up and carries nothing is noticed, and its process ends: what starts it again gives it a new one."""

import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import pytest
import zenoh

from cogradar.services.errors import Unheard
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.topics import ALIVE, PROTOCOL, Role
from cogradar.shared.wire import session
from cogradar.shared.wire.session import Link, open_session, run_router

pytestmark = pytest.mark.zenoh
KEY = ALIVE.format(protocol=PROTOCOL, build=build(), role=Role.ALLOCATOR, name="a")
WITHIN_S = 20.0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "ASK_S", 0.1)
    monkeypatch.setattr(session, "UNSEEN_ASKS", 20)
    monkeypatch.setattr(session, "SILENT_ASKS", 40)


@pytest.fixture
def connected(router: str) -> Iterator[zenoh.Session]:
    opened = open_session([router], WITHIN_S, lambda: None)
    yield opened
    opened.close()


def _until(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + WITHIN_S
    while not holds():
        assert time.monotonic() < until_s
        time.sleep(0.02)


def _broken(watched: Link, seconds: float) -> bool:
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if watched.is_broken():
            return True
        time.sleep(0.02)
    return False


def _known(watched: Link) -> bool:
    return not watched.is_broken() and watched._known != ""


def test_a_process_that_the_router_sees_is_heard_and_one_whose_token_it_lost_is_not(connected: zenoh.Session) -> None:
    token = connected.liveliness().declare_token(KEY)
    watched = Link(connected, Role.ALLOCATOR, "a")
    _until(lambda: _known(watched))
    assert not _broken(watched, 3.0)
    token.undeclare()
    assert _broken(watched, WITHIN_S)


def test_the_token_of_another_process_is_none_of_this_one(connected: zenoh.Session) -> None:
    own = connected.liveliness().declare_token(KEY)
    watched = Link(connected, Role.ALLOCATOR, "a")
    _until(lambda: _known(watched))
    others = [connected.liveliness().declare_token(KEY.removesuffix("/a") + name) for name in ("/b", "/aa", "/a-0")]
    own.undeclare()
    assert _broken(watched, WITHIN_S)
    assert len(others) == 3


def test_a_router_that_is_silent_is_given_more_time(connected: zenoh.Session, monkeypatch: pytest.MonkeyPatch) -> None:
    token = connected.liveliness().declare_token(KEY)
    watched = Link(connected, Role.ALLOCATOR, "a")
    _until(lambda: _known(watched))
    for word in ("SEEN", "UNSEEN"):
        monkeypatch.setattr(session, word, "what this process does not know")
    assert _broken(watched, WITHIN_S)
    assert (watched._n_unseen, watched._n_silent) == (0, session.SILENT_ASKS)
    watched = Link(connected, Role.ALLOCATOR, "a")
    watched._known = "another router, which answered from behind this one"
    assert not _broken(watched, 4.0)
    token.undeclare()


def test_a_slow_link_is_none_that_is_broken(router: str) -> None:
    """Answers take longer than it is from one question to the next."""
    with _Slow(router) as slow:
        opened = open_session([slow.endpoint], WITHIN_S, lambda: None)
        token = opened.liveliness().declare_token(KEY)
        watched = Link(opened, Role.ALLOCATOR, "a")
        _until(lambda: _known(watched))
        slow.delay_s = 0.25
        assert not _broken(watched, 5.0)
        token.undeclare()
        assert _broken(watched, WITHIN_S)
        opened.close()


class _Slow(ExitStack):
    """An endpoint from which bytes reach the router, and back, so much later."""

    def __init__(self, router: str) -> None:
        super().__init__()
        self.delay_s = 0.0
        self._router = router.removeprefix("tcp/").split(":")
        self._server = self.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._begin(self._accept)

    def _begin(self, work: Callable[..., None], *given: object) -> None:
        thread = threading.Thread(target=work, args=given)
        thread.start()
        self.callback(thread.join)

    def _accept(self) -> None:
        self._server.settimeout(WITHIN_S)
        client, _ = self._server.accept()  # the one session of the test
        host, port = self._router
        behind = self.enter_context(socket.create_connection((host, int(port))))
        self.enter_context(client)
        for source, target in ((client, behind), (behind, client)):
            self._begin(self._forward, source, target)

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        waiting: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()

        def send() -> None:
            with suppress(OSError):
                while (item := waiting.get())[1]:
                    time.sleep(max(0.0, item[0] - time.monotonic()))
                    target.sendall(item[1])
                target.shutdown(socket.SHUT_WR)

        self._begin(send)
        found = b"-"
        while found:
            try:
                found = source.recv(65536)
            except OSError:
                found = b""
            waiting.put((time.monotonic() + self.delay_s, found))


def test_a_router_that_is_none_of_ours_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_hear", lambda _: None)
    stop, endpoint = threading.Event(), f"tcp/127.0.0.1:{session.free_port()}"
    thread = threading.Thread(target=run_router, args=(endpoint, stop))
    thread.start()
    opened = open_session([endpoint], WITHIN_S, lambda: None)
    assert not _broken(Link(opened, Role.ALLOCATOR, "a"), 3.0)
    opened.close()
    stop.set()
    thread.join()


def test_without_a_router_there_is_no_link_that_could_be_broken() -> None:
    endpoint = f"tcp/127.0.0.1:{session.free_port()}"

    def routing() -> tuple[threading.Thread, threading.Event]:
        stop = threading.Event()
        thread = threading.Thread(target=run_router, args=(endpoint, stop))
        thread.start()
        return thread, stop

    thread, stop = routing()
    opened = open_session([endpoint], WITHIN_S, lambda: None)
    token = opened.liveliness().declare_token(KEY)
    watched = Link(opened, Role.ALLOCATOR, "a")
    _until(lambda: _known(watched))
    stop.set()
    thread.join()
    assert not _broken(watched, 3.0)
    thread, stop = routing()
    assert not _broken(watched, 5.0)  # connected again
    assert opened.info.routers_zid()
    token.undeclare()
    opened.close()
    stop.set()
    thread.join()


def test_a_process_that_is_not_heard_ends_and_says_why(router: str, monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-m", "cogradar", "service", "allocator", "--name", "a", "--connect", router]
    probe = open_session([router], WITHIN_S, lambda: None)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            until_s = time.monotonic() + 120.0
            while not [reply for reply in probe.liveliness().get(KEY, timeout=1.0) if reply.ok is not None]:
                assert time.monotonic() < until_s
                time.sleep(0.1)
            time.sleep(3.0 * 2.0)  # it asks every two seconds, and was told that it is seen
            monkeypatch.setattr(session, "SEEN", session.UNSEEN)  # of this router
            _, said = process.communicate(timeout=60.0)
        finally:
            process.kill()
    probe.close()
    assert process.returncode == Unheard.exit_code
    assert said.splitlines()[-1].endswith("the router does not see a any more, though the link to it is up: a ends")
