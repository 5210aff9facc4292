"""The dwells of a run as server-sent events: in order, from where a client left off, at its own pace."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.web import app, events
from cogradar.services.web.address import listen, url
from cogradar.services.web.server import Server
from cogradar.services.web.shared import Shared
from cogradar.services.web.views import dwells
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, RunEnd, Scan
from tests.services.loop import play, scans, smoke_start
from tests.services.web.conftest import DWELLS, LATE

RUNS = "/api/v1/runs"
Event = tuple[str, str, dict[str, Any]]  # name, id, data


def _events(lines: Iterator[str]) -> Iterator[Event]:
    name, id_, data = "", "", ""
    for line in lines:
        field, _, value = line.partition(": ")
        match field:
            case "event":
                name = value
            case "id":
                id_ = value
            case "data":
                data = value
            case "" if not value and data:
                yield name, id_, json.loads(data)
                name, data = "", ""


def _all(web: httpx.Client, run: str, **headers: str) -> list[Event]:
    with web.stream("GET", f"{RUNS}/{run}/events", headers=headers) as answered:
        assert answered.headers["content-type"].startswith("text/event-stream")
        return list(_events(answered.iter_lines()))


def test_a_finished_run_is_told_from_its_first_dwell_to_its_end(
    web: httpx.Client, core: MetricsCore, sent: list[Message]
) -> None:
    *told, (name, _, end) = _all(web, "whole")
    assert (name, end["status"]) == ("end", "complete")
    assert [id_ for _, id_, _ in told] == [str(t) for t in range(1, DWELLS + 1)]
    rows = answer(core.store, "tracks", {"run": "whole"})
    by_t = {scan.t: scan for scan in scans(sent)}
    for _, id_, data in told:
        scan = by_t[int(id_)]
        assert data["cells"]["bin"] == scan.bins.tolist()
        assert data["cells"]["statistic"] == scan.statistic.tolist()
        assert data["cells"]["detected"] == [value >= data["threshold"] for value in scan.statistic]
        tested = dict(zip(scan.bins.tolist(), scan.statistic.tolist(), strict=True))
        for target in data["targets"]:
            (row,) = (r for r in rows if (r["t"], r["target"]) == (data["t"], target["target"]))
            assert {name: value for name, value in target.items() if name in row} == {
                name: value for name, value in row.items() if name in target
            }
            assert target["statistic"] == tested.get(target["true_bin"])


@pytest.mark.parametrize("how", ["header", "query"])
def test_a_client_goes_on_after_the_last_event_that_it_has(web: httpx.Client, how: str) -> None:
    if how == "header":
        told = _all(web, "whole", **{"Last-Event-ID": "5"})
    else:
        with web.stream("GET", f"{RUNS}/whole/events", params={"last_event_id": 5}) as answered:
            told = list(_events(answered.iter_lines()))
    assert [id_ for name, id_, _ in told if name == ""] == ["6", "7", "8"]
    for last in (DWELLS, DWELLS + 1):  # an EventSource that comes back after the end is told to stay away
        found = web.get(f"{RUNS}/whole/events", headers={"Last-Event-ID": str(last)})
        assert (found.status_code, found.content) == (204, b"")


def test_without_truth_there_are_tracks_and_no_targets_states(web: httpx.Client) -> None:
    for _, _, data in _all(web, "blind")[:-1]:
        for target in data["targets"]:
            assert (target["x"], target["true_bin"], target["snr_db"]) == (None, None, None)
            assert target["statistic"] is not None
            assert target["stale"] == data["stale"] == (data["t"] == LATE)


class _Live:
    """A run that is played dwell by dwell while it is listened to."""

    def __init__(self, path: Path, dwells: int, interval_s: float) -> None:
        self._journal = Journal(str(path))
        self._recorder = RecorderCore(self._journal)
        self._messages = play(smoke_start(dwells=dwells))
        self.core = MetricsCore(str(path))
        listener = listen("127.0.0.1:0")
        assert listener is not None
        self.url = url(listener)
        self.server = Server(self.core, listener, interval_s)

    def until(self, t: int | None) -> None:
        """Play up to, not including, the scan of dwell t; None: to the end. All of it is durable then."""
        while self._messages and not (isinstance(self._messages[0], Scan) and self._messages[0].t == t):
            message = self._messages.pop(0)
            if not isinstance(message, Checkpoint):
                self._recorder.handle(message)
            if isinstance(message, RunEnd):
                break
        for _ in range(3):
            self._recorder.handle(Tick(0.0))
        self.core.handle(Tick(time.monotonic()))

    def close(self) -> None:
        self.server.close()
        self.core.close()
        self._journal.close()


@pytest.fixture
def live(tmp_path: Path) -> Iterator[_Live]:
    run = _Live(tmp_path / "live.db", 60, 0.01)
    yield run
    run.close()


def test_a_live_run_begins_now_and_goes_on_to_its_end(live: _Live) -> None:
    live.until(1)
    with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as answered:
        told = _events(answered.iter_lines())
        name, id_, data = next(told)
        assert (name, id_, data["t"]) == ("acquisition", "0", 0)
        assert {track["status"] for track in data["tracks"]} == {"tracking"}
        assert len(data["cells"]["bin"]) > 0
        live.until(4)
        assert [next(told)[1] for _ in range(3)] == ["1", "2", "3"]
        live.until(6)
        assert [next(told)[1] for _ in range(2)] == ["4", "5"]
        with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as late:
            assert next(_events(late.iter_lines()))[1] == "5"
        live.until(None)  # 55 dwells at once: who only wants to see what goes on gets the newest
        *rest, (name, _, end) = list(told)
    assert (name, end["status"]) == ("end", "complete")
    assert [id_ for _, id_, _ in rest][-1] == "60"
    assert len(rest) < events.BEHIND


def test_with_a_last_event_not_a_dwell_is_left_out_until_the_newest_is_reached(live: _Live) -> None:
    live.until(31)
    with httpx.stream("GET", f"{live.url}{RUNS}/r/events", headers={"Last-Event-ID": "0"}, timeout=30.0) as answered:
        told = _events(answered.iter_lines())
        assert [next(told)[1] for _ in range(30)] == [str(t) for t in range(1, 31)]
        time.sleep(0.2)  # so it sees that there is no more
        live.until(None)
        ids = [id_ for name, id_, _ in told if name == ""]
    assert ids[-1] == "60"
    assert len(ids) < events.BEHIND  # from then on the newest


def test_work_under_way_is_shared_however_long_it_takes() -> None:
    begun, all_ask = list[int](), threading.Event()

    def work() -> int:
        begun.append(len(begun))
        all_ask.wait(10.0)
        return begun[-1]

    async def ask() -> list[int]:
        shared = Shared(0.01)
        first = asyncio.ensure_future(shared.get("it", work))
        await asyncio.sleep(0.1)
        second = asyncio.ensure_future(shared.get("it", work))
        await asyncio.sleep(0.0)
        all_ask.set()
        return [await second, await first, await _later(shared)]

    async def _later(shared: Shared) -> int:
        await asyncio.sleep(0.02)
        return int(await shared.get("it", work))

    assert asyncio.run(ask()) == [0, 0, 1]


def test_events_come_at_their_pace(tmp_path: Path) -> None:
    run = _Live(tmp_path / "runs.db", 20, 0.1)
    run.until(None)
    began = time.monotonic()  # a busy machine may read the first late, and the last not early
    with httpx.stream("GET", f"{run.url}{RUNS}/r/events", timeout=30.0) as answered:
        n = sum(1 for _ in _events(answered.iter_lines()))
    run.close()
    assert time.monotonic() - began >= 0.1 * (n - 2)


def test_who_does_not_read_holds_nothing_and_delays_nobody(live: _Live, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its stream waits in the system's buffers; it is let go after some time, and its place is free again."""
    monkeypatch.setattr(app, "SEND_WITHIN_S", 1.0)
    monkeypatch.setattr(events, "MAX_STREAMS", 2)
    monkeypatch.setattr("cogradar.services.web.views.dwells._dwell", lambda *_: b'{"pad":"%b"}' % (b"x" * (1 << 20)))
    live.until(None)
    where = urlsplit(live.url)
    with socket.create_connection((where.hostname, where.port)) as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.sendall(f"GET {RUNS}/r/events HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n".encode())
        assert [id_ for name, id_, _ in _events_of(live) if name == ""] == [str(t) for t in range(1, 61)]
        deadline = time.monotonic() + 20.0
        while (live.server.streams or live.server.connections) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert (live.server.streams, live.server.connections) == (0, 0)


