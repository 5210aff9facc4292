"""A front end that hangs is left behind: the emulator goes on with another one."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from cogradar.services.delivery.pacing import RealTime, pacing_at
from cogradar.services.emulator.cycle import transmission
from cogradar.services.emulator.front_end import FrontEndError, GroundTruth, ScanData, Settings, Transmission
from cogradar.services.emulator.kept_open import Counts, KeptOpen
from cogradar.services.emulator.own_thread import MOST_LEFT, InOwnThread, OpensInOwnThread
from tests.services.loop import SMOKE, checkpoint, smoke_start

ASKED = transmission(SMOKE.radar, None)
RATE_HZ = 10.0


@dataclass
class Device:
    """What its front ends do."""

    hangs: threading.Event = field(default_factory=threading.Event)  # not set: transmit waits for it
    closed: list[threading.Thread] = field(default_factory=list)
    is_closed: threading.Event = field(default_factory=threading.Event)

    def open(self, _settings: Settings) -> "FrontEnd":
        return FrontEnd(self)


class FrontEnd:
    def __init__(self, device: Device) -> None:
        self._device = device

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:  # noqa: ARG002
        if k == 1:
            self._device.hangs.wait()
        if k == 2:
            raise ValueError("two")
        return ScanData.not_measured("nothing is there")

    def close(self) -> None:
        self._device.closed.append(threading.current_thread())
        self._device.is_closed.set()


@pytest.fixture
def device() -> Iterator[Device]:
    found = Device()
    yield found
    found.hangs.set()


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deadlines of a test."""
    monkeypatch.setattr(RealTime, "silence_s", 0.1)
    monkeypatch.setattr(InOwnThread.__init__, "__defaults__", (0.1,))


def _opens(device: Device) -> Callable[[], KeptOpen]:
    opens = OpensInOwnThread(device.open)
    start = checkpoint(smoke_start().model_copy(update={"rate_hz": RATE_HZ})).model_copy(update={"world": None})
    return lambda: KeptOpen(opens, start, pacing_at(RATE_HZ), Counts())


@pytest.mark.usefixtures("hasty")
def test_the_radar_goes_on_with_another_front_end_and_the_first_is_closed_when_it_returns(device: Device) -> None:
    kept = _opens(device)()
    said = [kept.transmit(k, (0, 0), ASKED, now_s) for k, now_s in ((0, 0.0), (1, 0.1), (3, 0.3), (4, 2.0))]
    faults = [scan.fault for scan in said if scan is not None]
    assert faults[0] == faults[3] == "nothing is there"
    assert faults[1] == faults[2] == "transmit did not return within 0.1 s"
    assert not device.closed
    device.hangs.set()
    assert device.is_closed.wait(10.0)
    assert device.closed[0] is not threading.current_thread()
    kept.close()
    assert len(device.closed) == 2


@pytest.mark.usefixtures("hasty")
def test_what_it_raises_is_raised_and_what_it_lacks_is_lacking(device: Device) -> None:
    settings = Settings.of(checkpoint(smoke_start()))
    front_end = InOwnThread(device.open, settings, 10.0, [])
    with pytest.raises(ValueError, match="two"):
        front_end.transmit(2, 0, ASKED)
    assert not hasattr(front_end, "truth")
    front_end.close()


class Slow(FrontEnd):
    def close(self) -> None:
        time.sleep(0.3)
        super().close()


@pytest.mark.usefixtures("hasty")
def test_one_that_is_switched_off_slowly_is_waited_for(device: Device) -> None:
    settings = Settings.of(checkpoint(smoke_start()))
    InOwnThread(lambda _settings: Slow(device), settings, 0.1, []).close()
    assert device.is_closed.is_set()


class Knowing(FrontEnd):
    """It also knows where the targets are, and prepares dwells."""

    def truth(self, t: int) -> GroundTruth:
        return GroundTruth(np.full((1, 4), t), np.zeros(1, np.int32), np.zeros(1))

    def prepare(self) -> bool:
        time.sleep(0.2)  # it loads much
        return True


def test_what_it_may_have_besides_is_called_with_what_it_needs(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RealTime, "silence_s", 0.1)
    start = checkpoint(smoke_start().model_copy(update={"rate_hz": RATE_HZ}))
    counts = Counts()
    kept = KeptOpen(OpensInOwnThread(lambda _settings: Knowing(device)), start, pacing_at(RATE_HZ), counts)
    assert kept.prepare()
    assert counts.failures == 0
    kept.transmit(0, (0, 0), ASKED, 0.0)
    truth = kept.truth(3)
    assert truth is not None
    assert truth.states[0, 0] == 3.0
    assert not kept.prepare()
    assert kept.fault == "prepare did not return within 0.1 s"
    kept.close()


@pytest.mark.usefixtures("hasty")
def test_only_so_many_may_hang_at_once(device: Device) -> None:
    opens = OpensInOwnThread(device.open)
    start = checkpoint(smoke_start().model_copy(update={"rate_hz": RATE_HZ}))
    runs = [opens(start) for _ in range(MOST_LEFT)]  # some are open already when another one hangs
    for front_end in runs:
        with pytest.raises(FrontEndError, match="did not return"):
            front_end.transmit(1, 0, ASKED)
    with pytest.raises(FrontEndError, match=f"{MOST_LEFT} front ends .* hang"):
        opens(start)


def test_an_interrupt_does_not_wait_for_a_front_end_that_hangs(device: Device) -> None:
    front_end = InOwnThread(device.open, Settings.of(checkpoint(smoke_start())), 60.0, [])
    front_end.transmit(0, 0, ASKED)
    main = threading.main_thread().ident
    assert main is not None
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        threading.Timer(0.2, signal.pthread_kill, (main, signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            front_end.transmit(1, 0, ASKED)
    finally:
        signal.signal(signal.SIGINT, before)
    began = time.monotonic()
    front_end.close()
    assert time.monotonic() - began < 20.0
    device.hangs.set()
    assert device.is_closed.wait(20.0)


def test_opening_may_have_a_deadline(device: Device) -> None:
    def hangs(settings: Settings) -> FrontEnd:
        device.hangs.wait()
        return device.open(settings)

    with pytest.raises(FrontEndError, match=r"^opening did not return within 0\.1 s$"):
        InOwnThread(hangs, Settings.of(checkpoint(smoke_start())), 60.0, [], opening_s=0.1)
