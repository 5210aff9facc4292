"""Front ends in processes of their own: the same run as in process, and what becomes of one that fails."""

import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import msgpack
import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.services.emulator import foreign
from cogradar.services.emulator.cycle import transmission
from cogradar.services.emulator.foreign import ForeignFrontEnd, OpensForeign
from cogradar.services.emulator.front_end import (
    FrontEndError,
    OpenFrontEnd,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    receive,
)
from cogradar.services.errors import BadInput, Interrupted
from cogradar.services.front_ends import open_front_end
from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, RunEnd, RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.front_ends import line
from cogradar.shared.wire.front_ends.line import Reply
from tests.services.loop import SMOKE, checkpoint, play, scans, smoke_start
from tests.zenoh_device import NAME, Answer, Device, simulated

DWELLS = 5


def _start(*settings: str, dwells: int = DWELLS) -> RunStart:
    start = RunStart.of(load("smoke", settings), Strategy.POWER_AWARE, 1, dwells)
    return start.model_copy(update={"run": "r"})


def _without_world(start: RunStart) -> RunStart:
    return start.model_copy(update={"scenario": start.scenario | {"world": None}})


def _of_loop(said: list[Message]) -> list[bytes]:
    """What the digest is of, and the end."""
    return [encode(message) for message in said if type(message).__name__ in {"Scan", "Plan", "Waveform", "RunEnd"}]


def _over_zenoh(endpoint: str) -> OpenFrontEnd:
    return OpensForeign(NAME, [endpoint])


@pytest.mark.parametrize("settings", [(), ("radar.fidelity=best-range",), ("radar.fidelity=best",)])
def test_a_run_over_zenoh_is_the_run_in_process(settings: tuple[str, ...]) -> None:
    start = _start(*settings)
    with Device(simulated(checkpoint(start))) as device:
        over_zenoh = play(_without_world(start), _over_zenoh(device.endpoint))
    assert _of_loop(over_zenoh) == _of_loop(play(start))


def _y(asked: int, n_cell: int) -> NDArray[np.complex64]:
    """Y of some range cells: two echoes from everywhere, and noise."""
    rng = np.random.default_rng(asked)
    re, im = rng.standard_normal((2, n_cell, 16, 16))
    y: NDArray[np.complex64] = (re + 1j * im).astype(np.complex64)
    for nu in (-0.3, 0.2333):
        y += 9.0 * np.exp(2j * np.pi * nu * (np.arange(16)[:, np.newaxis] + np.arange(16))).astype(np.complex64)
    return y


class _Receiver:
    """The same data in process."""

    def __init__(self, begun: EmulatorCheckpoint) -> None:
        self._radar = RadarConfig.model_validate(begun.radar)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:  # noqa: ARG002
        cells = waveform.range_cells if self._radar.receiver.range_cell_km > 0.0 else [-1]
        y = _y(k, len(cells)).astype(np.complex128)
        return receive(dict(zip(cells, y, strict=True)) if cells != [-1] else y[0], waveform, self._radar)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("settings", [(), ("radar.fidelity=best-range",)])
def test_data_over_zenoh_are_the_data_in_process(settings: tuple[str, ...]) -> None:
    start = _without_world(_start(*settings))

    def answer(device: Device, asked: Transmit) -> Answer:
        return device.data(asked, _y(asked.k, max(asked.range_cells.size, 1)))

    with Device(answer, hands_over="data") as device:
        over_zenoh = play(start, _over_zenoh(device.endpoint))
    assert _of_loop(over_zenoh) == _of_loop(play(start, _Receiver))
    assert any(scan.t > 0 for scan in scans(over_zenoh))


def _good(device: Device, asked: Transmit) -> Answer:
    return simulated(checkpoint(smoke_start(dwells=DWELLS)))(device, asked)


def _changed(answer: Answer, **fields: object) -> Answer:
    """An answer with other fields, which need not be valid."""
    envelope = msgpack.unpackb(answer.attachment or answer.payload)
    envelope["body"] |= fields
    payload: bytes = msgpack.packb(envelope)
    return Answer(payload) if answer.attachment is None else Answer(answer.payload, payload)


