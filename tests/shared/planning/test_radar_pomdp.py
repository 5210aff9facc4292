"""The radar's planning problem against closed forms, and the search on it."""

from math import sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.planning.pomcp import (
    OBSERVATION_BITS,
    SearchSettings,
    best_action,
    new_tree,
    search,
    simulate,
)
from cogradar.shared.planning.problem import mean_rollout, random_action, sample_state, step
from cogradar.shared.planning.radar_pomdp import NOTHING, RadarPomdp, legal_actions, problem_of
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.motion import Motion, State
from cogradar.shared.tracking.sensor import MAX_LEVEL, Sensor
from tests.oracles.pomcp import rollout
from tests.plain import plain

Array = NDArray[np.float64]
THRESHOLD = -2.0 * np.log(1e-4)
AMPLITUDE = 1000.0  # at 1 km: 60 dB
SETTINGS = SearchSettings(n_sim=2000, depth=2, rollout_depth=20, rollout_mean=True, gamma=0.8, ucb_c=sqrt(2.0))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def belief(centre: tuple[float, ...], spread: tuple[float, ...], n: int = 2000) -> Array:
    return np.asarray(np.array(centre) + np.array(spread) * rng(99).standard_normal((n, 4)))


FAR = belief((60.0, 0.2, 7.5, 0.1), (0.5, 0.1, 0.5, 0.1))  # target 2 of the paper, some three bins wide
END_FIRE = belief((5.0, 0.05, 60.0, 0.01), (3.0, 0.1, 0.5, 0.1))  # target 3, some of it clipped at x = 0


def problem(
    particles: Array = FAR, sigma_hat: float = 0.05, dt: float = 1.0, sigma_s: float = 0.004, rcs: str = "known"
) -> RadarPomdp:
    sensor = Sensor(100, 60.0, THRESHOLD, rcs=rcs, echo=(AMPLITUDE / 60.467**2) ** 2)
    return problem_of(particles, sigma_hat, sensor, Motion(dt, sigma_s))


@kernel
def many_steps(problem: RadarPomdp, state: State, action: int, n: int, rng: np.random.Generator) -> Array:
    """Outcomes [x, vx, y, vy, observation, reward, end] of n runs of the compiled generator; (n, 7)."""
    outcomes = np.empty((n, 7))
    for i in range(n):
        (x, vx, y, vy), observation, reward, terminal = step(problem, state, action, rng)
        outcomes[i] = np.array([x, vx, y, vy, observation, reward, 1.0 if terminal else 0.0])
    return outcomes


@kernel
def many_rollouts(
    problem: RadarPomdp, state: State, n_level: int, gamma: float, n: int, rng: np.random.Generator
) -> Array:
    """Returns of n runs of the rollout policy; (n,)."""
    totals = np.zeros(n)
    for i in range(n):
        now, discount = state, 1.0
        for _ in range(n_level):
            now, _observation, reward, _terminal = step(problem, now, random_action(problem, rng), rng)
            totals[i] += discount * reward
            discount *= gamma
    return totals


def bins_of(states: Array) -> NDArray[np.int64]:
    return angle_bin(spatial_frequency(states), 100)


@pytest.mark.parametrize("u", [0.5, 3.2, 6.0])
def test_levels_follow_the_rice_law(u: float) -> None:
    # Without motion |alpha|/sigma = u at each step: r is Rice, of scale sqrt(1/2), and 2 r^2 noncentral chi-square.
    state = (60.0, 0.0, 7.5, 0.0)
    still = problem(sigma_s=0.0, sigma_hat=AMPLITUDE / (60.0**2 + 7.5**2) / u)
    action, n = int(bins_of(np.array(state))), 40_000
    outcomes = many_steps(still, state, action, n, rng())
    assert np.all(outcomes[:, :4] == state)
    assert np.all(outcomes[:, 5] == 1.0)
    assert not outcomes[:, 6].any()

    last = max(outcomes[:, 4].max(), 3.0)
    edges = np.maximum(np.arange(last) * sqrt(3.0), sqrt(THRESHOLD / 2.0))  # levels 0 .. last - 1, cut at lambda
    law = stats.rice(sqrt(2.0) * u, scale=sqrt(0.5))
    assert law.cdf(edges[0]) == pytest.approx(stats.ncx2(2, 2.0 * u**2).cdf(THRESHOLD))
    expected = n * np.diff([0.0, *law.cdf(edges), 1.0])  # nothing; then each level, the last one open
    observed = np.bincount(outcomes[:, 4].astype(int), minlength=expected.size)
    assert np.all(observed[expected == 0.0] == 0)
    rare = expected < 10.0  # pooled, as chi-square wants
    pooled = np.array([[*counts[~rare], counts[rare].sum()] for counts in (observed, expected)])
    pooled = pooled[:, pooled[1] > 0.0]
    statistic = np.sum((pooled[0] - pooled[1]) ** 2 / pooled[1])
    assert statistic <= stats.chi2.ppf(1.0 - 1e-6, pooled.shape[1] - 1)


