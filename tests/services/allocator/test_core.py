import numpy as np
import pytest
from pydantic import ValidationError

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.allocator.track_update import unchanged
from cogradar.services.allocator.waveform import coasted, waveform
from cogradar.services.delivery.resend import MAX_DWELLS
from cogradar.shared.protocol.events import Rewind, Tick
from cogradar.shared.protocol.fields import FAR
from cogradar.shared.protocol.messages import Plan, Scan, Waveform
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import beampattern
from cogradar.shared.wire.codec import encode
from tests.samples import asked, sample
from tests.scenarios import varied
from tests.services.loop import SMOKE, checkpoint, play, scans, smoke_begin, smoke_start


def _plan(target: int, k: int = 0, bin_: int = 3, range_km: float = 40.0) -> Plan:
    return Plan(run="r", k=k, t=1, target=target, status="tracking", **asked(bin_), range_km=range_km)


def _searching(target: int, k: int = 0) -> Plan:
    return Plan(run="r", k=k, t=0, target=target, status="searching")


def _started() -> AllocatorCore:
    core = AllocatorCore()
    assert not core.handle(smoke_begin())
    return core


def test_answers_once_every_track_has_spoken() -> None:
    core = _started()
    assert not core.handle(_plan(0))
    assert not core.handle(_plan(0))  # twice the same counts once
    (answer,) = core.handle(_plan(1, bin_=9))
    assert isinstance(answer, Waveform)
    assert (answer.k, answer.tracking, answer.beams.tolist()) == (0, True, [[3], [9]])
    assert not core.handle(_plan(1, bin_=9))  # dwell 0 is answered


def test_order_of_arrival_does_not_matter() -> None:
    one, other = _started(), _started()
    one.handle(_plan(0))
    (first,) = one.handle(_plan(1, bin_=9))
    other.handle(_plan(1, bin_=9))
    (second,) = other.handle(_plan(0))
    assert encode(first) == encode(second)


def test_each_dwell_is_answered_as_soon_as_it_is_complete() -> None:
    """A waveform is a function of its own dwell's plans: an allocator that comes back need not begin at the first."""
    core = _started()
    core.handle(_plan(0, k=1))
    (first,) = core.handle(_plan(1, k=1))
    core.handle(_plan(0, k=0))
    (second,) = core.handle(_plan(1, k=0))
    assert [answer.k for answer in (first, second) if isinstance(answer, Waveform)] == [1, 0]


def test_a_rewound_run_begins_anew() -> None:
    """The journal was restored from an older state: the planners plan again, and the waveforms are the same."""
    core, start = _started(), smoke_start()
    sent = [answer for k in range(3) for m in (0, 1) for answer in core.handle(_plan(m, k=k))]
    assert core.handle(checkpoint(start, 3)) == ()
    assert core.handle(_plan(0, k=1)) == ()  # acknowledged
    core.handle(Rewind(start.run))
    assert core.handle(checkpoint(start, 1)) == []
    again = [answer for k in range(1, 3) for m in (0, 1) for answer in core.handle(_plan(m, k=k))]
    assert again == sent[1:]


def test_in_real_time_a_lower_checkpoint_changes_nothing() -> None:
    """No dwell can be repeated: what the journal lost stays lost, and the run goes on where it is."""
    core, start = AllocatorCore(), smoke_start().model_copy(update={"rate_hz": 10.0})
    core.handle(checkpoint(start))
    for k in range(3):
        core.handle(_plan(0, k=k))
        core.handle(_plan(1, k=k))
    core.handle(checkpoint(start, 3))
    core.handle(checkpoint(start, 1))
    assert core.handle(_plan(0, k=3)) == ()
    (answer,) = core.handle(_plan(1, k=3))
    assert isinstance(answer, Waveform)
    assert answer.k == 3


def test_in_real_time_the_radar_may_have_been_away_for_more_dwells_than_are_kept() -> None:
    """A scan says how far it is, which is of no other use where the number of tracks is known."""
    core, start = AllocatorCore(), smoke_start(dwells=2000).model_copy(update={"rate_hz": 10.0})
    core.handle(checkpoint(start))
    core.handle(_plan(0))
    core.handle(_plan(1, bin_=9))
    k = MAX_DWELLS + 9
    assert core.handle(sample(Scan, run="r", k=k, t=k)) == ()
    core.handle(_plan(0, k=k))
    (answer,) = core.handle(_plan(1, k=k, bin_=9))
    assert isinstance(answer, Waveform)
    assert answer.k == k


def test_in_real_time_the_acquisition_waits_for_the_radar() -> None:
    """A front end that measures nothing repeats a dwell: no waveform is made by the clock until its plans come."""
    core, start = AllocatorCore(), smoke_start().model_copy(update={"rate_hz": 4.0})
    core.handle(checkpoint(start))
    core.handle(Tick(0.0))
    for k in range(3):
        core.handle(_searching(0, k=k))
        (answer,) = core.handle(_searching(1, k=k))
        assert isinstance(answer, Waveform)
        assert (answer.k, answer.tracking) == (k, False)
        assert not any(core.handle(Tick(10.0 * k + i)) for i in range(1, 10))
    core.handle(_plan(0, k=3))
    core.handle(Tick(40.0))
    (late,) = core.handle(Tick(40.2))  # one of its plans is lost
    assert isinstance(late, Waveform)
    assert late.k == 3


