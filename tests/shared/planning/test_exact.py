"""The depth-2 value of every bin, against the obvious sum over particles, bins and levels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogradar.shared.planning.exact import level_table, values_of
from cogradar.shared.planning.pomcp import SearchSettings, search
from cogradar.shared.planning.radar_pomdp import RadarPomdp, legal_actions, problem_of
from cogradar.shared.planning.rules import Choice, exact
from cogradar.shared.scenario.files import load
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import Sensor
from tests.oracles.exact import THRESHOLD, belief, beliefs, slow_values

RADAR = load("paper").radar


@settings(max_examples=25, deadline=None)
@given(beliefs, st.floats(0.0, 0.95))
def test_the_value_is_the_sum_of_its_definition(problem: RadarPomdp, gamma: float) -> None:
    expected, found = slow_values(problem, gamma), values_of(problem, gamma)
    np.testing.assert_allclose([found.of(a) for a in range(problem.n_bin)], expected, atol=5e-4)
    assert found.first_bin + int(np.argmax(found.q)) in np.flatnonzero(expected > expected.max() - 1e-3)
    assert found.share.sum() == pytest.approx(1.0)
    assert np.all(found.detected <= found.share + 1e-12)


@pytest.mark.parametrize("rcs", ["mean", "unknown"])
def test_the_value_is_the_sum_of_its_definition_by_every_law(rcs: str) -> None:
    for seed, u in ((1, 1.5), (2, 4.0), (3, 20.0)):
        problem = belief(seed, 100, 60.0, 2.0, u, rcs)
        expected, found = slow_values(problem, 0.8, rcs), values_of(problem, 0.8)
        np.testing.assert_allclose([found.of(a) for a in range(100)], expected, atol=5e-4)


@pytest.mark.parametrize(("rcs", "most"), [("mean", 170), ("unknown", 1)])
def test_the_levels_of_a_fluctuating_echo_are_all_that_can_happen(rcs: str, most: int) -> None:
    table = level_table(-2.0 * np.log(1e-4), rcs)
    np.testing.assert_allclose(table.miss + table.chance.sum(axis=1), 1.0, atol=1e-6)
    assert table.chance.shape[1] <= most


def test_the_levels_of_a_strength_are_all_that_can_happen() -> None:
    for p_fa in (1e-9, 1e-4, 0.1):
        table = level_table(-2.0 * np.log(p_fa))
        np.testing.assert_allclose(table.miss + table.chance.sum(axis=1), 1.0, atol=1e-7)
        assert table.chance.shape[1] <= 10


def test_a_belief_in_one_bin_is_worth_a_look_there_and_one_after_it() -> None:
    """Everything is sure: gamma is all that is lost, and any other bin leaves the second look."""
    particles = np.repeat([[60.0, 0.0, 2.0, 0.0]], 10, axis=0)
    values = values_of(problem_of(particles, 1e-4, Sensor(100, 60.0, THRESHOLD), Motion(1.0, 0.004)), 0.8)
    assert values.q == pytest.approx([1.8])
    assert values.of(0) == values.elsewhere == pytest.approx(0.8)


def test_an_echo_without_noise_is_the_strongest() -> None:
    particles = np.repeat([[60.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 0.0]], 5, axis=0)
    values = values_of(problem_of(particles, 0.0, Sensor(100, 60.0, THRESHOLD), Motion(1.0, 0.004)), 0.8)
    assert values.q.max() == pytest.approx(0.5 + 0.8)


def test_equal_bins_go_to_the_first() -> None:
    particles = np.repeat([[60.0, 0.0, 2.0, 0.0], [60.0, 0.0, -2.0, 0.0]], 5, axis=0)
    problem = problem_of(particles, 0.01, Sensor(100, 60.0, THRESHOLD), Motion(1.0, 0.004))
    values = values_of(problem, 0.8)
    assert values.q[0] == values.q[-1]
    assert exact(problem, RADAR) == Choice(values.first_bin, 0)


def test_the_search_estimates_these_values() -> None:
    rng = np.random.default_rng(3)
    particles = np.array([60.0, 0.2, 7.5, 0.1]) + np.array([3.0, 0.1, 1.0, 0.1]) * rng.standard_normal((3000, 4))
    problem = problem_of(particles, 0.02, Sensor(100, 60.0, THRESHOLD), Motion(1.0, 0.0))
    actions = legal_actions(particles, 100, 1.0, 0)
    found = search(problem, actions, SearchSettings(200_000, 2, 0, True, 0.8, 1.4), np.random.default_rng(1))
    best = int(np.argmax(found.value))
    assert found.action == exact(problem, RADAR).bin
    # The tree averages over what it tried below, so that it is a little lower.
    assert found.value[best] == pytest.approx(values_of(problem, 0.8).of(int(actions[best])), abs=0.03)
