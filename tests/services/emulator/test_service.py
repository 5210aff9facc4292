"""What the service does around any front end: settings, measurements, a run that is rewound, no truth."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.front_end import GroundTruth, Settings
from cogradar.shared.protocol.events import Rewind, Tick
from cogradar.shared.protocol.messages import Message, Refused, RunEnd, Scan
from cogradar.shared.protocol.recovery import WaveformRecall
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.wire.codec import encode
from tests.services.emulator.receiver import RADAR, Receiver, begin, history, waveform_of
from tests.services.loop import checkpoint, smoke_start


def test_a_front_end_that_knows_no_truth_plays_a_run_to_its_end() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    sent: list[Message] = [*core.handle(begin())]
    for k in range(6):
        sent += core.handle(waveform_of(k))
    assert [type(message) for message in sent] == [*[Scan] * 5, RunEnd]
    assert receiver.transmitted == [(0, 0), (1, 1), (2, 2), (3, 3), (4, 4)]
    assert sent[-1] == RunEnd(run="r", k=4, t=4, status="complete")
    core.handle(begin(5, 4, ended=True))
    assert receiver.closed == 1


def test_settings_are_what_the_radar_knows() -> None:
    settings = Settings.of(checkpoint(smoke_start()))
    assert set(vars(settings)) == {"run", "radar", "strategy", "dwells", "rate_hz"}
    assert (settings.radar, settings.dwells, settings.rate_hz) == (RADAR, 4, 0.0)
    assert Settings.of(begin(rate_hz=20.0)).rate_hz == 20.0


def test_a_rewound_run_is_begun_again_and_measured_anew() -> None:
    """The journal has lost dwells 2 and 3, which it had acknowledged."""
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    first: list[Message] = [*core.handle(begin())]
    for k in range(3):
        first += core.handle(waveform_of(k))
    assert core.handle(begin(4, 3)) == [WaveformRecall(run="r", k=3)]
    core.handle(Rewind("r"))
    assert core.handle(begin(2, 1)) == [WaveformRecall(run="r", k=1)]
    assert (receiver.opened, receiver.closed) == (2, 1)
    (again,) = core.handle(history(1))
    assert isinstance(again, Scan)
    assert (again.k, again.t) == (2, 2)
    assert again != first[2]
    core.handle(begin(2, 1, resend=True))
    assert core.handle(Tick(0.0)) == [again]


def test_a_simulated_run_that_is_rewound_is_the_same(simulated: Callable[[], EmulatorCore]) -> None:
    core, start = simulated(), smoke_start()
    sent: list[Message] = [*core.handle(checkpoint(start))]
    for k in range(3):
        sent += core.handle(waveform_of(k))
    core.handle(checkpoint(start, 4, 3))
    core.handle(Rewind("r"))
    assert core.handle(checkpoint(start, 2, 1)) == [WaveformRecall(run="r", k=1)]
    again = [*core.handle(history(1)), *core.handle(waveform_of(2))]
    assert [encode(message) for message in again] == [encode(message) for message in sent[4:]]


def test_a_scenario_with_a_world_needs_a_front_end_that_knows_the_truth() -> None:
    receiver = Receiver()
    (end,) = EmulatorCore(receiver.open).handle(checkpoint(smoke_start()))
    assert isinstance(end, RunEnd)
    assert (end.status, receiver.transmitted, receiver.closed) == ("failed", [], 1)
    assert "[world]" in end.reason


def test_an_emulator_that_simulates_needs_a_world(simulated: Callable[[], EmulatorCore]) -> None:
    (end,) = simulated().handle(begin())
    assert isinstance(end, RunEnd)
    assert end.status == "failed"
    assert "[world]" in end.reason


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"statistic": None}, "statistic is missing"),
        ({"bins": [[1], [2, 3]]}, "bins: "),
        ({"bins": np.int32(3)}, "bins: 1 numbers are needed, got int32 of shape ()"),
        ({"statistic": np.ones(16) * 1j}, "statistic: 16 numbers are needed, got complex128"),
        ({"beams": "abc"}, "UFuncTypeError"),
        ({"statistic": np.ones(3)}, "statistic: 16 numbers are needed, got float64 of shape (3,)"),
        ({"statistic": ["1"] * 16}, "statistic: 16 numbers are needed, got <U1"),
        ({"sigma_hat": np.where(np.arange(16) == 5, np.nan, 1.0)}, "bin 5: sigma_hat is nan"),
        ({"sigma_hat": np.where(np.arange(16) == 4, 0.0, 1.0)}, "bin 4: a statistic of 2 with sigma_hat 0, which"),
        ({"statistic": np.full(16, -1.0)}, "statistic: must be 0, or"),
        ({"alpha_hat": np.full(16, 1e39)}, "alpha_hat: must be finite"),
        ({"bins": np.arange(1, 17)}, "bin 16 was not asked for"),
        ({"bins": np.arange(16)[::-1]}, "ascending"),
        ({"beams": np.array([[3]], dtype=np.int32)}, "beams of 1 tracks, 2 exist"),
    ],
)
def test_a_measurement_that_makes_no_sense_counts_as_none(
    wrong: dict[str, Any], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The radar goes on, and it is told and counted that nothing was measured."""
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    receiver.wrong = wrong
    (scan,) = core.handle(waveform_of(0))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t, scan.bins.size) == (1, 1, 0)
    assert scan.unmeasured is not None
    assert np.array_equal(scan.unmeasured, bin_centres(16))
    assert scan.fault is not None
    assert words in scan.fault
    core.handle(waveform_of(1))
    assert words.split(" a ", maxsplit=1)[0] in core.trouble
    assert [record.levelname for record in caplog.records] == ["WARNING"]  # once for both dwells
    assert words in caplog.text
    counted = {"front_end_failures": 0, "front_ends_failing": 1, "scans_senseless": 2}
    assert core.measures() == counted | {"dwells_not_measured": 2, "looks_asked": 48, "looks_not_measured": 32}
    receiver.wrong = {}
    (scan,) = core.handle(waveform_of(2))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, scan.fault, core.trouble) == (16, None, "")
    assert receiver.opened == 1