def test_in_real_time_a_clock_that_leaps_makes_no_plan_late() -> None:
    """Once it answered a period after its last answer: after a leap each time before the plans."""
    core, start = AllocatorCore(), smoke_start(dwells=100).model_copy(update={"rate_hz": 10.0})
    core.handle(checkpoint(start))
    core.handle(Tick(0.0))
    found, now_s, ahead_s = list[Waveform](), 0.0, 0.0

    def go_on(until_s: float) -> None:
        nonlocal now_s
        while True:
            if core.has_deferred:
                found.extend(one for one in core.handle(Tick(now_s)) if isinstance(one, Waveform))
            if (due_s := core.wake_s) is None or due_s > until_s:
                break
            now_s = max(now_s, due_s)
            found.extend(one for one in core.handle(Tick(now_s)) if isinstance(one, Waveform))
        now_s = until_s

    for k in range(20):
        if k == 5:
            now_s, ahead_s = 0.1 * k + 1.601, 1.6
        go_on(ahead_s + 0.1 * k + 0.002)
        for target in range(2):
            found += [one for one in core.handle(_plan(target, k=k, bin_=3 + 6 * target)) if isinstance(one, Waveform)]
        go_on(ahead_s + 0.1 * k + 0.003)
    assert not any(waveform.late.any() for waveform in found)
    assert [waveform.k for waveform in found] == list(range(20))


def test_in_real_time_an_announced_number_is_answered_for_no_dwell_that_the_radar_has_not_come_to() -> None:
    """By the clock it went ahead of a receiver that was slower than its rate, and all plans came late."""
    core, start = AllocatorCore(), smoke_start(dwells=100).model_copy(update={"rate_hz": 10.0})
    core.handle(checkpoint(start))
    scan = next(one for one in scans(play(smoke_start())) if one.t == 1)

    def at(k: int) -> Scan:
        return scan.model_copy(update={"k": k, "t": k + 1})

    core.handle(at(0))
    said = [core.handle(_plan(target, k=0)) for target in range(2)]
    assert [len(one) for one in said] == [0, 1]
    assert [core.handle(Tick(0.1 * i)) for i in range(50)] == 50 * [[]]
    core.handle(at(1))  # and no plan comes: half a period later the plans before are extrapolated
    assert core.handle(Tick(5.0)) == []
    assert core.handle(Tick(5.049)) == []
    (answer,) = core.handle(Tick(5.051))
    assert isinstance(answer, Waveform)
    assert (answer.k, answer.late.tolist()) == (1, [1, 1])
    assert [core.handle(Tick(6.0 + i)) for i in range(5)] == 5 * [[]]


@pytest.mark.parametrize("strategy", list(Strategy))
def test_an_estimate_at_the_very_edge_can_be_extrapolated(strategy: Strategy) -> None:
    """A plan may claim any state that its message allows; one planner that does must not end the allocator."""
    core, start = AllocatorCore(), smoke_start(strategy).model_copy(update={"rate_hz": 1.0})
    core.handle(checkpoint(start))
    edge = {"range_km": FAR, "estimate": np.full(4, FAR)}
    for k in range(2):
        core.handle(_plan(0, k=k).model_copy(update=edge))
        core.handle(_plan(1, k=k))
    core.handle(next(one for one in scans(play(smoke_start())) if one.t == 3).model_copy(update={"k": 2}))
    core.handle(Tick(0.0))
    (answer,) = core.handle(Tick(2.0))
    assert isinstance(answer, Waveform)
    assert np.isfinite(answer.factor).all()
    assert answer.late.tolist() == [1, 1]


@pytest.mark.parametrize("field", [{"range_km": 1e308}, {"estimate": np.array([0.0, 1e308, 0.0, 0.0])}])
def test_a_plan_beyond_it_is_no_message(field: dict[str, object]) -> None:
    fields = {"run": "r", "k": 0, "t": 1, "target": 0, "status": "tracking", **asked(3), **field}
    with pytest.raises(ValidationError):
        Plan.model_validate(fields)


def test_what_is_not_acknowledged_is_resent_when_the_recorder_asks() -> None:
    core, start = _started(), smoke_start()
    said = [answer for k in range(3) for m in (0, 1) for answer in core.handle(_plan(m, k=k))]
    assert core.handle(checkpoint(start, 1)) == ()
    assert core.handle(checkpoint(start, 1, resend=True)) == ()
    assert core.has_deferred
    assert core.handle(Tick(0.0)) == said[1:]
    assert core.handle(_plan(0, k=0)) == ()  # acknowledged long since


def test_plans_heard_before_the_start_of_their_run_are_kept() -> None:
    core = AllocatorCore()
    core.handle(_plan(0))
    core.handle(_plan(1, bin_=9))
    (answer,) = core.handle(smoke_begin())
    assert isinstance(answer, Waveform)


