"""Being one process: what it does when it is told to stop, and what it says when it ends."""

import logging
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from cogradar.services import kernels, process
from cogradar.services.errors import Interrupted
from cogradar.services.topology import SERVICES, Start
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.bus import Inbox
from cogradar.shared.wire.meter import Meter
from cogradar.shared.wire.session import free_port

SETTINGS = {"connect": "tcp/127.0.0.1:1", "listen": "tcp/127.0.0.1:1"}

WATCHED = """
import atexit
from cogradar.services.cli.app import main

class Freed:
    def __del__(self):
        print("freed", flush=True)

held = Freed()
atexit.register(print, "at exit")
main()
"""


class FakeBus:
    """A connection over which some bad messages came."""

    def __init__(self, *_: Any) -> None:
        self.inbox, self.meter, self.closed = Inbox(), Meter(Role.METRICS), 0
        for _i in range(3):
            self.inbox.open("cogradar/10/x/run/r/scan", b"noise")
        self.inbox.open("cogradar/10/run/r/start", b"noise")

    def is_connected(self) -> bool:
        """Nothing is missing."""
        return True

    def serve_queries(self, answer: Callable[..., bytes]) -> None:
        """Metrics answers queries."""

    def serve_timestamps(self, role: Role, name: str) -> None:
        """Every service does."""

    def serve_exposition(self, role: Role, name: str, text: Callable[[], bytes]) -> None:
        """Every service does."""

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize("crash", [False, True])
def test_a_service_says_at_its_end_what_it_dropped(
    crash: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    buses: list[FakeBus] = []

    def bus(*_: Any, **__: Any) -> FakeBus:
        buses.append(FakeBus())
        return buses[-1]

    def serve(*_: Any) -> None:
        if crash:
            raise RuntimeError("a bug")

    monkeypatch.setattr(process, "open_session", lambda *_, **__: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(process, "_check_others", lambda *_: None)
    monkeypatch.setattr(process, "ZenohBus", bus)
    monkeypatch.setattr(process, "serve", serve)
    with caplog.at_level(logging.WARNING, logger="cogradar.services.process"):
        try:
            process.be(Role.METRICS, Start("m", ":memory:"), **SETTINGS, stop=threading.Event())
        except RuntimeError:
            assert crash
    sent = [record.getMessage() for record in caplog.records if record.name == "cogradar.services.process"]
    assert sent == ["dropped 3 messages on cogradar/10/x/run/r/scan", "dropped 1 messages on cogradar/10/run/r/start"]
    assert [bus.closed for bus in buses] == [1]


def test_a_service_told_to_stop_while_it_compiles_never_connects(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise Interrupted("interrupted")

    monkeypatch.setattr(kernels, "compile_all", interrupted)
    monkeypatch.setattr(process, "open_session", lambda *_, **__: pytest.fail("connected"))
    process.be(Role.PLANNER, Start("p"), **SETTINGS, stop=threading.Event())


def test_a_service_told_to_stop_before_there_is_a_router_ends() -> None:
    stop = threading.Event()
    timer = threading.Timer(0.3, stop.set)
    timer.start()
    process.be(Role.METRICS, Start("m", ":memory:"), **SETTINGS, stop=stop)
    timer.join()


def test_every_role_of_the_network_can_be_started() -> None:
    assert set(SERVICES) == set(Role)


@pytest.mark.zenoh
def test_a_service_that_is_stopped_leaves_memory_to_the_system() -> None:
    command = [sys.executable, "-c", WATCHED, "service", "router", "--listen", f"tcp/127.0.0.1:{free_port()}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as router:
        assert router.stderr is not None
        while "listening on" not in (line := router.stderr.readline()):
            assert line
        router.send_signal(signal.SIGTERM)
        said, _ = router.communicate(timeout=60.0)
    assert (router.returncode, said) == (0, "at exit\n")
