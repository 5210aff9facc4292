"""What a delay of the links costs: a dwell takes no more of them one after the other than its messages need."""

import queue
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from cogradar.services import kernels
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.wire.session import open_session
from studies.processes.timestamps import ask_timestamps
from tests.services.loop import smoke_start

LEAST, MOST = 5.5, 7.2  # delays in a dwell. Scan, plan and waveform pass the router, which takes six
FIRST = 4  # tracking dwells that are left out


def _start(dwells: int) -> RunStart:
    start = smoke_start(dwells=dwells)
    return start.model_copy(update={"run": f"smoke-{time.monotonic_ns():x}"})


class Relay:
    """Passes on, both ways, what comes to its endpoint, in order and later by `delay_s`; as much as there is."""

    def __init__(self, port: int) -> None:
        self.delay_s, self._port = 0.0, port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def close(self) -> None:
        """All that are connected have ended."""
        self._listener.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        with self._listener, suppress(OSError):  # closed
            while True:
                self._threads.append(threading.Thread(target=self._connect, args=self._listener.accept()[:1]))
                self._threads[-1].start()

    def _connect(self, near: socket.socket) -> None:
        with near, suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", self._port)) as far:
            ways = [threading.Thread(target=self._pass, args=ends) for ends in ((near, far), (far, near))]
            for way in ways:
                way.start()
            for way in ways:
                way.join()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        sink.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        waiting = queue.SimpleQueue[tuple[float, bytes]]()
        writer = threading.Thread(target=_write, args=(sink, waiting))
        writer.start()
        data = b" "
        while data:
            try:
                data = source.recv(1 << 20)
            except OSError:
                data = b""
            waiting.put((time.monotonic() + self.delay_s, data))
        writer.join()


def _write(sink: socket.socket, waiting: queue.SimpleQueue[tuple[float, bytes]]) -> None:
    data = b" "
    while data:
        due_s, data = waiting.get()
        time.sleep(max(0.0, due_s - time.monotonic()))
        with suppress(OSError):  # who reads there has gone
            sink.sendall(data) if data else sink.shutdown(socket.SHUT_WR)


class Delayed(Launcher):
    """Its processes are connected through a relay."""

    def __init__(self, processes: LocalProcesses) -> None:
        super().__init__(processes, threading.Event())
        self.relay = Relay(int(self.endpoint.rpartition(":")[2]))

    def _start(self, name: str, *, again: bool = False) -> None:
        router = self.endpoint
        self.endpoint = router if name.startswith("router") else self.relay.endpoint
        super()._start(name, again=again)
        self.endpoint = router


@contextmanager
def _services() -> Iterator[Delayed]:
    kernels.compile_all(lambda _: None)
    launcher = Delayed(LocalProcesses(1))
    with closing(launcher.relay), launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        yield launcher


def _play(services: Delayed, delay_s: float, dwells: int) -> tuple[str, float]:
    """Digest of a run, and the time from one scan to the next while targets are tracked, s."""
    services.relay.delay_s = delay_s
    start = _start(dwells)
    nobody: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}
    played = cluster.play_on(services.endpoint, start, **nobody)
    with closing(open_session([services.endpoint], 9.0, services.check)) as session:
        (emulator,) = (found for name, found in ask_timestamps(session, start.run, 9.0).items() if "emulator" in name)
    sent_s = {one.k: one.begun for one in reversed(emulator.sent) if one.topic == "scan"}  # when it was sent first
    tracking = [sent_s[k] for k in sorted(sent_s)][-dwells + FIRST :]
    return played.run["digest"], float(np.quantile(np.diff(tracking), 0.25))  # a busy machine makes dwells longer


@pytest.mark.zenoh
@pytest.mark.parametrize(
    ("delays_s", "dwells"), [((0.02,), 16), pytest.param((0.001, 0.005, 0.02), 48, marks=pytest.mark.nightly)]
)
def test_a_dwell_takes_six_or_seven_delays_of_a_link(delays_s: tuple[float, ...], dwells: int) -> None:
    expected = in_process.play(_start(dwells)).run["digest"]
    with _services() as services:
        digest, computing_s = _play(services, 0.0, dwells)
        assert digest == expected
        for delay_s in delays_s:
            digest, period_s = _play(services, delay_s, dwells)
            assert digest == expected
        assert LEAST < (period_s - computing_s) / delay_s <= MOST  # of the last, which a busy machine disturbs least
