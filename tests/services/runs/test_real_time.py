"""The cores of a run in real time, with times given by hand: the radar transmits when it is due."""

from collections.abc import Sequence

import numpy as np
import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.wire.codec import encode
from tests.samples import asked
from tests.services.loop import SMOKE, checkpoint, play, scans, smoke_start

RATE_HZ = 10.0
PERIOD_S = 1.0 / RATE_HZ


def _start(dwells: int = 6) -> RunStart:
    return smoke_start(dwells=dwells).model_copy(update={"rate_hz": RATE_HZ})


def _waveform(k: int, beams: tuple[int, int] = (3, 12), late: tuple[int, int] = (0, 0)) -> Waveform:
    return Waveform(
        run="r",
        k=k,
        tracking=True,
        isotropic=0.0,
        factor=np.full((SMOKE.radar.array.n_tx, 1), 0.25, dtype=np.complex64),
        beams=np.array(beams, dtype=np.int32)[:, np.newaxis],
        shares=np.full((2, 1), 0.5),
        status="fixed",
        late=np.array(late, dtype=np.int32),
    )


def _plan(target: int, k: int, bin_: int = 3, state: tuple[float, ...] = (40.0, 0.0, 0.0, 0.0)) -> Plan:
    estimate = np.array(state)
    return Plan(
        run="r",
        k=k,
        t=1,
        target=target,
        status="tracking",
        **asked(bin_),
        range_km=float(estimate[0]),
        estimate=estimate,
    )


def _radiated(sent: Sequence[Message]) -> list[tuple[int, int, int]]:
    return [(m.k, m.t, m.waveform_k) for m in sent if isinstance(m, Truth)]


# The emulator.


def test_the_emulator_transmits_when_it_is_due_and_not_before() -> None:
    assert EmulatorCore(SimulatedFrontEnd.open).wake_s is None
    core = EmulatorCore(SimulatedFrontEnd.open)
    assert core.handle(checkpoint(_start())) == []
    assert (core.has_deferred, core.wake_s) == (True, None)
    assert _radiated(core.handle(Tick(100.0))) == [(0, 0, -1)]
    assert core.wake_s == pytest.approx(100.1)
    assert core.has_deferred is False
    assert core.handle(_waveform(0)) == []
    assert core.handle(Tick(100.05)) == []
    assert _radiated(core.handle(Tick(100.1))) == [(1, 1, 0)]
    assert core.wake_s == pytest.approx(100.2)


def test_the_emulator_goes_on_with_the_newest_waveform_and_says_which() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(_start()))
    for now_s in (0.0, 0.5):
        core.handle(Tick(now_s))
    for k in (1, 0):  # the older one comes later and is not taken
        core.handle(_waveform(k, beams=(3 + k, 12)))
    sent = [*core.handle(Tick(1.0)), *core.handle(Tick(1.11)), *core.handle(Tick(1.21)), *core.handle(Tick(1.31))]
    assert _radiated(sent) == [(2, 1, 1), (3, 2, 1), (4, 3, 1), (5, 4, 1)]
    assert all(scan.beams.tolist() == [[4], [12]] for scan in sent if isinstance(scan, Scan))


def test_overdue_dwells_are_not_made_up_for() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(_start()))
    core.handle(Tick(0.0))
    core.handle(_waveform(0))
    assert _radiated(core.handle(Tick(5.0))) == [(1, 1, 0)]
    assert core.handle(Tick(5.05)) == []
    assert _radiated(core.handle(Tick(5.11))) == [(2, 2, 0)]  # a little late: the next one is due as before
    assert core.wake_s == pytest.approx(5.2)


def test_a_run_in_real_time_ends_whether_or_not_waveforms_come() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(_start(dwells=3)))
    core.handle(Tick(0.0))
    core.handle(_waveform(0))
    sent = [m for i in range(1, 10) for m in core.handle(Tick(float(i)))]
    assert _radiated(sent) == [(1, 1, 0), (2, 2, 0), (3, 3, 0)]
    (end,) = [m for m in sent if isinstance(m, RunEnd)]
    assert (end.status, end.k, end.t) == ("complete", 3, 3)
    assert core.wake_s is None


def test_an_emulator_that_comes_back_asks_for_a_waveform_and_transmits_once_it_has_one() -> None:
    core, start = EmulatorCore(SimulatedFrontEnd.open), _start(dwells=50)
    assert core.handle(checkpoint(start, 8, 5)) == [WaveformRecall(run="r", k=7)]
    assert core.handle(Tick(0.0)) == []  # in mid-run it cannot light up every cell: tracks ask for beams
    core.handle(History(run="r", to="emulator", topic="waveform", k=7, payloads=[encode(_waveform(7))]))
    assert _radiated(core.handle(Tick(1.0))) == [(8, 6, 7)]


def test_an_emulator_that_was_away_goes_on_where_the_others_are() -> None:
    """The targets flew meanwhile: their states are those of the clock, as if every dwell had happened."""
    away, present, start = EmulatorCore(SimulatedFrontEnd.open), EmulatorCore(SimulatedFrontEnd.open), _start(dwells=50)
    away.handle(checkpoint(start, 8, 5))
    away.handle(_waveform(20))
    present.handle(checkpoint(start, 21, 18))
    present.handle(_waveform(20))
    one, other = away.handle(Tick(0.0)), present.handle(Tick(0.0))
    assert _radiated(one) == [(21, 19, 20)]
    assert [encode(m) for m in one] == [encode(m) for m in other]


