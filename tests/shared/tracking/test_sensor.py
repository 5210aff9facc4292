import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from cogradar.shared.signal.echo_laws import log_rice_likelihood
from cogradar.shared.tracking.belief.rejection import accepted
from cogradar.shared.tracking.sensor import (
    STEP,
    Sensor,
    hit_table,
    interpolate,
    level_band,
    log_amplitude_probability,
    log_level_probability,
    log_miss_probability,
    miss_table,
)
from tests.oracles.belief import level_probability, miss_probability
from tests.shared.tracking.models import in_bins, in_level

THRESHOLD = -2.0 * np.log(1e-4)
SENSOR = Sensor(n_bin=5, amplitude_db=60.0, threshold=THRESHOLD)


def test_a_step_holds_95_percent() -> None:
    # |alpha_hat - alpha|^2/sigma^2 is exponential: P(|.| <= beta) = 1 - exp(-beta^2/sigma^2) = 1 - exp(-3)
    assert 1.0 - np.exp(-(STEP**2)) == pytest.approx(0.950213, abs=1e-6)


def test_rice_likelihood_against_scipy() -> None:
    r, u = np.meshgrid([0.1, 1.0, 5.0, 30.0], [0.0, 0.5, 4.0, 29.0])
    expected = stats.rice.logpdf(r, u * np.sqrt(2.0), scale=np.sqrt(0.5))
    finite = expected > -600.0  # beyond, the oracle's own density underflows
    np.testing.assert_allclose((log_rice_likelihood(r, u) + np.log(2.0 * r))[finite], expected[finite], atol=1e-9)


