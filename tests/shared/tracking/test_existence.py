"""When tracks of an unknown number are confirmed and given up."""

from itertools import product

import numpy as np
import pytest

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.birth import born
from cogradar.shared.tracking.existence import (
    AT_BIRTH,
    ENDED_BELOW,
    MOST_P_FA,
    JudgedExistence,
    after_hit,
    after_miss,
    alert_p_fa,
    existence_of,
    p_fa_of,
)
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.track import coast


def _existence(radar: RadarConfig) -> JudgedExistence:
    existence = existence_of(radar)
    assert isinstance(existence, JudgedExistence)
    return existence


def _radar(*settings: str) -> RadarConfig:
    return load("paper-best-range", ['radar.tracks="unknown"', *settings]).radar


def _confirmed(existence: JudgedExistence, looks: tuple[bool, ...]) -> bool:
    """Whether a track is confirmed whose looks after its first detection come out like this."""
    n_look, n_hit = 1, 1
    for is_hit in looks:
        n_look, n_hit = n_look + 1, n_hit + is_hit
        if existence.is_confirmed(n_hit):
            return True
        if existence.has_failed(n_look, n_hit):
            return False
    raise AssertionError("undecided after its window")


@pytest.mark.parametrize(("confirmations", "window"), [(2, 2), (2, 3), (3, 4), (3, 7)])
@pytest.mark.parametrize("per_hour", [0.1, 1.0, 20.0])
def test_as_many_false_tracks_are_expected_as_the_radar_is_allowed(
    confirmations: int, window: int, per_hour: float
) -> None:
    """Every outcome of the looks of a window, played by the rule itself."""
    initiation = f"radar.initiation={{confirmations={confirmations},window={window},false_tracks_per_hour={per_hour}}}"
    radar = _radar(initiation, "radar.search.beams=5")
    existence, p = _existence(radar), alert_p_fa(radar, 5)
    outcomes = [looks for looks in product((True, False), repeat=window - 1) if _confirmed(existence, looks)]
    chance = sum(p ** sum(looks) * (1.0 - p) ** (window - 1 - sum(looks)) for looks in outcomes)
    assert 3600.0 * 5 * p * chance == pytest.approx(per_hour)


def test_no_more_than_a_tenth_of_the_looks_alerts() -> None:
    assert alert_p_fa(_radar("radar.initiation.false_tracks_per_hour=1e5"), 4) == MOST_P_FA


def test_what_is_never_found_again_is_given_up_and_what_is_found_now_and_then_is_kept() -> None:
    existence = after_hit(AT_BIRTH, 0.01)
    assert existence == pytest.approx(0.9 / 0.91)
    for _ in range(20):
        existence = after_hit(existence, 1e-4)
    misses = 0
    while existence >= ENDED_BELOW:
        existence, misses = after_miss(existence, 1e-9), misses + 1
    assert 5 <= misses <= 7
    kept = AT_BIRTH
    for _ in range(50):  # found in one look of ten, as its model says
        kept = after_hit(kept, 1e-4)
        for _ in range(9):
            kept = after_miss(kept, 0.9)
    assert kept > 0.9


def test_a_track_whose_model_explains_every_miss_is_given_up_all_the_same() -> None:
    existence, misses = after_hit(AT_BIRTH, 0.01), 0
    while existence >= ENDED_BELOW:
        existence, misses = after_miss(existence, 1.0), misses + 1
    assert misses < 40


def test_a_known_number_of_tracks_has_nothing_to_search() -> None:
    with pytest.raises(ValueError, match="known"):
        alert_p_fa(load("paper").radar, 4)


def test_of_more_looks_each_has_fewer_false_alarms() -> None:
    radar = _radar()
    p = alert_p_fa(radar, radar.array.n_bin)
    assert 3600.0 * radar.array.n_bin * p * (1.0 - (1.0 - p) ** 2) == pytest.approx(1.0)
    assert p < alert_p_fa(radar, 4)


def test_a_tentative_track_ends_after_its_window_without_a_detection_lit_or_not() -> None:
    model = TrackerModel.of(_radar(), Strategy.POWER_AWARE, seed=1)
    state = born(model, 0, 0, np.array([0.1, 20.0, 40.25, 0.1, 1e-3, 0.5, 0.05, 100.0]))
    ended = [_existence(_radar()).is_over(coast(model, state, k), chance=1.0) for k in range(1, 6)]
    assert ended == [False, False, False, True, True]


@pytest.mark.parametrize(("p", "n_cell", "n_look"), [(1e-4, 1, 1), (1e-4, 18, 1), (0.05, 300, 1), (0.01, 20, 3)])
def test_p_fa_of_looks_follows_from_their_limit(p: float, n_cell: int, n_look: int) -> None:
    """Of looks with n cells each the receiver makes the limit so that one of them has a false alarm with p."""
    assert p_fa_of(threshold(p, n_cell), n_look * n_cell) == pytest.approx(1.0 - (1.0 - p) ** n_look)


def test_a_limit_that_nothing_false_passes_makes_a_detection_certain() -> None:
    assert after_hit(AT_BIRTH, p_fa_of(1e6, 10)) > 0.9999
    assert 0.0 < p_fa_of(1e-300, 10) <= 1.0