def test_what_the_system_holds_for_a_slow_client_is_bounded(live: _Live, monkeypatch: pytest.MonkeyPatch) -> None:
    """So what it reads next is not a past that was queued long ago."""
    told = list[int]()

    def dwell(_store: Any, _known: Any, picture: dict[str, Any], *_: Any) -> bytes:
        told.append(picture["t"])
        return b'{"pad":"%b"}' % (b"x" * (64 << 10))

    monkeypatch.setattr("cogradar.services.web.views.dwells._dwell", dwell)
    live.until(None)
    where = urlsplit(live.url)
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect((where.hostname, where.port))
        slow.sendall(f"GET {RUNS}/r/events HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n".encode())
        deadline = time.monotonic() + 10.0
        while len(told) < dwells.AT_ONCE and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(1.0)  # at 10 ms a dwell all could have been sent
        assert told == list(range(1, dwells.AT_ONCE + 1))


def _events_of(live: _Live) -> list[Event]:
    with httpx.Client(base_url=live.url, timeout=30.0) as client:
        return _all(client, "r")


def test_streams_beyond_the_limit_are_refused(live: _Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "MAX_STREAMS", 1)
    live.until(3)
    with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as first:
        lines = first.iter_lines()  # which ends the stream when it is forgotten
        next(lines)
        refused = httpx.get(f"{live.url}{RUNS}/r/events", timeout=30.0)
        assert (refused.status_code, refused.headers["content-type"]) == (503, "application/problem+json")
        assert "1 streams" in refused.json()["detail"]
    deadline = time.monotonic() + 10.0
    while live.server.streams and time.monotonic() < deadline:
        time.sleep(0.02)
    with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as again:
        assert again.status_code == 200


