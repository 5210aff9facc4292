"""What the service does around any front end: settings, errors, a run that is rewound, no truth."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, ScanData, Settings, Transmission
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, Refused, RunEnd, Scan, Waveform
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.wire.codec import encode
from tests.services.loop import SMOKE, checkpoint, smoke_start

RADAR = SMOKE.radar


class Receiver:
    """A front end that cannot go back: what it measures depends on how often it transmitted."""

    def __init__(self) -> None:
        self.transmitted: list[tuple[int, int]] = []
        self.opened = self.closed = 0
        self.fails_at: int | None = None
        self.error: Exception = FrontEndError("the cable is out")
        self.ends_at: int | None = None
        self.wrong: dict[str, Any] = {}

    def open(self, _: EmulatorCheckpoint) -> FrontEnd:
        self.opened += 1
        return self

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        if k == self.fails_at:
            raise self.error
        if k == self.ends_at:
            return None
        self.transmitted.append((k, t))
        ones = np.ones(waveform.bins.size)
        columns: dict[str, Any] = {"bins": waveform.bins, "statistic": ones * len(self.transmitted), "alpha_hat": ones}
        return ScanData(**(columns | {"sigma_hat": ones, "signature_power": ones} | self.wrong))

    def close(self) -> None:
        self.closed += 1


def _begin(k: int = 0, t: int = 0, **changed: Any) -> EmulatorCheckpoint:
    return checkpoint(smoke_start(), k, t).model_copy(update={"world": None} | changed)


def _waveform(k: int, tracking: bool = True) -> Waveform:
    return Waveform(
        run="r",
        k=k,
        tracking=tracking,
        isotropic=1.0,
        factor=np.zeros((RADAR.array.n_tx, 0), dtype=np.complex64),
        beams=np.array(((3,), (12,)) if tracking else ((-1,), (-1,)), dtype=np.int32),
        shares=np.zeros((2, 1)),
        status="fixed",
        late=np.zeros(2, dtype=np.int32),
    )


def _history(k: int) -> History:
    return History(run="r", to="emulator", topic="waveform", k=k, payloads=[encode(_waveform(k))])


def test_a_front_end_that_knows_no_truth_plays_a_run_to_its_end() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    sent: list[Message] = [*core.handle(_begin())]
    for k in range(6):
        sent += core.handle(_waveform(k))
    assert [type(message) for message in sent] == [*[Scan] * 5, RunEnd]
    assert receiver.transmitted == [(0, 0), (1, 1), (2, 2), (3, 3), (4, 4)]
    assert sent[-1] == RunEnd(run="r", k=4, t=4, status="complete")
    core.handle(_begin(5, 4, ended=True))
    assert receiver.closed == 1


def test_settings_are_what_the_radar_knows() -> None:
    settings = Settings.of(checkpoint(smoke_start()))
    assert set(vars(settings)) == {"run", "radar", "strategy", "dwells", "rate_hz"}
    assert (settings.radar, settings.dwells, settings.rate_hz) == (RADAR, 4, 0.0)
    assert Settings.of(_begin(rate_hz=20.0)).rate_hz == 20.0


def test_a_rewound_run_is_begun_again_and_measured_anew() -> None:
    """The journal has lost dwells 2 and 3, which it had acknowledged."""
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    first: list[Message] = [*core.handle(_begin())]
    for k in range(3):
        first += core.handle(_waveform(k))
    assert core.handle(_begin(4, 3)) == [WaveformRecall(run="r", k=3)]
    assert core.handle(_begin(2, 1)) == [WaveformRecall(run="r", k=1)]
    assert (receiver.opened, receiver.closed) == (2, 1)
    (again,) = core.handle(_history(1))
    assert isinstance(again, Scan)
    assert (again.k, again.t) == (2, 2)
    assert again != first[2]
    core.handle(_begin(2, 1, resend=True))
    assert core.handle(Tick(0.0)) == [again]


def test_a_simulated_run_that_is_rewound_is_the_same(simulated: Callable[[], EmulatorCore]) -> None:
    core, start = simulated(), smoke_start()
    sent: list[Message] = [*core.handle(checkpoint(start))]
    for k in range(3):
        sent += core.handle(_waveform(k))
    core.handle(checkpoint(start, 4, 3))
    assert core.handle(checkpoint(start, 2, 1)) == [WaveformRecall(run="r", k=1)]
    again = [*core.handle(_history(1)), *core.handle(_waveform(2))]
    assert [encode(message) for message in again] == [encode(message) for message in sent[4:]]


def test_a_front_end_that_fails_ends_the_run_with_its_reason() -> None:
    receiver = Receiver()
    receiver.fails_at = 2
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.handle(_waveform(0))
    (end,) = core.handle(_waveform(1))
    assert end == RunEnd(run="r", k=1, t=1, status="failed", reason="front end: the cable is out")
    core.handle(_begin(2, 1, resend=True))
    assert core.handle(Tick(0.0)) == [end]
    assert not core.handle(_waveform(1))


def test_a_front_end_that_cannot_be_opened_ends_the_run_with_its_reason() -> None:
    def unavailable(_: EmulatorCheckpoint) -> FrontEnd:
        raise FrontEndError("it is in use")

    end = RunEnd(run="r", k=0, t=0, status="failed", reason="front end: it is in use")
    assert EmulatorCore(unavailable).handle(_begin()) == [end]
    in_real_time = EmulatorCore(unavailable)
    assert in_real_time.handle(_begin(rate_hz=10.0)) == []
    assert in_real_time.handle(Tick(1.0)) == [end]
    middle = EmulatorCore(unavailable)
    assert middle.handle(_begin(3, 2)) == [WaveformRecall(run="r", k=2)]
    assert middle.handle(_history(2)) == [end.model_copy(update={"k": 2, "t": 2})]


def test_a_scenario_with_a_world_needs_a_front_end_that_knows_the_truth() -> None:
    receiver = Receiver()
    (end,) = EmulatorCore(receiver.open).handle(checkpoint(smoke_start()))
    assert isinstance(end, RunEnd)
    assert (end.status, receiver.transmitted, receiver.closed) == ("failed", [], 1)
    assert "[world]" in end.reason


def test_an_emulator_that_simulates_needs_a_world(simulated: Callable[[], EmulatorCore]) -> None:
    (end,) = simulated().handle(_begin())
    assert isinstance(end, RunEnd)
    assert end.status == "failed"
    assert "[world]" in end.reason


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"statistic": np.ones(3)}, "must have one length"),
        ({"sigma_hat": np.full(16, np.nan)}, "must be finite"),
        ({"bins": np.arange(1, 17)}, "cells up to 16"),
        ({"beams": np.array([[3]], dtype=np.int32)}, "beams of 1 tracks, 2 exist"),
    ],
)
def test_a_measurement_that_makes_no_sense_ends_the_run(wrong: dict[str, Any], words: str) -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    receiver.wrong = wrong
    (end,) = core.handle(_waveform(0))
    assert isinstance(end, RunEnd)
    assert (end.status, end.k) == ("failed", 0)
    assert words in end.reason


@pytest.mark.parametrize(("tracking", "status"), [(True, "complete"), (False, "failed")])
def test_a_front_end_without_more_dwells_ends_the_run(tracking: bool, status: str) -> None:
    receiver = Receiver()
    receiver.ends_at = 2
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.handle(_waveform(0, tracking))
    (end,) = core.handle(_waveform(1, tracking))
    assert isinstance(end, RunEnd)
    assert (end.status, end.k) == (status, 1)


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_a_waveform_far_beyond_the_run_is_refused(rate_hz: float) -> None:
    core = EmulatorCore(Receiver().open)
    core.handle(_begin(3, 2, rate_hz=rate_hz))
    with pytest.raises(Refused):
        core.handle(_waveform(2**31 - 1))


def test_in_real_time_an_emulator_that_was_away_skips_dwells_but_none_beyond_the_last() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin(3, 1, rate_hz=10.0))
    core.handle(_waveform(5))
    (end,) = core.handle(Tick(1.0))
    assert end == RunEnd(run="r", k=5, t=4, status="complete")
    core = EmulatorCore(receiver.open)
    core.handle(_begin(3, 1, rate_hz=10.0))
    core.handle(_waveform(4))
    (scan,) = core.handle(Tick(1.0))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t) == (5, 4)


def test_in_real_time_no_dwell_of_an_acquisition_is_skipped() -> None:
    """Planners need all of its scans, from the first on."""
    core = EmulatorCore(Receiver().open)
    core.handle(_begin(3, 0, rate_hz=10.0))
    core.handle(_waveform(5, tracking=False))
    scan = next(iter(core.handle(Tick(1.0))))
    assert isinstance(scan, Scan)
    assert scan.k == 3


def test_a_fault_of_a_front_end_ends_its_run_alone() -> None:
    receiver = Receiver()
    receiver.fails_at, receiver.error = 0, OSError("the cable is loose")
    core = EmulatorCore(receiver.open)
    (end,) = core.handle(_begin())
    assert isinstance(end, RunEnd)
    assert (end.status, end.reason) == ("failed", "front end: OSError: the cable is loose")


def test_front_ends_are_closed_with_the_process() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.close()
    assert receiver.closed == 1
    core.close()
    assert receiver.closed == 1