@pytest.mark.parametrize("u", [1.0, 4.0])
def test_levels_of_a_fluctuating_echo_follow_its_law(u: float) -> None:
    """r^2 is exponential, of mean 1 + u^2."""
    state, n = (60.0, 0.0, 7.5, 0.0), 20_000
    still = problem(sigma_s=0.0, sigma_hat=AMPLITUDE / (60.0**2 + 7.5**2) / u, rcs="mean")
    shown = many_steps(still, state, int(bins_of(np.array(state))), n, rng())[:, 4]
    for level in range(1, 6):
        expected = np.exp(-max(0.5 * THRESHOLD, 3.0 * level**2) / (1.0 + u * u))
        assert abs(np.mean(shown >= 1 + level) - expected) < 5.0 * sqrt(expected * (1.0 - expected) / n)


def test_of_an_unknown_rcs_a_detection_is_all_that_is_seen_and_as_probable_at_any_range() -> None:
    n, u = 20_000, 4.0
    still = problem(sigma_s=0.0, sigma_hat=AMPLITUDE / 60.467**2 / u, rcs="unknown")
    expected = np.exp(-0.5 * THRESHOLD / (1.0 + u * u))
    for state in ((60.0, 0.0, 7.5, 0.0), (120.0, 0.0, 15.0, 0.0)):
        shown = many_steps(still, state, int(bins_of(np.array(state))), n, rng())[:, 4]
        assert set(shown) == {NOTHING, 1.0}
        assert abs(np.mean(shown) - expected) < 5.0 * sqrt(expected * (1.0 - expected) / n)


def test_other_cells_show_nothing() -> None:
    state = (60.0, 0.2, 7.5, 0.1)
    outcomes = many_steps(problem(), state, 10, 1000, rng())
    assert np.all(outcomes[:, 4:] == [NOTHING, 0.0, 0.0])


@pytest.mark.parametrize("dt", [0.5, 2.0])
def test_motion_has_the_moments_of_the_model(dt: float) -> None:
    x, vx, y, vy = 60.0, 0.2, 7.5, -0.1
    sigma_s, n = 0.3, 100_000
    moved = many_steps(problem(dt=dt, sigma_s=sigma_s), (x, vx, y, vy), 0, n, rng())[:, :4]
    g = sigma_s * np.array([0.5 * dt**2, dt])
    covariance = np.kron(np.eye(2), np.outer(g, g))
    mean = np.array([x + dt * vx, vx, y + dt * vy, vy])
    assert np.all(np.abs(moved.mean(axis=0) - mean) <= 5.0 * np.sqrt(np.diag(covariance) / n))
    # Var of a product of Gaussians a, b: S_aa S_bb + S_ab^2.
    variance = np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2
    assert np.all(
        np.abs(np.cov(moved.T, bias=True) - covariance) <= 5.0 * np.sqrt(variance / n) + 1e-5 * covariance.max()
    )


def test_reward_is_the_bin_of_the_next_state() -> None:
    wide = problem(sigma_s=3.0)
    bins: set[int] = set()
    for action in (52, 56, 60):
        outcomes = many_steps(wide, (60.0, 0.2, 7.5, 0.1), action, 4000, rng(action))
        assert np.array_equal(outcomes[:, 5] == 1.0, bins_of(outcomes[:, :4]) == action)
        bins |= set(bins_of(outcomes[:, :4]))
    assert {52, 56, 60} <= bins


def test_targets_stay_in_front_of_the_array() -> None:
    for action in (99, 98):
        outcomes = many_steps(problem(), (0.1, -0.3, 60.0, 0.0), action, 50, rng())
        assert np.all(outcomes[:, 0] == 0.0)
        assert np.all(outcomes[:, 1] < 0.0)  # the velocity stays
        assert np.all(outcomes[:, 5] == (action == 99))


def test_a_target_on_top_of_the_radar_is_seen_at_the_highest_level() -> None:
    outcome = many_steps(problem(sigma_s=0.0), (0.0, 0.0, 0.0, 0.0), 49, 1, rng())[0]
    assert outcome[4:].tolist() == [1 + MAX_LEVEL, 1.0, 0.0]
    assert outcome[4] < 2**OBSERVATION_BITS


def test_generator_is_the_same_compiled_and_plain() -> None:
    state = (60.0, 0.2, 7.5, 0.1)
    action = int(bins_of(np.array(state)))
    compiled = many_steps(problem(sigma_s=0.5), state, action, 300, rng(5))
    source = rng(5)
    for row in compiled:
        following, observation, reward, terminal = step(problem(sigma_s=0.5), state, action, source)
        assert (*following, observation, reward, terminal) == tuple(row)