def _packed(value: NDArray[np.float64] | NDArray[np.int32]) -> msgpack.ExtType:
    name = b"i4" if value.dtype == np.int32 else b"f8"
    return msgpack.ExtType(1, struct.pack("<2sBI", name, 1, value.size) + value.tobytes())


def _others(bins: NDArray[np.int32]) -> NDArray[np.int32]:
    """As many bins that were not asked for."""
    return np.setdiff1d(np.arange(16, dtype=np.int32), bins)[: bins.size].astype(np.int32)


NAN = np.full(16, np.nan)
Bad = Callable[[Device, Transmit], Answer | None]
BAD: dict[str, tuple[Bad, str]] = {
    "no bytes": (lambda *_: Answer(b""), "roof: not MessagePack"),
    "other bytes": (lambda *_: Answer(b"\xff" * 1000), "roof: not MessagePack"),
    "a flood": (lambda *_: Answer(b"\xc1", times=3000), "roof: not MessagePack"),
    "a message of a run": (lambda *_: Answer(encode(smoke_start())), "roof: unknown topic 'runstart'"),
    "deep": (lambda *_: Answer(b"\x91" * 100_000), "roof: "),
    "too long": (lambda *_: Answer(bytes(5 << 20)), "roof: 5242880 bytes, more than 4194304"),
    "nothing": (lambda d, a: Answer(encode(d.received(a))), "bins is missing"),
    "NaN": (lambda d, a: _changed(_good(d, a), statistic=_packed(NAN)), "received.statistic: must be finite"),
    "type": (lambda d, a: _changed(_good(d, a), statistic="high"), "received.statistic: must be an array"),
    "length": (lambda d, a: _changed(_good(d, a), statistic=_packed(np.ones(3))), "statistic: 2 numbers are needed"),
    "not asked": (lambda d, a: _changed(_good(d, a), bins=_packed(_others(a.bins))), "not asked for"),
    "a clock": (lambda d, a: _changed(_good(d, a), utc_s=1e9), "utc_s = 1000000000.0, though the Hello says"),
    "its fault": (lambda d, a: Answer(encode(d.received(a, fault="no trigger"))), "roof: no trigger"),
    "another dwell": (
        lambda d, a: Answer(encode(d.received(a, k=a.k + 1))),
        "roof: no answer to dwell 3 of r within 10 s, but one to dwell 4 of r",
    ),
    "another run": (
        lambda d, a: Answer(encode(d.received(a, run="q"))),
        "roof: no answer to dwell 3 of r within 10 s, but one to dwell 3 of q",
    ),
}
BAD_DATA: dict[str, tuple[Bad, str]] = {
    "looks": (lambda d, a: Answer(encode(d.received(a))), "the answer has no attachment"),
    "short": (lambda d, a: d.data(a, _y(a.k, 1)[:, :15]), "Y of 1920 bytes: (1, 16, 16) complex64 are 2048"),
    "infinite": (lambda d, a: d.data(a, np.inf * _y(a.k, 1)), "Y: must be finite"),
    "cells": (lambda d, a: d.data(a, _y(a.k, 1), range_cells=np.array([7], np.int32)), "range_cells must be there if"),
}


@pytest.mark.parametrize("name", [*BAD, *BAD_DATA])
def test_a_bad_answer_is_named_and_the_run_goes_on(name: str, caplog: pytest.LogCaptureFixture) -> None:
    bad, said = (BAD | BAD_DATA)[name]
    good: Bad = (lambda d, a: d.data(a, _y(a.k, 1))) if name in BAD_DATA else simulated(checkpoint(_start(dwells=9)))
    start = _without_world(_start(dwells=9))
    with Device(
        lambda d, a: bad(d, a) if a.k == 3 else good(d, a), hands_over="data" if name in BAD_DATA else "looks"
    ) as device:
        found = play(start, _over_zenoh(device.endpoint))
    (fault,) = [scan.fault for scan in scans(found) if scan.fault is not None]
    assert said in fault
    assert said in caplog.text
    assert [(end.status, end.t) for end in found if isinstance(end, RunEnd)] == [("complete", 9)]
    assert [asked.k for asked in device.asked] == list(range(len(scans(found))))