def test_nothing_is_answered_after_the_end() -> None:
    core = _started()
    core.handle(checkpoint(smoke_start(), 4, 4, ended=True))
    assert not core.handle(_plan(0))


def test_acquisition_is_orthogonal() -> None:
    answer = waveform(SMOKE.radar, Strategy.POWER_AWARE, unchanged([_searching(0), _searching(1)], 0))
    assert (answer.tracking, answer.isotropic, answer.factor.shape) == (False, SMOKE.radar.array.power, (16, 0))
    assert answer.beams.tolist() == [[-1], [-1]]


@pytest.mark.parametrize("strategy", list(Strategy))
def test_the_power_is_all_spent_and_no_more(strategy: Strategy) -> None:
    answer = waveform(
        SMOKE.radar, strategy, unchanged([_plan(0, bin_=3, range_km=30), _plan(1, bin_=9, range_km=80)], 0)
    )
    spent = answer.isotropic + float(np.sum(np.abs(answer.factor.astype(np.complex128)) ** 2))
    assert spent == pytest.approx(SMOKE.radar.array.power, rel=1e-6)  # complex64 on the wire


def test_power_aware_gives_both_targets_the_same_expected_echo() -> None:
    """With bins far apart the optimum equalises delta_m a^T R a^*, delta = R^-4 (KKT: both constraints active)."""
    ranges, bins = np.array([30.0, 80.0]), [3, 9]
    answer = waveform(
        SMOKE.radar, Strategy.POWER_AWARE, unchanged([_plan(m, bin_=bins[m], range_km=ranges[m]) for m in (0, 1)], 0)
    )
    gain = beampattern(0.0, answer.factor.astype(np.complex128), bin_centres(16)[bins])
    echo = gain * ranges**-4
    assert echo[0] == pytest.approx(echo[1], rel=1e-5)
    assert answer.status == "optimal"


def test_both_solvers_of_the_scenario_find_the_same_waveform() -> None:
    """Not the same factor (its columns may be rotated), but the same covariance R and shares."""
    plans = [_plan(0, bin_=3, range_km=30), _plan(1, bin_=4, range_km=80)]
    other = varied(SMOKE, allocation={"solver": "sdp"})
    ours, reference = (
        waveform(scenario.radar, Strategy.POWER_AWARE, unchanged(plans, 0)) for scenario in (SMOKE, other)
    )
    covariances = [answer.factor @ answer.factor.conj().T for answer in (ours, reference)]
    np.testing.assert_allclose(covariances[0], covariances[1], atol=1e-5)  # complex64, solver's gap 1e-6
    np.testing.assert_allclose(ours.shares, reference.shares, atol=1e-5)


def test_a_target_on_top_of_the_array_leaves_the_power_to_the_others() -> None:
    answer = waveform(
        SMOKE.radar, Strategy.POWER_AWARE, unchanged([_plan(0, bin_=3, range_km=0.0), _plan(1, bin_=9, range_km=80)], 0)
    )
    assert answer.shares[1, 0] == pytest.approx(SMOKE.radar.array.power, rel=1e-6)


def test_uniform_gives_both_beams_the_same_power() -> None:
    answer = waveform(
        SMOKE.radar, Strategy.UNIFORM, unchanged([_plan(0, bin_=3, range_km=30), _plan(1, bin_=9, range_km=80)], 0)
    )
    assert answer.shares.tolist() == [[0.5], [0.5]]
    column_power = np.sum(np.abs(answer.factor) ** 2, axis=0)
    assert column_power == pytest.approx([0.5, 0.5], rel=1e-6)


@pytest.mark.parametrize(
    ("bins", "speed", "expected", "best"),
    [
        ([8, 9, 7], 0.0, [8, 9, 7], 9),  # it stays where it is
        ([8, 9, 7], 1.0, [10, 11, 9], 11),
        ([14, 15, 13], 1.0, [15], 15),  # at the edge of the grid cells meet: the first's chance
    ],
)
def test_a_late_plan_claims_no_more_than_it_did(bins: list[int], speed: float, expected: list[int], best: int) -> None:
    """Its cells move as its estimate does; what it knew of them is not more certain for being old."""
    radar = varied(SMOKE, motion={"dt_s": 10.0}).radar
    cells = {"bins": np.array(bins, np.int32), "chances": np.array([0.4, 0.35, 0.2]), "best_bin": bins[1]}
    state = {"range_km": 40.0, "estimate": np.array([40.0, 0.0, 0.0, speed]), "worth": 0.3, "gain": 2.0}
    late = coasted(radar, _plan(0).model_copy(update=cells | state), 1)
    assert late.bins.tolist() == expected
    assert late.chances.tolist() == [0.4, 0.35, 0.2][: len(expected)]
    assert (late.k, late.best_bin, late.worth) == (1, best, 0.3)
    Plan.model_validate({name: getattr(late, name) for name in Plan.model_fields})