def test_a_stream_that_is_cut_off_when_a_server_closes_is_no_error(
    live: _Live, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """On a busy machine it may not notice in time, and uvicorn cancels it."""
    live.until(3)
    assert live.server._serving is not None
    feed, is_stuck = live.server._serving[0].state.feed, threading.Event()
    state = feed.state

    async def stuck(run: str) -> Any:
        if is_stuck.is_set():
            await asyncio.sleep(30.0)
        return await state(run)

    monkeypatch.setattr(feed, "state", stuck)
    with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as answered:
        lines = answered.iter_lines()
        next(lines)
        is_stuck.set()
        time.sleep(0.5)  # until it asks once more
        live.server.close()
    assert "timeout graceful shutdown exceeded" in caplog.text  # it was cut off
    assert [record for record in caplog.records if record.exc_info] == []


def test_a_server_closes_at_once_with_streams_open(live: _Live) -> None:
    live.until(3)
    ended = threading.Event()

    def listen_on() -> None:
        with httpx.stream("GET", f"{live.url}{RUNS}/r/events", timeout=30.0) as answered:
            for _ in answered.iter_lines():
                pass
        ended.set()

    listener = threading.Thread(target=listen_on)
    listener.start()
    deadline = time.monotonic() + 10.0
    while not live.server.streams and time.monotonic() < deadline:
        time.sleep(0.02)
    began = time.monotonic()
    live.server.close()
    assert time.monotonic() - began < 2.0
    assert ended.wait(2.0)
    listener.join()
