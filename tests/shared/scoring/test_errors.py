"""Intervals against published numbers and coverage; errors; lost tracks."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2, t

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.world_config import TurnSection
from cogradar.shared.scoring.columns import TargetDwell
from cogradar.shared.scoring.errors import (
    NEES_99,
    acceleration_g,
    bootstrap_interval,
    lost,
    nees,
    nees_in_band,
    nees_position,
    nees_velocity,
    position_error,
    rmse,
    velocity_error,
    wilson_interval,
)
from cogradar.shared.world.targets import Flights


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_interval_equals_published_values(hits: int, n: int, low: float, high: float) -> None:
    """Newcombe 1998, Statistics in Medicine 17, 857-872, Table I, method 3, to its four digits."""
    np.testing.assert_allclose(wilson_interval(hits, n), (low, high), rtol=0, atol=5e-5)


@pytest.mark.parametrize(("hits", "n"), [(8, 10), (1, 3), (99, 100), (500, 1000)])
def test_wilson_ends_solve_the_score_equation(hits: int, n: int) -> None:
    """(1 + z^2/n) p^2 - (2 hits/n + z^2/n) p + (hits/n)^2 = 0 with z = Phi^-1(0.995)."""
    z2, share = 2.5758293035489004**2, hits / n
    roots = np.sort(np.roots([1 + z2 / n, -(2 * share + z2 / n), share**2]))
    np.testing.assert_allclose(wilson_interval(hits, n, 0.99), roots, rtol=1e-12)


def test_wilson_interval_of_numbers_is_numbers() -> None:
    assert all(isinstance(end, float) for end in wilson_interval(8, 10))


def test_wilson_interval_at_its_limits() -> None:
    low, high = wilson_interval([0, 5, 0], [5, 5, 0])
    z2 = 1.959963984540054**2  # no hit in n: high = z^2 / (n + z^2)
    np.testing.assert_allclose(low, [0.0, 5 / (5 + z2), 0.0], rtol=1e-12)
    np.testing.assert_allclose(high, [z2 / (5 + z2), 1.0, 1.0], rtol=1e-12)


@pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
def test_wilson_coverage_averages_the_nominal(p: float) -> None:
    """Exact coverage at n = 100 from the binomial law; within 2 % of 95 % (Brown, Cai, DasGupta 2001, Fig. 11)."""
    hits = np.arange(101)
    low, high = wilson_interval(hits, 100)
    coverage = float(binom.pmf(hits, 100, p) @ ((low <= p) & (p <= high)))
    assert 0.93 <= coverage <= 0.97


def test_errors_and_their_root_mean_square() -> None:
    truth = np.array([[10.0, 0.1, -5.0, 0.2], [20.0, 0.0, 8.0, 0.0]])
    estimate = truth + np.array([[3.0, 0.05, 4.0, 0.12], [0.0, 0.0, -2.0, 0.0]])
    np.testing.assert_allclose(position_error(estimate, truth), [5.0, 2.0], rtol=1e-13)  # 3-4-5
    np.testing.assert_allclose(velocity_error(estimate, truth), [0.13, 0.0], rtol=1e-13)  # 5-12-13
    assert rmse(position_error(estimate, truth)) == pytest.approx(np.sqrt((25 + 4) / 2), rel=1e-14)
    assert rmse(np.ones((7, 3, 2))).shape == (3, 2)
    assert rmse(np.full((7, 3, 2), -2.0), axis=(0, 1)) == pytest.approx([2.0, 2.0], rel=1e-14)


def test_bootstrap_of_a_mean_covers_as_often_as_theory_says() -> None:
    """Normal samples, n = 25: the percentile interval is mean -+ 1.96 s sqrt((n-1)/n) / sqrt(n) in the limit of many

    resamples, hence its coverage is P(|t_{n-1}| <= 1.96 sqrt((n-1)/n)) = 0.933. 2000 columns are 2000 trials;
    tolerance: 5 sigma of the binomial, plus 0.005 for the quantiles of 1000 resamples.
    """
    n, trials = 25, 2000
    low, high = bootstrap_interval(
        np.random.default_rng(1).normal(size=(n, trials)), np.random.default_rng(2), n_resample=1000
    )
    expected = 2 * t.cdf(1.959963984540054 * np.sqrt((n - 1) / n), n - 1) - 1
    covered = np.mean((low <= 0) & (high >= 0))
    assert abs(covered - expected) <= 5 * np.sqrt(expected * (1 - expected) / trials) + 0.005


def test_bootstrap_of_rmse_has_the_width_of_the_delta_method() -> None:
    """By linearisation the ends are RMSE -+ 1.96 sd(squares) / (2 RMSE sqrt n), to 10 % of that half width.

    Monte Carlo error of a 2.5 % quantile of 2000 resamples: sqrt(0.025 0.975 / 2000) / phi(1.96) = 0.06 sigma, 3 % of
    the half width; the rest is for what linearisation leaves out, of relative order 1/sqrt n with n = 400.
    """
    squares = np.random.default_rng(3).normal(size=400) ** 2
    low, high = bootstrap_interval(squares, np.random.default_rng(4), np.sqrt)
    centre, half = np.sqrt(squares.mean()), 1.96 * squares.std() / (2 * np.sqrt(squares.mean()) * np.sqrt(400))
    assert low == pytest.approx(centre - half, abs=0.1 * half)
    assert high == pytest.approx(centre + half, abs=0.1 * half)


def test_bootstrap_keeps_runs_paired() -> None:
    """Two strategies that differ by exactly 1 in each run differ by exactly 1 in each resample."""
    errors = np.random.default_rng(5).normal(size=60)
    low, high = bootstrap_interval(
        np.stack([errors, errors + 1], axis=-1), np.random.default_rng(6), lambda m: m[..., 1] - m[..., 0]
    )
    np.testing.assert_allclose((low, high), 1.0, rtol=0, atol=1e-12)


def test_bootstrap_is_a_function_of_its_generator() -> None:
    values = np.arange(10.0)
    first = bootstrap_interval(values, np.random.default_rng(7))
    assert first == bootstrap_interval(values, np.random.default_rng(7))
    assert first != bootstrap_interval(values, np.random.default_rng(8))


def outages(is_out: np.ndarray) -> np.ndarray:
    """Dwells in a row, up to each one, that a track is out of the bin; (..., T) -> (..., T)."""
    t = np.arange(1, is_out.shape[-1] + 1)
    return np.asarray(t - np.maximum.accumulate(np.where(is_out, 0, t), axis=-1))


@pytest.mark.parametrize(
    ("dwells", "expected"),
    [
        ({}, False),
        ({(0, 59)}, False),
        ({(0, 60)}, True),  # 60 in a row, wherever
        ({(0, 30), (31, 61)}, False),
        ({(81, 100)}, False),  # 19 at the end
        ({(80, 100)}, True),
        ({(60, 99)}, False),  # back in the last one
    ],
)
def test_a_track_is_lost_by_one_long_outage_or_by_one_at_the_end(dwells: set[tuple[int, int]], expected: bool) -> None:
    is_out = np.zeros(100, dtype=bool)
    for first, last in dwells:
        is_out[first:last] = True
    assert lost(outages(is_out)) == expected


def test_lost_of_many_runs_and_of_short_ones() -> None:
    np.testing.assert_array_equal(lost(outages(np.array([[True, True, True], [True, True, False]]))), [True, False])
    assert not lost([])


def test_nees_of_honest_and_of_proud_beliefs() -> None:
    """Errors drawn from a covariance have a mean of 4; half the covariance doubles it."""
    rng = np.random.default_rng(1)
    root = rng.standard_normal((4, 4)) * np.array([[1.0], [0.03], [2.0], [0.05]])
    p, errors = root @ root.T, rng.standard_normal((400, 200, 4)) @ root.T
    one = errors[0, 0]
    assert nees(one, p) == pytest.approx(one @ np.linalg.inv(p) @ one)
    white = np.linalg.solve(root, errors[..., np.newaxis])[..., 0]
    honest = (white**2).sum(axis=-1)
    assert honest[0, 0] == pytest.approx(nees(one, p))
    assert nees_in_band(honest) == pytest.approx(0.95, abs=0.05)  # 200 dwells: 3 standard deviations
    assert nees_in_band(2.0 * honest) == 0.0
    honest[::2] = np.nan  # known of every second run
    assert nees_in_band(honest) == pytest.approx(0.95, abs=0.05)


def test_nees_of_position_and_velocity_are_those_of_their_marginals() -> None:
    rng = np.random.default_rng(2)
    root = rng.standard_normal((4, 4)) * np.array([[1.0], [0.03], [2.0], [0.05]])
    p, error = root @ root.T, root @ rng.standard_normal(4)
    names = ("x", "vx", "y", "vy")
    state = dict(zip(names, [10.0, 0.1, 20.0, 0.2], strict=True))
    estimate = {f"{name}_hat": state[name] + e for name, e in zip(names, error.tolist(), strict=True)}
    fields: dict[str, Any] = dict.fromkeys(TargetDwell._fields) | state | estimate | {"covariance": p}
    dwell = TargetDwell(**fields)
    for found, kept in ((nees_position(dwell), [0, 2]), (nees_velocity(dwell), [1, 3])):
        assert found == pytest.approx(error[kept] @ np.linalg.inv(p[np.ix_(kept, kept)]) @ error[kept])
    assert nees_position(dwell._replace(x_hat=None)) is None
    assert nees_velocity(dwell._replace(covariance=np.zeros((4, 4)))) is None


def test_the_bound_of_nees_is_the_quantile_of_four_degrees_of_freedom() -> None:
    assert pytest.approx(chi2.ppf(0.99, 4), rel=1e-12) == NEES_99


@pytest.mark.parametrize("g", [0.0, 2.0, 7.0])
def test_acceleration_of_a_turn(g: float) -> None:
    """Flown as the world flies: 2 sin(a/2) / a of the acceleration, a the angle turned through in the time."""
    turns = [{"from_s": 0.0, "to_s": 100.0, "g": g}]
    world = load("smoke", ["world.motion.sigma_s_km_s2=0"]).simulated
    target = world.targets[0].model_copy(update={"turns": [TurnSection.model_validate(turn) for turn in turns]})
    flights = Flights(world.model_copy(update={"targets": [target]}), 1.0, 1)
    before = flights.start()
    after = flights.moved(before, 1)
    half = 0.5 * g * 9.80665e-3 / float(np.hypot(before[0, 1], before[0, 3]))
    (found,) = acceleration_g(before[:, 1::2], after[:, 1::2], 1.0)
    assert found == pytest.approx(g * np.sinc(half / np.pi), abs=1e-9)
    (slower,) = acceleration_g(before[:, 1::2], after[:, 1::2], 2.0)
    assert slower == pytest.approx(0.5 * found)


def test_a_belief_that_spans_no_volume_has_no_nees() -> None:
    assert nees(np.ones(4), np.diag([1.0, 0.0, 1.0, 1.0])) is None