def test_a_front_end_that_refuses_is_opened_again_and_the_run_is_the_same() -> None:
    start, refused = _start(), list[int]()
    good = simulated(checkpoint(start))

    def answer(device: Device, asked: Transmit) -> Answer:
        if asked.k == 3 and len(refused) < 2:
            refused.append(asked.k)
            return Answer(b"the amplifier is hot", is_error=True)
        return good(device, asked)

    with Device(answer) as device:
        found = play(_without_world(start), _over_zenoh(device.endpoint))
    assert len(device.openings) == 3
    assert _of_loop(found) == _of_loop(play(start))


def test_a_front_end_that_is_started_again_in_lockstep_changes_nothing() -> None:
    start = _start()
    good = simulated(checkpoint(start))

    def answer(device: Device, asked: Transmit) -> Answer | None:
        if asked.k == 2 and device.incarnation == "first":
            device.incarnation = "second"  # as a new process at the same place
        return good(device, asked)

    with Device(answer) as device:
        found = play(_without_world(start), _over_zenoh(device.endpoint))
    assert len(device.openings) == 2
    assert _of_loop(found) == _of_loop(play(start))


HELLO = {"n_tx": 16, "n_rx": 16, "hands_over": "looks", "max_rate_hz": 100.0, "clock": "none"}
SETTINGS = Settings.of(checkpoint(smoke_start().model_copy(update={"rate_hz": 10.0})))
ASKED = transmission(SMOKE.radar, None)


class FakeLine:
    """Replies that a test makes."""

    def __init__(self, *hellos: Reply[Hello]) -> None:
        self._hellos = hellos
        self.replies: list[Reply[Received]] = []
        self.within_s = 0.0
        self.is_closed = False

    def open(self, _opening: Opening, _within_s: float) -> Iterator[Reply[Hello]]:
        yield from self._hellos

    def transmit(self, _dwell: Transmit, within_s: float) -> Iterator[Reply[Received]]:
        self.within_s = within_s
        yield from self.replies

    def close(self) -> None:
        self.is_closed = True


def _hello(incarnation: str = "first", replier: str = "", **fields: object) -> Reply[Hello]:
    said = {"run": SETTINGS.run, "incarnation": incarnation} | HELLO | fields
    return Reply(Hello.model_validate(said), replier=replier)


def _opened(line: FakeLine) -> ForeignFrontEnd:
    return ForeignFrontEnd.open(NAME, SETTINGS, SMOKE.radar.model_dump(), line, 1.0)


@pytest.mark.parametrize(
    ("hellos", "said"),
    [
        ([], "roof: nothing answers within 1 s: start it first"),
        ([_hello(), _hello("second")], "roof: 2 front ends have this name (first, second): stop all but one"),
        ([_hello(), _hello(replier="b")], "roof: 2 front ends have this name (first, first): stop all but one"),
        ([_hello(run="q")], "roof: its Hello is for q, r was opened"),
        ([_hello(n_tx=8)], "roof: its array is 8 x 16, the scenario's radar.array.n_tx x n_rx is 16 x 16: set these"),
        ([_hello(max_rate_hz=9.0)], "roof: it makes at most 9 dwells a second, the run has 10: lower --rate"),
        ([Reply[Hello](None, fault="schema 7, expected 2")], "roof: schema 7, expected 2"),
    ],
)
def test_what_does_not_fit_is_not_opened(hellos: list[Reply[Hello]], said: str) -> None:
    with pytest.raises(FrontEndError) as refused:
        _opened(FakeLine(*hellos))
    assert str(refused.value).startswith(said)


def _fault(**fields: object) -> Reply[Received]:
    said = {"run": SETTINGS.run, "incarnation": "first", "k": 5, "fault": "dark"} | fields
    return Reply(Received.model_validate(said))


