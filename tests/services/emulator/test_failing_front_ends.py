"""Front ends that fail, block or cannot be opened: opened again, awaited, or the reason why a run ends."""

import re
from itertools import pairwise

import numpy as np
import pytest

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.dwell import SAY_S
from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, ScanData
from cogradar.services.emulator.kept_open import ATTEMPTS, FIRST_S, LONGEST_S
from cogradar.shared.protocol.admission import check_dwell
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import MAX_FAULT, EmulatorCheckpoint, Message, RunEnd, Scan
from cogradar.shared.protocol.recovery import WaveformRecall
from tests.services.emulator.receiver import RADAR, Receiver, begin, history, waveform_of


def test_in_lockstep_a_front_end_that_fails_is_opened_again_and_its_dwell_repeated() -> None:
    receiver = Receiver()
    receiver.fails_at, receiver.fails_for = 2, ATTEMPTS - 1
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    core.handle(waveform_of(0))
    (scan,) = core.handle(waveform_of(1))
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t, scan.unmeasured, scan.bins.size) == (2, 2, None, 16)
    assert (receiver.opened, receiver.closed) == (ATTEMPTS, ATTEMPTS - 1)
    assert core.measures()["front_end_failures"] == ATTEMPTS - 1


def test_in_lockstep_a_front_end_that_fails_for_good_ends_the_run_with_its_reason() -> None:
    receiver = Receiver()
    receiver.fails_at = 2
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    core.handle(waveform_of(0))
    (end,) = core.handle(waveform_of(1))
    reason = f"front end: the cable is out; tried {ATTEMPTS} times"
    assert end == RunEnd(run="r", k=1, t=1, status="failed", reason=reason)
    core.handle(begin(2, 1, resend=True))
    assert core.handle(Tick(0.0)) == [end]
    assert not core.handle(waveform_of(1))


def test_a_front_end_that_cannot_be_opened_at_the_beginning_ends_the_run_with_its_reason() -> None:
    def unavailable(_: EmulatorCheckpoint) -> FrontEnd:
        raise FrontEndError("it is in use")

    end = RunEnd(run="r", k=0, t=0, status="failed", reason="front end: it is in use")
    assert EmulatorCore(unavailable).handle(begin()) == [end]
    in_real_time = EmulatorCore(unavailable)
    assert in_real_time.handle(begin(rate_hz=10.0)) == []
    assert in_real_time.handle(Tick(1.0)) == [end]
    middle = EmulatorCore(unavailable)
    assert middle.handle(begin(3, 2)) == [WaveformRecall(run="r", k=2)]
    given_up = {"k": 2, "t": 2, "reason": f"front end: it is in use; tried {ATTEMPTS} times"}
    assert middle.handle(history(2)) == [end.model_copy(update=given_up)]


def test_a_front_end_that_cannot_prepare_is_opened_again() -> None:
    class Eager(Receiver):
        def prepare(self) -> bool:
            raise ValueError("not now")

    receiver = Eager()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    assert not core.prepare()
    (scan,) = core.handle(waveform_of(0))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, receiver.opened, receiver.closed) == (16, 2, 1)


def test_the_text_of_a_fault_is_cut_and_cleaned_where_it_comes_in() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin())
    receiver.returns = ScanData.not_measured("a\nERROR \x1b[2J" + "x" * 300)
    (scan,) = core.handle(waveform_of(0))
    assert isinstance(scan, Scan)
    assert scan.fault == ("a?ERROR ?[2J" + "x" * 300)[:MAX_FAULT]
    receiver.returns, receiver.wrong = None, {"fault": "late packet"}  # and yet all cells are there
    (scan,) = core.handle(waveform_of(1))
    assert isinstance(scan, Scan)
    assert (scan.bins.size, scan.fault) == (16, None)


def test_in_lockstep_a_fault_that_comes_back_is_logged_again(caplog: pytest.LogCaptureFixture) -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin(dwells=100))
    for k in range(90):
        receiver.wrong = {} if k % 30 >= 15 else {"sigma_hat": np.full(16, np.nan)}
        core.handle(waveform_of(k))
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
    core.handle(begin(3, 2, rate_hz=10.0, dwells=3000))
    core.handle(waveform_of(3))

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


def test_in_real_time_a_front_end_that_fails_is_opened_again_after_longer_and_longer_pauses() -> None:
    receiver = Receiver()
    core = EmulatorCore(receiver.open)
    core.handle(begin(3, 2, rate_hz=8.0, dwells=3000))
    core.handle(waveform_of(3))
    receiver.is_broken = True
    opened, sent = list[float](), list[Message]()
    for i in range(1000):
        before = receiver.opened
        sent += core.handle(Tick(i / 8.0))
        opened += [i / 8.0] * (receiver.opened - before)
    assert [type(message) for message in sent] == [Scan] * 1000  # the radar goes on
    scans = [message for message in sent if isinstance(message, Scan)]
    assert [scan.t for scan in scans] == list(range(4, 1004))
    ((size, fault),) = {(scan.bins.size, scan.fault) for scan in scans}
    assert size == 0
    assert re.fullmatch(r"receiver\.py, line \d+: OSError: the cable is loose", str(fault))
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
    core.handle(begin(rate_hz=10.0))
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
    core.handle(begin())
    most = RADAR.acquisition.max_scans
    for k in range(most - 1):
        core.handle(waveform_of(k, tracking=False))
        core.handle(begin(k))
    (end,) = core.handle(waveform_of(most - 1, tracking=False))
    assert isinstance(end, RunEnd)
    assert end.reason == (
        f"not every target was detected within 0 scans; nothing was measured in {most} dwells:"
        f" senseless scan: bin 0: a statistic of {most} with sigma_hat 0, which must be > 0"
    )


def test_a_fault_of_a_front_end_that_lasts_ends_its_run_alone() -> None:
    receiver = Receiver()
    receiver.fails_at, receiver.error = 0, OSError("the cable is loose")
    core = EmulatorCore(receiver.open)
    (end,) = core.handle(begin())
    assert isinstance(end, RunEnd)
    assert end.status == "failed"
    reason = rf"front end: receiver\.py, line \d+: OSError: the cable is loose; tried {ATTEMPTS} times"
    assert re.fullmatch(reason, end.reason)