def test_a_run_whose_truth_cannot_be_had_ends_alone() -> None:
    class Knowing(Receiver):
        def truth(self, t: int) -> GroundTruth:
            raise ValueError(f"no truth at {t}")

    (end,) = EmulatorCore(Knowing().open).handle(begin())
    assert isinstance(end, RunEnd)
    assert re.fullmatch(r"front end: truth: test_service\.py, line \d+: ValueError: no truth at 0", end.reason)


def test_what_is_no_scan_at_all_counts_as_none() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    receiver.returns = ([1], [2.0])
    (scan,) = core.handle(waveform_of(0))
    assert isinstance(scan, Scan)
    assert scan.fault == "senseless scan: transmit returned tuple, ScanData is needed"


@pytest.mark.parametrize(
    ("utc_s", "fault"), [(1.79e9, None), (-1.0, "utc_s: "), (2e10, "utc_s: "), (np.nan, "utc_s: "), ("now", "utc_s: ")]
)
def test_the_time_of_a_scan_is_as_the_receiver_says_or_the_scan_is_senseless(utc_s: object, fault: str | None) -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    receiver.wrong = {"utc_s": utc_s}
    scan = next(message for message in core.handle(waveform_of(0)) if isinstance(message, Scan))
    assert scan.utc_s == (utc_s if fault is None else None)
    assert (scan.fault or "").startswith("" if fault is None else f"senseless scan: {fault}")


def test_cells_that_are_left_out_are_told_to_be_unmeasured() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    left = np.array([0, 1, 2, 7])
    receiver.wrong = {"bins": left} | {
        name: np.ones(4) for name in ("statistic", "alpha_hat", "sigma_hat", "signature_power")
    }
    (scan,) = core.handle(waveform_of(0))
    assert isinstance(scan, Scan)
    assert scan.bins.tolist() == left.tolist()
    assert scan.unmeasured is not None
    assert np.array_equal(scan.unmeasured, np.delete(bin_centres(16), left))
    assert (scan.fault, core.trouble) == (None, "")
    assert (core.measures()["dwells_not_measured"], core.measures()["looks_not_measured"]) == (0, 12)


@pytest.mark.parametrize(("tracking", "status"), [(True, "complete"), (False, "failed")])
def test_a_front_end_without_more_dwells_ends_the_run(tracking: bool, status: str) -> None:
    receiver = Receiver()
    receiver.ends_at = 2
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    core.handle(waveform_of(0, tracking))
    (end,) = core.handle(waveform_of(1, tracking))
    assert isinstance(end, RunEnd)
    assert (end.status, end.k) == (status, 1)


@pytest.mark.parametrize("rate_hz", [0.0, 10.0])
def test_a_waveform_far_beyond_the_run_is_refused(rate_hz: float) -> None:
    core = EmulatorCore(Receiver().open)
    core.handle(begin(3, 2, rate_hz=rate_hz))
    with pytest.raises(Refused):
        core.handle(waveform_of(2**31 - 1))


def test_in_real_time_an_emulator_that_was_away_skips_dwells_but_none_beyond_the_last() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin(3, 1, rate_hz=10.0))
    core.handle(waveform_of(5))
    (end,) = core.handle(Tick(1.0))
    assert end == RunEnd(run="r", k=5, t=4, status="complete")
    core = EmulatorCore(receiver.open)
    core.handle(begin(3, 1, rate_hz=10.0))
    core.handle(waveform_of(4))
    (scan,) = core.handle(Tick(1.0))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t) == (5, 4)


def test_in_real_time_no_dwell_of_an_acquisition_is_skipped() -> None:
    """Planners need all of its scans, from the first on."""
    core = EmulatorCore(Receiver().open)
    core.handle(begin(3, 0, rate_hz=10.0))
    core.handle(waveform_of(5, tracking=False))
    scan = next(iter(core.handle(Tick(1.0))))
    assert isinstance(scan, Scan)
    assert scan.k == 3


def test_front_ends_are_closed_with_the_process() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    core.close()
    assert receiver.closed == 1
    core.close()
    assert receiver.closed == 1