def test_what_comes_late_or_of_a_second_front_end_is_not_used(caplog: pytest.LogCaptureFixture) -> None:
    line = FakeLine(_hello())
    front_end = _opened(line)
    line.replies = [_fault(k=4), _fault(incarnation="second"), _fault(incarnation="second"), _fault()]
    measured = front_end.transmit(5, 1, ASKED)
    assert measured is not None
    assert measured.fault == "roof: dark"
    assert line.within_s == 0.05
    named = "r: front end roof: a second one answers, second beside first: stop one of them, or give it another name"
    assert [record.getMessage() for record in caplog.records] == [named]
    line.replies = [_fault(incarnation="second")]
    with pytest.raises(FrontEndError, match="roof: it was started again, or another one took its place: second"):
        front_end.transmit(5, 1, ASKED)
    line.replies = []
    silent = front_end.transmit(5, 1, ASKED)
    assert silent is not None
    assert silent.fault == "roof: no answer within 0.05 s"
    line.replies = [_fault(fault=None, ended=True)]
    assert front_end.transmit(5, 1, ASKED) is None
    front_end.close()
    assert line.is_closed


def test_more_range_cells_than_a_question_has_are_refused_at_the_opening() -> None:
    begun = checkpoint(_without_world(_start("radar.fidelity=best-range", "radar.receiver.range_cell_km=0.01")))
    line = FakeLine(_hello(run="r"))
    said = r"roof: radar.receiver.range_cell_km = 0.01 makes \d+ range cells, .* 4096 at most: set a larger one"
    with pytest.raises(FrontEndError, match=said):
        ForeignFrontEnd.open(NAME, Settings.of(begun), begun.radar, line, 1.0)


def test_a_fault_keeps_its_time() -> None:
    line = FakeLine(_hello(clock="utc"))
    line.replies = [_fault(utc_s=1e9)]
    measured = _opened(line).transmit(5, 1, ASKED)
    assert measured is not None
    assert (measured.fault, measured.utc_s) == ("roof: dark", 1e9)


@pytest.mark.parametrize("extra", [[-1], [-2147483648], [5000], [2147483647]])
def test_a_range_cell_that_was_not_asked_for_is_named(extra: list[int]) -> None:
    begun = checkpoint(_without_world(_start("radar.fidelity=best-range")))
    asked = transmission(RadarConfig.model_validate(begun.radar), None)
    line = FakeLine(_hello(run="r", hands_over="data"))
    front_end = ForeignFrontEnd.open(NAME, Settings.of(begun), begun.radar, line, 1.0)
    cells = np.array([*asked.range_cells[1:], *extra], np.int32)
    received = Received(run="r", incarnation="first", k=0, range_cells=cells)
    line.replies = [Reply(received, data=_y(0, cells.size).tobytes())]
    with pytest.raises(SenselessScan, match=f"range_cells: {extra[0]} was not asked for"):
        front_end.transmit(0, 0, asked)
    with pytest.raises(SenselessScan, match="data of range cell -2: a dictionary by numbers from 0 is needed"):
        receive({-2: _y(0, 1)[0].astype(np.complex128)}, asked, RadarConfig.model_validate(begun.radar))


def test_a_slow_front_end_has_the_time_that_it_says_up_to_a_period() -> None:
    line = FakeLine(_hello(max_rate_hz=12.5))
    _opened(line).transmit(0, 0, ASKED)
    assert line.within_s == pytest.approx(0.08)


def test_two_front_ends_of_one_name_are_named(router: str, caplog: pytest.LogCaptureFixture) -> None:
    start = _without_world(_start(dwells=20))
    good = [simulated(checkpoint(_start(dwells=20))) for _ in range(2)]
    second = Device(good[1], router, "second")

    def answer(device: Device, asked: Transmit) -> Answer:
        if asked.k == 2:
            second.__enter__()
        return good[0](device, asked)

    with Device(answer, router) as device:
        found = play(start, _over_zenoh(router))
        assert "a second one answers, second beside first" in caplog.text
        assert _of_loop(found) == _of_loop(play(_start(dwells=20)))
        failed = play(start, _over_zenoh(router))
        second.__exit__(None, None, None)
    (end,) = [message for message in failed if isinstance(message, RunEnd)]
    assert end.reason.startswith("front end: roof: 2 front ends have this name (first, second)")
    assert device.incarnation == "first"


