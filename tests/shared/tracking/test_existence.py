"""How tracks of an unknown number begin, are confirmed, and end by the probability that there is a target."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad

from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.limits import ALERTS
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.belief.gaussian_mixture import GaussianMixture
from cogradar.shared.tracking.birth import born
from cogradar.shared.tracking.existence import (
    DOUBTED_BELOW,
    ENDED_BELOW,
    LEAST_P_D,
    MOST_ODDS,
    MOST_P_D,
    MOST_P_FA,
    BernoulliExistence,
    CertainExistence,
    Existence,
    TrackLooks,
    alert_p_fa,
    existence_of,
    hit_ratio,
    miss_ratio,
    p_fa_of,
)
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import coast

MISSED = TrackLooks(is_looked=True)
ONE_CELL = 1


def _radar(*settings: str) -> RadarConfig:
    return load("paper-best-range", ['radar.tracks="unknown"', *settings]).radar


def _existence(*settings: str) -> BernoulliExistence:
    existence = existence_of(_radar(*settings))
    assert isinstance(existence, BernoulliExistence)
    return existence


@cache
def _born() -> TrackState:
    model = TrackerModel.of(_radar(), Strategy.POWER_AWARE, seed=1)
    return born(model, 0, 0, np.array([0.1, 20.0, 40.25, 0.1, 1e-3, 0.5, 0.05, 100.0]))


def _after(existence: Existence, state: TrackState, own: TrackLooks, evidence: float) -> TrackState:
    return state._replace(**existence.after(state.existence, state.confirmed, own, evidence))


def _is_confirmed_by_noise(existence: BernoulliExistence, p_fa: float, p_d: float, rng: np.random.Generator) -> bool:
    """Whether a track becomes confirmed that begins with a detection of noise and is looked at where nothing is."""
    begun, limit = _born(), threshold(p_fa, ONE_CELL)
    r = np.sqrt(0.5 * threshold(p_fa * (1.0 - rng.random()), ONE_CELL))
    state = begun._replace(existence=existence.at_birth(limit, float(r), ONE_CELL), confirmed=False)
    while not existence.is_over(state, 1.0):
        if existence.is_confirmed(state.existence):
            return True
        u = rng.random()
        state = _after(existence, state, TrackLooks(is_looked=True, is_hit=u < p_fa, p_fa=p_fa, u=u), 1.0 - p_d)
    return False


@pytest.mark.parametrize("p_d", [0.5, 0.6, 0.9])  # of the looks that miss, as the belief of what is not there says
@pytest.mark.parametrize(("per_hour", "n_look"), [(20.0, 25), (20.0, 5), (20.0, 100), (200.0, 25)])
def test_as_many_false_tracks_are_confirmed_as_the_radar_is_allowed(per_hour: float, n_look: int, p_d: float) -> None:
    existence = _existence(f"radar.initiation.false_tracks_per_hour={per_hour}")
    rng, n_alert = np.random.default_rng(1), int(400 * ALERTS * 3600.0 / per_hour)
    n = sum(_is_confirmed_by_noise(existence, alert_p_fa(n_look), p_d, rng) for _ in range(n_alert))
    expected = n_alert * per_hour / (ALERTS * 3600.0)
    assert 0.5 * expected < n < 1.5 * expected


def test_more_false_tracks_than_there_are_alerts_are_refused() -> None:
    with pytest.raises(ScenarioError, match="must be at most 900, as the search has "):
        _radar("radar.initiation.false_tracks_per_hour=901")
    with pytest.raises(ScenarioError, match="must be at most 90, "):
        _radar("radar.initiation.false_tracks_per_hour=91", "radar.motion.dt_s=10")


def test_a_detection_is_weighed_by_a_likelihood_ratio() -> None:
    """Under a target u has a density that integrates to P_D over the detections, whatever the limit."""
    for p_fa in (1e-4, 0.01, 0.1):
        end = np.log(p_fa)
        found, _ = quad(lambda log_u, p_fa=p_fa: np.exp(log_u) * hit_ratio(p_fa, np.exp(log_u)), end - 60.0, end)
        assert found == pytest.approx(MOST_P_D, rel=1e-4)
    assert hit_ratio(1e-4, 1e-12) > hit_ratio(1e-4, 1e-5) > hit_ratio(0.1, 1e-5)


def test_no_more_than_a_tenth_of_the_looks_alerts_and_of_more_looks_each_has_fewer() -> None:
    assert alert_p_fa(1) == MOST_P_FA
    assert 10 * alert_p_fa(10) == pytest.approx(100 * alert_p_fa(100)) == ALERTS


def test_a_target_that_has_left_is_dropped_after_some_five_misses() -> None:
    existence = _existence()
    state = _born()._replace(existence=MOST_ODDS / (1.0 + MOST_ODDS), confirmed=True)
    misses = 0
    while not existence.is_over(state, 0.9):
        assert state.confirmed == (state.existence > DOUBTED_BELOW)
        state, misses = _after(existence, state, MISSED, 1.0 - MOST_P_D), misses + 1
    assert 5 <= misses <= 6


def test_what_is_found_now_and_then_is_kept_and_what_explains_every_miss_is_given_up() -> None:
    existence, kept = _existence(), _born()._replace(existence=0.5)
    for _ in range(50):  # found in one look of ten, as its belief says
        kept = _after(existence, kept, TrackLooks(is_looked=True, is_hit=True, p_fa=1e-4, u=1e-5), 0.0)
        for _ in range(9):
            kept = _after(existence, kept, MISSED, 0.9)
    assert kept.existence > 0.9
    misses = 0
    while kept.existence >= ENDED_BELOW:
        kept, misses = _after(existence, kept, MISSED, 1.0), misses + 1
    assert misses < 40


def test_a_look_that_was_not_measured_says_nothing() -> None:
    existence = _existence()
    for before in (0.1, 0.6, 0.99):
        after = existence.after(before, True, TrackLooks(is_unmeasured=True), 0.1)
        assert after == {"existence": pytest.approx(before), "confirmed": before > DOUBTED_BELOW}
        assert existence.after(before, True, TrackLooks(), 0.1)["existence"] < before


def test_a_track_that_no_look_goes_to_is_forgotten_and_sooner_if_tentative() -> None:
    existence, ended = _existence(), list[int]()
    for r in (0.1, 0.999):
        state, n = _born()._replace(existence=r), 0
        while not existence.is_over(state, 1.0):
            state, n = _after(existence, state, TrackLooks(), 0.1), n + 1
        ended.append(n)
    assert 5 < ended[0] < 20 < ended[1] < 100


def test_a_track_flies_out_of_the_field_of_view() -> None:
    """What has left is counted once, however many dwells go by."""
    survival, model = _existence().survival, TrackerModel.of(_radar(), Strategy.POWER_AWARE, seed=1)
    there, at_edge, gone = (model_belief(model, share * model.acquisition.range_max_km) for share in (0.5, 1.0, 2.0))
    a_dwell = np.exp(-1.0 / 600.0)
    assert survival(there, there) == pytest.approx(a_dwell)
    assert 0.3 < survival(there, at_edge) < 0.7
    assert survival(at_edge, gone) == survival(gone, gone) == 0.0
    assert survival(at_edge, at_edge) == pytest.approx(a_dwell)


def model_belief(model: TrackerModel, x_km: float) -> GaussianMixture:
    return GaussianMixture.of_moments(
        np.array([x_km, 0.0, 0.0, 0.0]), np.diag([0.5, 0.01, 0.5, 0.01]), model.is_mixture
    )


def test_an_echo_in_the_cell_of_another_is_no_reason_to_doubt_that_there_is_a_target() -> None:
    existence, state = _existence(), _born()._replace(existence=0.99)
    missed, hidden = (
        _after(existence, state, TrackLooks(is_looked=True, unresolved=p), 1.0 - MOST_P_D).existence
        for p in (0.0, 0.95)
    )
    assert hidden > 0.98 > missed
    assert miss_ratio(0.1, 1.0) == 1.0


def test_the_longer_a_dwell_the_more_targets_come_in_it_and_the_sooner_a_track_that_coasts_is_doubted() -> None:
    one, ten = _existence(), _existence("radar.motion.dt_s=10")
    limit = threshold(0.01, ONE_CELL)
    odds = [r / (1.0 - r) for r in (e.at_birth(limit, float(np.sqrt(0.5 * limit)), ONE_CELL) for e in (one, ten))]
    assert odds[1] == pytest.approx(10.0 * odds[0], rel=1e-9)
    belief = _born().belief
    assert ten.survival(belief, belief) < one.survival(belief, belief) < 1.0


def test_announced_targets_exist_whatever_is_missed() -> None:
    existence = existence_of(load("paper").radar)
    assert isinstance(existence, CertainExistence)
    state = _born()._replace(existence=1.0)
    assert existence.survival(state.belief, state.belief) == 1.0
    left = _after(existence, state, MISSED, 0.0)
    assert (left.existence, left.confirmed) == (1.0, state.confirmed)
    assert not existence.is_over(state, 0.0)
    assert existence.is_confirmed(existence.at_birth(20.0, 4.0, 1))


def test_a_belief_that_coasts_loses_existence_dwell_by_dwell() -> None:
    model, state = TrackerModel.of(_radar(), Strategy.POWER_AWARE, seed=1), _born()
    coasted = [coast(model, state, k).existence for k in range(1, 6)]
    assert (np.diff(coasted) < 0.0).all()
    assert coasted[0] == state.existence


@pytest.mark.parametrize(("p", "n_cell", "n_look"), [(1e-4, 1, 1), (1e-4, 18, 1), (0.05, 300, 1), (0.01, 20, 3)])
def test_p_fa_of_looks_follows_from_their_limit(p: float, n_cell: int, n_look: int) -> None:
    """Of looks with n cells each the receiver makes the limit so that one of them has a false alarm with p."""
    assert p_fa_of(threshold(p, n_cell), n_look * n_cell) == pytest.approx(1.0 - (1.0 - p) ** n_look)


def test_a_limit_that_nothing_false_passes_makes_a_detection_certain() -> None:
    limit = p_fa_of(1e6, 10)
    assert hit_ratio(limit, limit) > 1e4
    assert 0.0 < p_fa_of(1e-300, 10) <= 1.0


def test_a_stale_look_is_judged_by_the_belief_alone() -> None:
    existence = _existence()
    missed, unseen = TrackLooks(is_looked=True, is_stale=True), TrackLooks(is_stale=True)
    assert existence.after(0.5, True, missed, 0.99)["existence"] == pytest.approx(0.99 / 1.99)
    assert existence.after(0.5, True, unseen, 0.3)["existence"] == pytest.approx(0.5)


def test_a_look_that_was_not_measured_beside_a_miss_takes_no_odds() -> None:
    """The belief knows that the target is in the other look: the miss costs what it says, and no floor."""
    existence = _existence()
    partly, all_of_it = TrackLooks(is_looked=True, is_unmeasured=True), TrackLooks(is_looked=True)
    left = {own: existence.after(0.5, True, own, 0.99)["existence"] for own in (partly, all_of_it)}
    assert left[partly] == pytest.approx(0.99 / 1.99)
    assert left[all_of_it] == pytest.approx((1.0 - LEAST_P_D) / (2.0 - LEAST_P_D))