@pytest.mark.parametrize("level", [1, 2, 3, 9, 20])
def test_level_probability_against_noncentral_chi_square(level: int) -> None:
    u = np.linspace(max(level * STEP - 4.0, 0.0), (level + 1) * STEP + 4.0, 101)
    ours, oracle = np.exp(log_level_probability(level, THRESHOLD, u)), level_probability(level, THRESHOLD, u)
    np.testing.assert_allclose(ours, oracle, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("threshold", [0.5, 4.6, THRESHOLD, 41.4])
def test_miss_probability_against_noncentral_chi_square(threshold: float) -> None:
    u = np.linspace(0.0, np.sqrt(threshold / 2.0) + 5.0, 101)
    ours = np.exp(log_miss_probability(threshold, u))
    np.testing.assert_allclose(ours, miss_probability(threshold, u), rtol=1e-8, atol=1e-13)


@pytest.mark.parametrize("u", [0.0, 0.7, 3.0, 8.0, 40.0, 700.0])
def test_outcomes_exhaust_the_possibilities(u: float) -> None:
    first = int(max(u - 9.0, 0.0) / STEP)
    levels = range(first, int((u + 9.0) / STEP) + 1)
    # a level wholly below the threshold cannot be observed; 1 is the one that the threshold (3.03) cuts
    hit = sum(np.exp(log_level_probability(q, THRESHOLD, u)) for q in levels if q >= 1)
    assert hit + np.exp(log_miss_probability(THRESHOLD, u)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("level", [50, 400, 3000, 10**6])
def test_strong_echoes_approach_the_gaussian_limit(level: int) -> None:
    # r = |u + n| with n ~ CN(0, 1): r - u -> N(1/(4u), 1/2) to order 1/u^2
    u = level * STEP + np.linspace(-3.0, STEP + 3.0, 25)
    law = stats.norm(u + 0.25 / u, np.sqrt(0.5))
    expected = np.where(
        u > level * STEP,
        law.cdf((level + 1) * STEP) - law.cdf(level * STEP),
        law.sf(level * STEP) - law.sf((level + 1) * STEP),
    )
    tolerance = 20.0 / u.min() ** 2 + 1e-8  # second order in 1/u, with z^4-like factors up to 4 deviations away
    np.testing.assert_allclose(np.exp(log_level_probability(level, THRESHOLD, u)), expected, rtol=tolerance)


def test_false_alarm_probability_at_u_zero() -> None:
    assert np.exp(log_miss_probability(THRESHOLD, 0.0)) == pytest.approx(1.0 - 1e-4, abs=1e-12)


def test_impossible_level_is_read_as_one_at_the_threshold() -> None:
    edge = np.sqrt(THRESHOLD / 2.0)
    low, high = level_band(0, THRESHOLD)
    assert low == edge
    assert low < high < edge + 1e-3
    assert np.isfinite(log_level_probability(0, THRESHOLD, np.array([0.0, 3.0, 1e4]))).all()


@pytest.mark.parametrize("r", [3.1, 6.0, 40.0])
def test_an_amplitude_stands_for_an_interval_as_wide_as_a_level(r: float) -> None:
    """The mean of the density over an interval of sqrt 3, times its width, is the probability of the interval."""
    u = np.linspace(max(r - 4.0, 0.0), r + 4.0, 21)
    within = r + STEP * (np.arange(400) + 0.5) / 400.0
    mean = np.mean([np.exp(log_amplitude_probability(float(at), THRESHOLD, u)) for at in within], axis=0)
    law = stats.rice(u * np.sqrt(2.0), scale=np.sqrt(0.5))
    np.testing.assert_allclose(mean, law.cdf(r + STEP) - law.cdf(r), rtol=1e-4, atol=1e-9)


def test_an_amplitude_below_the_threshold_is_read_as_one_at_it() -> None:
    u = np.linspace(0.0, 10.0, 11)
    at = log_amplitude_probability(np.sqrt(THRESHOLD / 2.0), THRESHOLD, u)
    np.testing.assert_array_equal(log_amplitude_probability(0.0, THRESHOLD, u), at)


@given(level=st.integers(0, 10**9), u=st.floats(0.0, 1e9))
def test_log_probabilities_are_finite(level: int, u: float) -> None:
    values = np.array(
        [
            log_level_probability(level, THRESHOLD, u),
            log_amplitude_probability(level * STEP, THRESHOLD, u),
            log_miss_probability(THRESHOLD, u),
        ]
    )
    assert np.isfinite(values).all()
    assert (values <= 0.0).all()


@pytest.mark.parametrize("level", [-1, 1, 4, 5, 700])
def test_table_interpolates_within_its_stated_error(level: int) -> None:
    start, log_p = hit_table(SENSOR, in_level(level)) if level >= 0 else miss_table(SENSOR)
    u = start + np.random.Generator(np.random.SFC64(1)).uniform(0.0, (log_p.size - 1.001) / 32.0, 300)
    exact = log_level_probability(level, THRESHOLD, u) if level >= 0 else log_miss_probability(THRESHOLD, u)
    table = np.array([interpolate(value, start, log_p, False) for value in u])
    # |(log P)''|/(8 * 32^2), the curvature being 2 for a Gaussian, and up to 2 r^2 (level 4: 150) towards u = 0
    np.testing.assert_allclose(np.log(table)[u > 1.0], exact[u > 1.0], atol=2.5e-4)
    np.testing.assert_allclose(np.log(table), exact, atol=150.0 / (8 * 32**2))


@pytest.mark.parametrize("r", [3.1, 7.0, 1200.0])
def test_table_of_an_amplitude_interpolates_within_its_stated_error(r: float) -> None:
    exact_sensor = SENSOR._replace(is_exact=True)
    start, log_p = hit_table(exact_sensor, r)
    u = start + np.random.Generator(np.random.SFC64(1)).uniform(0.0, (log_p.size - 1.001) / 32.0, 300)
    exact = log_amplitude_probability(r, THRESHOLD, u)
    table = np.array([interpolate(value, start, log_p, False) for value in u])
    np.testing.assert_allclose(np.log(table)[u > 1.0], exact[u > 1.0], atol=2.5e-4)
    np.testing.assert_allclose(np.log(table), exact, atol=2.0 * r * r / (8 * 32**2) if start == 0.0 else 2.5e-4)


@pytest.mark.parametrize("is_exact", [True, False])
def test_nothing_is_lost_outside_the_table(is_exact: bool) -> None:
    sensor = SENSOR._replace(is_exact=is_exact)
    start, log_p = hit_table(sensor, in_level(700))
    for outside in (0.0, start - 1e-6, start + log_p.size / 32.0, 1e300, np.inf):
        assert interpolate(outside, start, log_p, False) == 0.0
    assert log_p[0] < -60.0
    assert log_p[-1] < -60.0


def test_an_observation_is_generated_in_the_cells_looked_at_and_in_the_band_of_its_level() -> None:
    sigma, edge = np.array([0.0, 0.1, 0.0, 0.02, 0.0]), np.sqrt(THRESHOLD / 2.0)
    miss = accepted(SENSOR, in_bins(-1, 0.0, sigma))
    np.testing.assert_allclose(miss.gain, [0.0, 1e4, 0.0, 5e4, 0.0], rtol=1e-14)
    assert (miss.hit_bin, miss.low, miss.high) == (-1, 0.0, edge)
    for level, low in ((1, edge), (4, 4 * STEP)):
        hit = accepted(SENSOR, in_bins(3, in_level(level), sigma))
        assert (hit.hit_bin, hit.low, hit.high) == (3, low, (level + 1) * STEP)