def test_a_silent_front_end_is_left_when_the_process_is_to_end() -> None:
    asked, stop, is_over = threading.Event(), threading.Event(), threading.Event()

    def check() -> None:
        if stop.is_set():
            raise Interrupted("interrupted")

    def answer(_device: Device, _asked: Transmit) -> None:
        asked.set()
        is_over.wait(20.0)

    def interrupt() -> None:
        asked.wait(20.0)
        stop.set()

    begun = checkpoint(_without_world(_start()))
    with Device(answer) as device:
        opened = OpensForeign(NAME, [device.endpoint], check)(begun)
        threading.Thread(target=interrupt, daemon=True).start()
        began = time.monotonic()
        with closing(opened), pytest.raises(Interrupted):
            opened.transmit(0, 0, ASKED)
        took_s = time.monotonic() - began
        is_over.set()
    assert took_s < 5.0


def test_a_question_that_is_dropped_is_asked_again_after_growing_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "PATIENCE_S", 2.0)
    begun = checkpoint(_without_world(_start()))
    no_answer = pytest.raises(FrontEndError, match="roof: no answer within 2 s")
    with Device(lambda *_: None) as device:
        with closing(OpensForeign(NAME, [device.endpoint])(begun)) as opened, no_answer:
            opened.transmit(0, 0, ASKED)
        left = [asked.deadline_s for asked in device.asked]
    assert 2 <= len(left) <= 5
    assert left == sorted(left, reverse=True)
    assert left[-1] < 2.0 - 0.01


def test_what_waits_of_replies_is_bounded_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line, "MAX_DATA", 5000)
    begun = checkpoint(_without_world(_start()))
    device = Device(lambda d, a: d.data(a, _y(a.k, 1))._replace(times=9), hands_over="data")
    with device, closing(line.Line(NAME, [device.endpoint], 9.0, lambda: None)) as opened:
        list(opened.open(Opening(run="r", radar=begun.radar, dwells=1, rate_hz=0.0), 9.0))
        replies = list(_unread(opened, foreign.question("r", 0, 0, ASKED, 9.0)))
    faults = [reply.fault for reply in replies if reply.message is None]
    assert len(replies) == 9
    assert len(faults) > 3
    assert faults[0].endswith("bytes, more than 5000 with what waits already")


def _unread(opened: line.Line, asked: Transmit) -> Iterator[Reply[Received]]:
    """All replies to a question, which wait until the last one has come."""
    for n, reply in enumerate(opened.transmit(asked, 9.0)):
        if n == 0:
            time.sleep(0.5)
        yield reply


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("zenoh:", "zenoh:: must be zenoh:NAME or zenoh:NAME@ENDPOINT"),
        ("zenoh:a/b", "zenoh:a/b: must be zenoh:NAME"),
        ("zenoh:**", "zenoh:**: must be zenoh:NAME"),
        ("zenoh:roof", "zenoh:roof: no front end can know the router of this run: say where it listens, as in"),
        ("zenoh:roof@nonsense", "zenoh:roof@nonsense: 'nonsense' is no endpoint, such as tcp/127.0.0.1:7447"),
    ],
)
def test_a_name_that_cannot_be_is_refused(name: str, said: str) -> None:
    with pytest.raises(BadInput) as refused:
        open_front_end(name)
    assert str(refused.value).startswith(said)
    open_front_end("zenoh:roof", "tcp/127.0.0.1:7447")


def test_where_nothing_listens_a_run_ends_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "PATIENCE_S", 0.2)
    found = play(_without_world(_start()), open_front_end("zenoh:roof@tcp/127.0.0.1:1"))
    (end,) = [message for message in found if isinstance(message, RunEnd)]
    assert end.status == "failed"
    assert end.reason.startswith("front end: roof: no Zenoh router at tcp/127.0.0.1:1 within 0.2 s: connection refused")