def test_an_emulator_that_was_away_beyond_the_end_ends_the_run() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(checkpoint(_start(dwells=6), 8, 5))
    core.handle(_waveform(20))
    (end,) = core.handle(Tick(0.0))
    assert isinstance(end, RunEnd)
    assert (end.status, end.t) == ("complete", 6)


# The allocator.


def _allocator() -> AllocatorCore:
    core = AllocatorCore()
    assert core.handle(checkpoint(_start())) == []
    return core


def _complete(core: AllocatorCore, k: int, now_s: float) -> None:
    """Dwell k is answered in time, and the clock is known."""
    core.handle(_plan(0, k))
    assert len(core.handle(_plan(1, k, bin_=9))) == 1
    assert core.handle(Tick(now_s)) == []


def test_a_complete_dwell_is_answered_at_once() -> None:
    core = _allocator()
    assert core.handle(_plan(0, 0)) == ()
    (answer,) = core.handle(_plan(1, 0, bin_=9))
    assert isinstance(answer, Waveform)
    assert (answer.k, answer.beams.tolist(), answer.late.tolist()) == (0, [[3], [9]], [0, 0])


def test_half_a_period_after_the_first_plan_the_missing_ones_are_extrapolated() -> None:
    """A target that flies at constant velocity is where its plan of three dwells ago says: bin and range."""
    core, n, v = _allocator(), SMOKE.radar.array.n_bin, np.array([0.0, 0.3, 0.0, 2.0])
    state = np.array([40.0, 0.3, 10.0, 2.0])  # fast enough to change its bin
    core.handle(_plan(0, 0))
    meant = state + SMOKE.radar.motion.dt_s * np.array([v[1], 0.0, v[3], 0.0])  # at dwell 1
    core.handle(_plan(1, 0, bin_=int(angle_bin(spatial_frequency(meant), n)), state=tuple(state)))
    core.handle(_plan(0, 3))
    assert core.handle(Tick(50.0)) == []  # the clock is known from here on
    assert core.wake_s == pytest.approx(50.0 + 0.5 * PERIOD_S)
    (answer,) = core.handle(Tick(50.0 + 0.5 * PERIOD_S))
    assert isinstance(answer, Waveform)
    dwells = 4  # from dwell 0, which the estimate is of, to dwell 4, which waveform 3 lights up
    there = state + SMOKE.radar.motion.dt_s * dwells * np.array([v[1], 0.0, v[3], 0.0])
    bin_ = int(angle_bin(spatial_frequency(there), n))
    assert (answer.k, answer.beams.tolist(), answer.late.tolist()) == (3, [[3], [bin_]], [0, 3])
    assert bin_ != int(angle_bin(spatial_frequency(state), n))
    range_km = float(np.hypot(there[0], there[2]))
    other = _allocator()
    other.handle(_plan(0, 3))
    (expected,) = other.handle(_plan(1, 3, bin_=bin_, state=(range_km, 0.0, 0.0, 0.0)))
    assert isinstance(expected, Waveform)
    np.testing.assert_allclose(answer.shares, expected.shares, rtol=1e-5)


def _come_to(core: AllocatorCore, k: int, now_s: float) -> None:
    """The radar comes to dwell k, and the clock is known."""
    scan = next(one for one in scans(play(smoke_start())) if one.t == 1)
    assert core.handle(scan.model_copy(update={"k": k, "t": k + 1})) == ()
    assert core.handle(Tick(now_s)) == []


def test_without_any_plan_a_waveform_is_said_half_a_period_after_its_scan() -> None:
    core = _allocator()
    _complete(core, 0, now_s=10.0)
    assert core.wake_s is None
    for k, now_s in ((1, 11.0), (2, 20.0)):
        _come_to(core, k, now_s)
        assert core.wake_s == pytest.approx(now_s + 0.5 * PERIOD_S)
        assert core.handle(Tick(now_s + 0.4 * PERIOD_S)) == []
        (answer,) = core.handle(Tick(now_s + 0.5 * PERIOD_S))
        assert isinstance(answer, Waveform)
        assert (answer.k, answer.late.tolist()) == (k, [k, k])


def test_a_late_plan_changes_nothing_but_the_next_extrapolation() -> None:
    core = _allocator()
    _complete(core, 0, now_s=10.0)
    _come_to(core, 1, 11.0)
    assert len(core.handle(Tick(11.0 + 0.5 * PERIOD_S))) == 1
    for m, bin_ in enumerate((4, 10)):  # of dwell 1, which is answered
        assert core.handle(_plan(m, 1, bin_=bin_, state=(30.0, 0.0, 0.0, 0.0))) == ()
    _come_to(core, 2, 20.0)
    (answer,) = core.handle(Tick(20.0 + 0.5 * PERIOD_S))
    assert isinstance(answer, Waveform)
    assert (answer.k, answer.beams.tolist(), answer.late.tolist()) == (2, [[4], [10]], [1, 1])  # they stand still


def test_nothing_is_said_while_nothing_is_known_of_a_track() -> None:
    core = _allocator()
    core.handle(_plan(0, 0))
    core.handle(Tick(1.0))
    assert core.handle(Tick(2.0)) == []
    assert core.wake_s is None


def test_an_allocator_that_comes_back_ignores_what_is_stored() -> None:
    core = AllocatorCore()
    core.handle(checkpoint(_start(), 5, 2))
    assert [m for k in range(5) for target in (0, 1) for m in core.handle(_plan(target, k))] == []
    assert core.handle(_plan(0, 5)) == ()
    (answer,) = core.handle(_plan(1, 5))
    assert isinstance(answer, Waveform)
    assert answer.k == 5
