"""The motion model against its moments, and its kernels against the formula."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.motion import (
    Motion,
    advance,
    covariance_of_state,
    mean_state,
    predicted_bins,
    predicted_mean,
    propagate_into,
)
from tests.oracles.motion import propagate
from tests.plain import plain

DT, SIGMA_S = 2.0, 0.004
MOTION, QUIET = Motion(DT, SIGMA_S), Motion(DT, 0.0)


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def moved(states: NDArray[np.float64], motion: Motion, generator: np.random.Generator) -> NDArray[np.float64]:
    out = np.empty_like(states)
    propagate_into(states, motion, generator, out)
    return out


@pytest.mark.parametrize("k", [1, 2, 7])
def test_variances_after_k_dwells(k: int) -> None:
    n = 40_000
    start = np.array([60.0, 0.2, 7.5, 0.1])
    states = np.tile(start, (n, 1))
    generator = rng(k)
    for _ in range(k):
        states = moved(states, MOTION, generator)
    velocity = k * SIGMA_S**2 * DT**2
    position = SIGMA_S**2 * DT**4 * sum((i + 0.5) ** 2 for i in range(k))
    # n s^2/sigma^2 is chi-square(n): standard deviation of s^2 is sigma^2 sqrt(2/n); 5 sigma for each of 4 components
    for component, variance in ((0, position), (1, velocity), (2, position), (3, velocity)):
        noise = states[:, component] - start[component] - (k * DT * start[component + 1] if component % 2 == 0 else 0.0)
        assert abs(np.mean(noise**2) / variance - 1.0) < 5.0 * np.sqrt(2.0 / n)
    # one acceleration drives both: correlation of position and velocity is sum(i + 1/2)/sqrt(k sum (i + 1/2)^2)
    steps = np.arange(k) + 0.5
    expected = steps.sum() / np.sqrt(k * (steps**2).sum())
    measured = np.corrcoef(states[:, 0], states[:, 1])[0, 1]
    assert abs(measured - expected) < 5.0 * (1.0 - expected**2) / np.sqrt(n) + 1e-12


def test_axes_are_independent() -> None:
    n = 40_000
    states = moved(np.tile([60.0, 0.0, 0.0, 0.0], (n, 1)), MOTION, rng(1))
    assert abs(np.corrcoef(states[:, 1], states[:, 3])[0, 1]) < 5.0 / np.sqrt(n)


def test_without_noise_the_motion_is_uniform() -> None:
    expected = [60.4, 0.2, 7.3, -0.1]
    np.testing.assert_allclose(advance(60.0, 0.2, 7.5, -0.1, DT, 0.0, 0.0), expected, rtol=1e-15)
    np.testing.assert_allclose(moved(np.array([[60.0, 0.2, 7.5, -0.1]]), QUIET, rng(1)), [expected], rtol=1e-15)


def test_an_acceleration_acts_on_its_own_axis() -> None:
    assert advance(60.0, 0.25, 7.5, -0.5, 2.0, 0.125, -0.25) == (60.75, 0.5, 6.0, -1.0)  # exact in binary


def test_x_is_clipped_and_its_velocity_kept() -> None:
    assert advance(0.1, -0.3, 60.0, 0.0, DT, 0.0, 0.0) == (0.0, -0.3, 60.0, 0.0)
    clipped = moved(np.array([[0.1, -0.3, 60.0, 0.0]]), QUIET, rng(1))
    np.testing.assert_array_equal(clipped, [[0.0, -0.3, 60.0, 0.0]])


def test_kernel_equals_the_formula_also_in_place_and_as_plain_python() -> None:
    states = rng(3).normal([0.2, -0.1, 5.0, 0.1], [1.0, 0.2, 20.0, 0.2], (500, 4))
    states[:, 0] = np.abs(states[:, 0])
    motion = Motion(DT, 0.1)
    expected = propagate(states, motion, rng(4))
    out = np.empty_like(states)
    plain(propagate_into)(states, motion, rng(4), out)
    np.testing.assert_array_equal(out, expected)
    propagate_into(states, motion, rng(4), states)
    np.testing.assert_array_equal(states, expected)


def test_predicted_mean_is_the_mean_of_the_predictions() -> None:
    particles = rng(5).normal([60.0, 0.2, 7.5, 0.1], 0.05, (300, 4))
    expected = propagate(particles, QUIET, rng(1)).mean(axis=0)
    np.testing.assert_allclose(predicted_mean(mean_state(particles), DT), expected, rtol=1e-13)


def test_predicted_bins_are_those_of_the_moved_particles() -> None:
    """Each particle moved by A and put into the bin of its position, one at a time; x is clipped at 0."""
    rng = np.random.default_rng(1)
    particles = rng.normal([3.0, -0.5, 10.0, 0.2], [4.0, 1.0, 20.0, 0.5], (500, 4))
    expected = np.zeros(16, dtype=np.int64)
    for x, vx, y, vy in particles:
        moved = np.array([max(x + 2.0 * vx, 0.0), vx, y + 2.0 * vy, vy])
        expected[angle_bin(spatial_frequency(moved), 16)] += 1
    np.testing.assert_array_equal(predicted_bins(particles, 16, 2.0), expected)


def test_mean_state_is_numpys_to_the_last_bit() -> None:
    """NumPy adds up the first axis row by row, as the kernel does."""
    particles = rng(6).normal([60.0, 0.2, 7.5, 0.1], 0.5, (1001, 4))
    np.testing.assert_array_equal(mean_state(particles), particles.mean(axis=0))


def test_moments_of_a_belief() -> None:
    particles = np.random.default_rng(5).normal((40.0, 0.1, -60.0, 0.2), (3.0, 0.02, 1.0, 0.05), (12_000, 4))
    particles[:, 2] += 0.7 * particles[:, 0]
    mean = mean_state(particles)
    assert mean == pytest.approx(particles.mean(axis=0), rel=1e-12)
    covariance = covariance_of_state(particles, mean)
    assert covariance == pytest.approx(np.cov(particles, rowvar=False, bias=True), rel=1e-10, abs=1e-12)
    assert (covariance == covariance.T).all()
    assert (covariance_of_state(particles[:1], particles[0]) == 0.0).all()