def test_search_is_the_same_compiled_and_plain() -> None:
    actions = legal_actions(FAR, 100, 1.0, 2)
    for rollout_mean in (True, False):
        settings = SETTINGS._replace(n_sim=150, depth=3, rollout_depth=3, rollout_mean=rollout_mean)
        compiled: Any = search(problem(), actions, settings, rng(5))
        source = rng(5)
        tree = new_tree(settings.n_sim, actions.size, source)
        plain(simulate)(tree, problem(), actions, settings, settings.n_sim, source)
        result: Any = best_action(tree, actions)
        for one, other in zip(result, compiled, strict=True):
            assert np.array_equal(one, other)


def test_root_states_are_particles_all_alike() -> None:
    particles = np.arange(12.0).reshape(3, 4)
    source = rng()
    counts = np.bincount([int(sample_state(problem(particles), source)[0]) // 4 for _ in range(3000)], minlength=3)
    assert np.all(np.abs(counts - 1000) <= 5.0 * sqrt(3000 * (1 / 3) * (2 / 3)))


@pytest.mark.parametrize("gamma", [0.0, 0.8])
@pytest.mark.parametrize("state", [(60.0, 0.2, 7.5, 0.1), (1.0, -0.3, 60.0, 0.0), (1.0, -0.5, -1.0, 0.4)])
def test_mean_rollout_is_the_mean_of_rollouts(state: State, gamma: float) -> None:
    n = 100_000
    totals = many_rollouts(problem(sigma_s=0.05), state, 12, gamma, n, rng())
    mean = mean_rollout(problem(), 12, gamma)
    assert mean == pytest.approx(sum(gamma**d for d in range(12)) / 100)
    assert abs(totals.mean() - mean) <= 5.0 * totals.std() / sqrt(n)
    assert mean_rollout(problem(), 0, gamma) == 0.0


def test_random_rollout_of_the_search_is_that_policy() -> None:
    state, levels, n = (60.0, 0.2, 7.5, 0.1), 12, 2000
    source = rng()
    settings = SETTINGS._replace(rollout_mean=False)
    plain = [rollout(problem(), state, levels, settings, source) for _ in range(n)]
    mean = mean_rollout(problem(), levels, settings.gamma)
    # Returns are sums of rare events, so the variance comes from the model: (1/100) sum gamma^2d at most.
    deviation = sqrt(sum(settings.gamma ** (2 * d) for d in range(levels)) / 100 / n)
    assert abs(np.mean(plain) - mean) <= 5.0 * deviation


@pytest.mark.parametrize("particles", [FAR, END_FIRE], ids=["far", "end-fire"])
def test_both_rollouts_choose_alike(particles: Array) -> None:
    n_run, actions = 30, legal_actions(particles, 100, 1.0, 2)
    chosen, value = {}, {}
    for rollout_mean in (True, False):
        settings = SETTINGS._replace(rollout_mean=rollout_mean)
        results = [search(problem(particles), actions, settings, rng(seed)) for seed in range(n_run)]
        chosen[rollout_mean] = np.array([result.action for result in results])
        value[rollout_mean] = np.array([result.value.max() for result in results])
    expected = particles + np.column_stack((particles[:, 1], 0 * particles[:, 1], particles[:, 3], 0 * particles[:, 1]))
    expected[:, 0] = np.maximum(expected[:, 0], 0.0)
    likeliest = np.bincount(bins_of(expected), minlength=100).argmax()
    assert set(chosen[True]) == set(chosen[False]) == {likeliest}
    # The mean is unbiased, so the values agree: 5 standard deviations of the difference of two means.
    deviation = sqrt((value[True].var() + value[False].var()) / n_run)
    assert abs(value[True].mean() - value[False].mean()) <= 5.0 * deviation


def states() -> st.SearchStrategy[list[tuple[float, float, float, float]]]:
    x, v, y = st.floats(0.0, 200.0), st.floats(-1.0, 1.0), st.floats(-200.0, 200.0).filter(lambda y: abs(y) > 3.0)
    return st.lists(st.tuples(x, v, y, v), min_size=1, max_size=20)


@given(particles=states(), n_bin=st.integers(3, 150), widen=st.integers(0, 100), dt=st.floats(0.1, 2.0))
def test_legal_actions_are_the_predicted_bins_and_their_neighbours(
    particles: list[State], n_bin: int, widen: int, dt: float
) -> None:
    expected = set()
    for x, vx, y, vy in particles:
        predicted = np.array([max(x + dt * vx, 0.0), vx, y + dt * vy, vy])
        bin_ = int(angle_bin(spatial_frequency(predicted), n_bin))
        expected |= {b for b in range(n_bin) if abs(b - bin_) <= widen}
    assert legal_actions(np.array(particles), n_bin, dt, widen).tolist() == sorted(expected)


@pytest.mark.parametrize(
    ("y", "widen", "expected"),
    [(60.0, 2, [97, 98, 99]), (-60.0, 2, [0, 1, 2]), (60.0, 0, [99]), (0.0, 1, [49, 50, 51])],
)
def test_legal_actions_end_with_the_grid(y: float, widen: int, expected: list[int]) -> None:
    particles = np.array([[0.0 if y else 60.0, -0.1, y, 0.0]])
    assert legal_actions(particles, 100, 1.0, widen).tolist() == expected
