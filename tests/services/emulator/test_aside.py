"""A front end that is asked aside: while it is silent other runs go on, and its own run can be cancelled."""

import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from cogradar.services.emulator import aside, foreign
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.front_ends import open_front_end
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.front_ends.messages import Transmit
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, RunEnd, Scan
from cogradar.shared.wire.codec import encode
from cogradar.shared.wire.session import free_port
from tests.services.loop import checkpoint, play, smoke_start, waveforms
from tests.zenoh_device import NAME, Answer, Device, simulated

START = smoke_start(dwells=3)


def _begin(run: str, **flags: int) -> EmulatorCheckpoint:
    return checkpoint(START.model_copy(update={"run": run, "scenario": START.scenario | {"world": None}}), **flags)


@contextmanager
def _emulator(endpoint: str) -> Iterator[EmulatorCore]:
    """As a service has it, beside others."""
    core = EmulatorCore(open_front_end(f"zenoh:{NAME}@{endpoint}", connect="tcp/a.router:7447"))
    with closing(core):
        yield core


def _ticked(core: EmulatorCore, within_s: float) -> list[Message]:
    """What it says at ticks, up to the first message."""
    deadline = time.monotonic() + within_s
    while (now := time.monotonic()) < deadline:
        if answers := list(core.handle(Tick(now, True))):
            return answers
        wake_s = core.wake_s
        assert wake_s is not None
        time.sleep(max(0.0, wake_s - time.monotonic()))
    raise AssertionError(f"nothing within {within_s} s")


def test_other_runs_go_on_and_the_run_of_a_silent_front_end_can_be_cancelled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aside, "TURN_S", 0.5)
    play(START)  # so that kernels are there
    answers = simulated(checkpoint(START))

    def answer(device: Device, asked: Transmit) -> Answer | None:
        return answers(device, asked) if asked.run == "b" else None

    with Device(answer) as device, _emulator(device.endpoint) as core:
        began = time.monotonic()
        assert list(core.handle(_begin("a"))) == []
        first = list(core.handle(_begin("b"))) or _ticked(core, foreign.PATIENCE_S / 2.0)
        assert [(type(message), message.run) for message in first] == [(Scan, "b")]
        before_s, cancelled = core.wake_s, time.monotonic()
        core.handle(_begin("a", ended=True))
        after_s, done = core.wake_s, time.monotonic()
        assert before_s is not None
        assert after_s is None
        assert done - cancelled < 0.1
        assert done - began < foreign.PATIENCE_S / 2.0
        assert any(one.run == "a" for one in device.asked)
        for thread in threading.enumerate():
            if thread.name.startswith("front end of a"):
                thread.join(1.0)
                assert not thread.is_alive()


def test_runs_take_turns_at_a_front_end_that_knows_one_at_a_time() -> None:
    answers, runs = simulated(checkpoint(START)), [f"r{i}" for i in range(6)]

    def answer(device: Device, asked: Transmit) -> Answer:
        time.sleep(0.12)  # longer than the emulator waits at once
        if device.openings[-1].run != asked.run:
            return Answer(b"is not open", is_error=True)
        return answers(device, asked)

    with Device(answer) as device, _emulator(device.endpoint) as core:
        said = [message for run in runs for message in core.handle(_begin(run))]
        while len(said) < len(runs):
            said += _ticked(core, 5.0)
    assert sorted((message.run, type(message)) for message in said) == [(run, Scan) for run in runs]
    assert len(device.asked) == len(runs)  # none was refused


def test_runs_that_no_longer_wait_for_a_silent_one_take_turns_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aside, "TURN_S", 1.0)
    answers, runs, refused = simulated(checkpoint(START)), [f"r{i}" for i in range(4)], list[str]()

    def answer(device: Device, asked: Transmit) -> Answer | None:
        time.sleep(0.12)
        if asked.run == "silent":
            return None
        if device.openings[-1].run != asked.run:
            refused.append(asked.run)
            return Answer(b"is not open", is_error=True)
        return answers(device, asked)

    with Device(answer) as device, _emulator(device.endpoint) as core:
        said = [message for run in ["silent", *runs] for message in core.handle(_begin(run))]
        while len(said) < len(runs):
            said += _ticked(core, 5.0)
    assert sorted((message.run, type(message)) for message in said) == [(run, Scan) for run in runs]
    assert refused == []


def test_a_slow_front_end_is_asked_once_a_dwell_and_the_run_is_the_same() -> None:
    expected = play(START)
    answers = simulated(checkpoint(START))

    def answer(device: Device, asked: Transmit) -> Answer:
        time.sleep(0.12)
        return answers(device, asked)

    with Device(answer) as device, _emulator(device.endpoint) as core:
        said = list(core.handle(_begin("r"))) or _ticked(core, 5.0)
        for waveform in waveforms(expected):
            said += core.handle(waveform) or _ticked(core, 5.0)
            core.handle(waveform)  # again
    loop = [encode(one) for one in expected if isinstance(one, Scan | RunEnd)]
    assert [encode(one) for one in said] == loop
    assert len(device.asked) == sum(isinstance(one, Scan) for one in expected)


@pytest.mark.parametrize(
    ("listens", "said"),
    [
        (True, "front end: roof: no answer within 0.3 s; tried 5 times"),
        (False, "front end: roof: "),  # a run that begins ends with the first opening
    ],
)
def test_a_run_ends_as_it_does_where_the_emulator_waits(
    listens: bool, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foreign, "PATIENCE_S", 0.3)
    with Device(lambda _device, _asked: None) as device:
        endpoint = device.endpoint if listens else f"tcp/127.0.0.1:{free_port()}"
        with _emulator(endpoint) as core:
            (end,) = list(core.handle(_begin("r"))) or _ticked(core, 10.0)
    assert isinstance(end, RunEnd)
    assert end.reason.startswith(said)
    assert listens == ("tried" in end.reason)
