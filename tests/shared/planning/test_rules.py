"""The rules for choosing a bin, and which of them decides when time is short."""

from math import sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.planning.pomcp import SearchSettings, search
from cogradar.shared.planning.radar_pomdp import RadarPomdp, legal_actions, problem_of
from cogradar.shared.planning.rules import MIN_VISITS, Choice, chosen_bin, mean, mode, most_probable_bin, pomcp
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.tables import BIN_RULES
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import Sensor

RADAR = load("paper").radar
SETTINGS = SearchSettings(12_000, 2, 100, True, 0.8, sqrt(2.0))
SENSOR, MOTION = Sensor(100, 60.0, -2.0 * np.log(1e-4)), Motion(1.0, 0.004)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def belief(spread: tuple[float, ...]) -> NDArray[np.float64]:
    return np.asarray(np.array([60.0, 0.2, 7.5, 0.1]) + np.array(spread) * rng(99).standard_normal((2000, 4)))


WIDE, NARROW = belief((0.5, 0.1, 0.5, 0.1)), belief((0.05, 0.01, 0.05, 0.01))  # some three bins, one

# Two thirds of it in one bin, one third some bins on, and nothing between: what a miss leaves of a belief.
SPLIT = np.repeat([[60.0, 0.0, 2.0, 0.0], [60.0, 0.0, 8.0, 0.0]], (800, 400), axis=0)

# The likelier bin is too far away to be detected, so that a look into the other one tells more.
UNEQUAL = np.repeat([[150.0, 0.0, 2.0, 0.0], [20.0, 0.0, 8.0, 0.0]], (620, 600), axis=0)


def problem(particles: NDArray[np.float64], sigma_hat: float = 0.05) -> RadarPomdp:
    return problem_of(particles, sigma_hat, SENSOR, MOTION)


def radar(**changed: object) -> RadarConfig:
    return RADAR.model_copy(update={"planner": RADAR.planner.model_copy(update=changed)})


def published(**changed: object) -> RadarConfig:
    return radar(**changed).model_copy(update={"belief": RADAR.belief.model_copy(update={"filter": "published"})})


def expected_bins(particles: NDArray[np.float64]) -> NDArray[np.int64]:
    moved = particles + np.column_stack((particles[:, 1], 0 * particles[:, 1], particles[:, 3], 0 * particles[:, 1]))
    return np.bincount(angle_bin(spatial_frequency(moved), 100), minlength=100)


def test_the_rules_by_name() -> None:
    chosen = {rule: chosen_bin(problem(SPLIT), radar(rule=rule), rng()).bin for rule in BIN_RULES}
    assert chosen == {"pomcp": 51, "mode": 51, "mean": 53, "exact": 51}
    assert mode(problem(WIDE)) == Choice(int(expected_bins(WIDE).argmax()), 0)
    assert mean(problem(NARROW)).bin == expected_bins(NARROW).argmax()


def test_the_most_probable_bin_has_most_predicted_particles() -> None:
    assert most_probable_bin(WIDE, 100, 1.0) == expected_bins(WIDE).argmax()
    assert most_probable_bin(np.array([[60.0, 0.0, 0.0, 30.0]]), 100, 1.0) != most_probable_bin(WIDE, 100, 1.0)


@pytest.mark.parametrize("is_mean", [True, False], ids=["mean", "random"])
def test_all_actions_and_those_of_the_belief_choose_the_same_bin(is_mean: bool) -> None:
    best = int(expected_bins(NARROW).argmax())
    for actions in (np.arange(100), legal_actions(NARROW, 100, 1.0, RADAR.planner.widen_bins)):
        settings = SETTINGS._replace(rollout_mean=is_mean)
        assert search(problem(NARROW, 0.02), actions, settings, rng()).action == best
    assert pomcp(problem(NARROW, 0.02), published(), rng()) == Choice(best, 12_000)


def test_the_published_search_may_choose_any_bin_and_plays_its_rollouts() -> None:
    settings = SETTINGS._replace(rollout_mean=False)
    for seed in range(5):
        expected = search(problem(WIDE), np.arange(100), settings, rng(seed)).action
        assert pomcp(problem(WIDE), published(), rng(seed)).bin == expected


def test_the_search_is_that_of_the_settings() -> None:
    actions = legal_actions(WIDE, 100, 1.0, RADAR.planner.widen_bins)
    for seed in range(5):
        expected = search(problem(WIDE), actions, SETTINGS, rng(seed)).action
        assert pomcp(problem(WIDE), RADAR, rng(seed)).bin == expected
        assert pomcp(problem(WIDE), RADAR, rng(seed), lambda: True) == Choice(int(expected), 12_000)


def test_a_search_cut_short_falls_back_to_the_most_probable_bin() -> None:
    """250 simulations over 100 actions: by its own means alone the search would take any of them."""
    searched, chosen = set(), set()
    for seed in range(20):
        searched.add(int(search(problem(WIDE), np.arange(100), SETTINGS._replace(n_sim=250), rng(seed)).action))
        chosen.add(pomcp(problem(WIDE), published(), rng(seed), lambda: False))
    assert len(searched) > 1
    assert chosen == {Choice(most_probable_bin(WIDE, 100, 1.0), 250)}


def test_the_exact_value_is_left_out_if_the_answer_is_due() -> None:
    best, likely = (chosen_bin(problem(UNEQUAL), radar(rule=rule), rng()) for rule in ("exact", "mode"))
    assert best.bin != likely.bin
    assert chosen_bin(problem(UNEQUAL), radar(rule="exact"), rng(), lambda: True) == best
    assert chosen_bin(problem(UNEQUAL), radar(rule="exact"), rng(), lambda: False) == likely


def test_a_search_with_visits_enough_decides_itself() -> None:
    """Cut short above the limit, or complete though small: the action of the largest mean, as without a clock."""
    actions = legal_actions(NARROW, 100, 1.0, RADAR.planner.widen_bins)
    assert MIN_VISITS * actions.size <= 250
    few = published(n_sim=20)
    differs = False
    for seed in range(20):
        first = pomcp(problem(NARROW), radar(n_sim=250), rng(seed))
        assert pomcp(problem(NARROW), RADAR, rng(seed), lambda: False) == first
        assert pomcp(problem(WIDE), few, rng(seed), lambda: False) == pomcp(problem(WIDE), few, rng(seed))
        differs |= pomcp(problem(WIDE), few, rng(seed)).bin != most_probable_bin(WIDE, 100, 1.0)
    assert differs
