"""What the service does around any front end: settings, errors, a run that is rewound, no truth."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest

from cogradar.services.emulator.core import SAY_S, EmulatorCore
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, GroundTruth, ScanData, Settings, Transmission
from cogradar.services.emulator.kept_open import ATTEMPTS, FIRST_S, LONGEST_S
from cogradar.shared.protocol.admission import check_dwell
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import MAX_FAULT, EmulatorCheckpoint, Message, Refused, RunEnd, Scan, Waveform
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.wire.codec import encode
from tests.services.loop import SMOKE, checkpoint, smoke_start

RADAR = SMOKE.radar


class Receiver:
    """A front end that cannot go back: what it measures depends on how often it transmitted."""

    def __init__(self) -> None:
        self.transmitted: list[tuple[int, int]] = []
        self.opened = self.closed = 0
        self.fails_at: int | None = None
        self.fails_for = 1000  # attempts
        self.is_broken = False
        self.returns: Any = None  # instead of a scan
        self.error: Exception = FrontEndError("the cable is out")
        self.ends_at: int | None = None
        self.wrong: dict[str, Any] = {}

    def open(self, _: EmulatorCheckpoint) -> FrontEnd:
        self.opened += 1
        return self

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        if self.is_broken:
            raise OSError("the cable is loose")
        if k == self.fails_at and self.fails_for > 0:
            self.fails_for -= 1
            raise self.error
        if k == self.ends_at:
            return None
        self.transmitted.append((k, t))
        if self.returns is not None:
            return cast(ScanData, self.returns)
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


def test_in_lockstep_a_front_end_that_fails_is_opened_again_and_its_dwell_repeated() -> None:
    receiver = Receiver()
    receiver.fails_at, receiver.fails_for = 2, ATTEMPTS - 1
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.handle(_waveform(0))
    (scan,) = core.handle(_waveform(1))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t, scan.unmeasured, scan.bins.size) == (2, 2, None, 16)
    assert (receiver.opened, receiver.closed) == (ATTEMPTS, ATTEMPTS - 1)
    assert core.measures()["front_end_failures"] == ATTEMPTS - 1


def test_in_lockstep_a_front_end_that_fails_for_good_ends_the_run_with_its_reason() -> None:
    receiver = Receiver()
    receiver.fails_at = 2
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.handle(_waveform(0))
    (end,) = core.handle(_waveform(1))
    reason = f"front end: the cable is out; tried {ATTEMPTS} times"
    assert end == RunEnd(run="r", k=1, t=1, status="failed", reason=reason)
    core.handle(_begin(2, 1, resend=True))
    assert core.handle(Tick(0.0)) == [end]
    assert not core.handle(_waveform(1))


def test_a_front_end_that_cannot_be_opened_at_the_beginning_ends_the_run_with_its_reason() -> None:
    def unavailable(_: EmulatorCheckpoint) -> FrontEnd:
        raise FrontEndError("it is in use")

    end = RunEnd(run="r", k=0, t=0, status="failed", reason="front end: it is in use")
    assert EmulatorCore(unavailable).handle(_begin()) == [end]
    in_real_time = EmulatorCore(unavailable)
    assert in_real_time.handle(_begin(rate_hz=10.0)) == []
    assert in_real_time.handle(Tick(1.0)) == [end]
    middle = EmulatorCore(unavailable)
    assert middle.handle(_begin(3, 2)) == [WaveformRecall(run="r", k=2)]
    given_up = {"k": 2, "t": 2, "reason": f"front end: it is in use; tried {ATTEMPTS} times"}
    assert middle.handle(_history(2)) == [end.model_copy(update=given_up)]


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
    core.handle(_begin())
    receiver.wrong = wrong
    (scan,) = core.handle(_waveform(0))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t, scan.bins.size) == (1, 1, 0)
    assert scan.unmeasured is not None
    assert np.array_equal(scan.unmeasured, bin_centres(16))
    assert scan.fault is not None
    assert words in scan.fault
    core.handle(_waveform(1))
    assert words.split(" a ", maxsplit=1)[0] in core.trouble
    assert [record.levelname for record in caplog.records] == ["WARNING"]  # once for both dwells
    assert words in caplog.text
    counted = {"front_end_failures": 0, "front_ends_failing": 1, "scans_senseless": 2}
    assert core.measures() == counted | {"dwells_not_measured": 2, "looks_asked": 48, "looks_not_measured": 32}
    receiver.wrong = {}
    (scan,) = core.handle(_waveform(2))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, scan.fault, core.trouble) == (16, None, "")
    assert receiver.opened == 1


def test_a_run_whose_truth_cannot_be_had_ends_alone() -> None:
    class Knowing(Receiver):
        def truth(self, t: int) -> GroundTruth:
            raise ValueError(f"no truth at {t}")

    (end,) = EmulatorCore(Knowing().open).handle(_begin())
    assert isinstance(end, RunEnd)
    assert end.reason == "front end: truth: ValueError: no truth at 0"


def test_a_front_end_that_cannot_prepare_is_opened_again() -> None:
    class Eager(Receiver):
        def prepare(self) -> bool:
            raise ValueError("not now")

    receiver = Eager()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    assert not core.prepare()
    (scan,) = core.handle(_waveform(0))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, receiver.opened, receiver.closed) == (16, 2, 1)


def test_the_text_of_a_fault_is_cut_and_cleaned_where_it_comes_in() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    receiver.returns = ScanData.not_measured("a\nERROR \x1b[2J" + "x" * 300)
    (scan,) = core.handle(_waveform(0))
    assert isinstance(scan, Scan)
    assert scan.fault == ("a?ERROR ?[2J" + "x" * 300)[:MAX_FAULT]
    receiver.returns, receiver.wrong = None, {"fault": "late packet"}  # and yet all cells are there
    (scan,) = core.handle(_waveform(1))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, scan.fault) == (16, None)


def test_in_lockstep_a_fault_that_comes_back_is_logged_again(caplog: pytest.LogCaptureFixture) -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin(dwells=100))
    for k in range(90):
        receiver.wrong = {} if k % 30 >= 15 else {"sigma_hat": np.full(16, np.nan)}
        core.handle(_waveform(k))
    assert [record.levelname for record in caplog.records].count("WARNING") == 3


def test_an_opening_that_blocks_stops_no_clock() -> None:
    """It takes 5 s, in which no dwell can be transmitted; 10 Hz. Pauses begin when it has ended."""
    now, opened = [100.0], list[float]()

    class Slow(Receiver):
        def open(self, checkpoint: EmulatorCheckpoint) -> FrontEnd:
            if self.is_broken:
                opened.append(now[0])
                now[0] += 5.0
                raise OSError("connect timed out")
            return super().open(checkpoint)

    receiver = Slow()
    core = EmulatorCore(receiver.open)
    core.handle(_begin(3, 2, rate_hz=10.0, dwells=3000))
    core.handle(_waveform(3))

    def until(end_s: float) -> Scan:
        last: Scan | None = None
        while now[0] < end_s:
            last = next((one for one in core.handle(Tick(now[0])) if isinstance(one, Scan)), last)
            now[0] += 0.05
        assert last is not None
        return last

    before, begun_s = until(102.0), now[0]
    receiver.is_broken = True
    after = until(begun_s + 40.0)
    assert after.t - before.t == after.k - before.k == pytest.approx(10.0 * (now[0] - begun_s), abs=60)
    assert all(
        second - first - 5.0 >= pause for (first, second), pause in zip(pairwise(opened), (1.0, 2.0), strict=False)
    )
    receiver.is_broken, begun_k = False, after.k
    begun_s = now[0]
    assert until(begun_s + 60.0).k - begun_k == pytest.approx(600, abs=60)


def test_what_is_no_scan_at_all_counts_as_none() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    receiver.returns = ([1], [2.0])
    (scan,) = core.handle(_waveform(0))
    assert isinstance(scan, Scan)
    assert scan.fault == "senseless scan: transmit returned tuple, ScanData is needed"


@pytest.mark.parametrize(
    ("utc_s", "fault"), [(1.79e9, None), (-1.0, "utc_s: "), (2e10, "utc_s: "), (np.nan, "utc_s: "), ("now", "utc_s: ")]
)
def test_the_time_of_a_scan_is_as_the_receiver_says_or_the_scan_is_senseless(utc_s: object, fault: str | None) -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    receiver.wrong = {"utc_s": utc_s}
    scan = next(message for message in core.handle(_waveform(0)) if isinstance(message, Scan))
    assert scan.utc_s == (utc_s if fault is None else None)
    assert (scan.fault or "").startswith("" if fault is None else f"senseless scan: {fault}")


def test_cells_that_are_left_out_are_told_to_be_unmeasured() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    left = np.array([0, 1, 2, 7])
    receiver.wrong = {"bins": left} | {
        name: np.ones(4) for name in ("statistic", "alpha_hat", "sigma_hat", "signature_power")
    }
    (scan,) = core.handle(_waveform(0))
    assert isinstance(scan, Scan)
    assert scan.bins.tolist() == left.tolist()
    assert scan.unmeasured is not None
    assert np.array_equal(scan.unmeasured, np.delete(bin_centres(16), left))
    assert (scan.fault, core.trouble) == (None, "")
    assert (core.measures()["dwells_not_measured"], core.measures()["looks_not_measured"]) == (0, 12)


def test_in_real_time_a_front_end_that_fails_is_opened_again_after_longer_and_longer_pauses() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin(3, 2, rate_hz=8.0, dwells=3000))
    core.handle(_waveform(3))
    receiver.is_broken = True
    opened, sent = list[float](), list[Message]()
    for i in range(1000):
        before = receiver.opened
        sent += core.handle(Tick(i / 8.0))
        opened += [i / 8.0] * (receiver.opened - before)
    assert [type(message) for message in sent] == [Scan] * 1000  # the radar goes on
    scans = [message for message in sent if isinstance(message, Scan)]
    assert [scan.t for scan in scans] == list(range(4, 1004))
    assert {(scan.bins.size, scan.fault) for scan in scans} == {(0, "OSError: the cable is loose")}
    pauses = [after - before for before, after in pairwise([0.0, *opened])]
    assert pauses == [FIRST_S, 1.0, 2.0, 4.0, 8.0, 16.0, *[LONGEST_S] * 3]
    receiver.is_broken = False
    later = [message for i in range(1000, 1300) for message in core.handle(Tick(i / 8.0))]
    assert len(later) == 300
    assert sum(isinstance(scan, Scan) and scan.bins.size == 0 for scan in later) <= LONGEST_S * 8.0
    assert core.trouble == ""


def test_in_real_time_the_acquisition_waits_for_its_front_end() -> None:
    """No dwell is spent: after `max_scans` dwells it would be over."""
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin(rate_hz=10.0))
    receiver.is_broken = True
    most = RADAR.acquisition.max_scans
    said = [message for i in range(1000) for message in core.handle(Tick(i / 10.0))]
    told = [one for one in said if isinstance(one, Scan) and not one.bins.size and one.fault]  # now and then
    assert len(told) == len(said)
    assert [one.k for one in told] == list(range(n_said := int(100.0 / SAY_S)))
    receiver.is_broken = False
    sent = [message for i in range(1000, 1400 + most) for message in core.handle(Tick(i / 10.0))]
    scans = [message for message in sent if isinstance(message, Scan)]
    measured = [scan.k for scan in scans if scan.bins.size]
    assert (len(measured), measured[-1], measured[0] - n_said <= LONGEST_S / SAY_S) == (most, scans[-1].k, True)
    (end,) = [message for message in sent if isinstance(message, RunEnd)]
    assert f"within {most} scans; " in end.reason
    check_dwell(scans[-1].k, RADAR, 1)


def test_in_lockstep_an_acquisition_without_a_measurement_ends_with_the_reason() -> None:
    receiver = Receiver()
    receiver.wrong = {"sigma_hat": np.zeros(16)}
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    most = RADAR.acquisition.max_scans
    for k in range(most - 1):
        core.handle(_waveform(k, tracking=False))
        core.handle(_begin(k))
    (end,) = core.handle(_waveform(most - 1, tracking=False))
    assert isinstance(end, RunEnd)
    assert end.reason == (
        f"not every target was detected within 0 scans; nothing was measured in {most} dwells:"
        f" senseless scan: bin 0: a statistic of {most} with sigma_hat 0, which must be > 0"
    )


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


def test_a_fault_of_a_front_end_that_lasts_ends_its_run_alone() -> None:
    receiver = Receiver()
    receiver.fails_at, receiver.error = 0, OSError("the cable is loose")
    core = EmulatorCore(receiver.open)
    (end,) = core.handle(_begin())
    assert isinstance(end, RunEnd)
    reason = f"front end: OSError: the cable is loose; tried {ATTEMPTS} times"
    assert (end.status, end.reason) == ("failed", reason)


def test_front_ends_are_closed_with_the_process() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(_begin())
    core.close()
    assert receiver.closed == 1
    core.close()
    assert receiver.closed == 1
