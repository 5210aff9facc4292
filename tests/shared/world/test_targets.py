"""The true targets against the motion model and the radar equation."""

import numpy as np
import pytest
from scipy.stats import gamma, kstest

from shared.numerics.seeds import Purpose, generator
from shared.tracking.motion import Motion
from shared.world.targets import echo_amplitudes, moved
from tests.oracles.motion import propagate

STATES = np.array([[20.0, 0.05, -60.0, 0.01], [60.0, 0.2, 7.5, 0.1], [0.1, -0.3, 60.0, 0.01]])
MOTION = Motion(1.0, 0.004)


def test_targets_move_as_the_model_says_each_with_noise_of_its_own() -> None:
    for t in (1, 2):
        expected = [propagate(STATES[m : m + 1], MOTION, generator(7, Purpose.MOTION, m, t))[0] for m in range(3)]
        np.testing.assert_array_equal(moved(STATES, MOTION, 7, t), expected)
    assert moved(STATES, MOTION, 7, 1)[2, 0] == 0.0  # never behind the array


def test_a_target_does_not_depend_on_the_others() -> None:
    np.testing.assert_array_equal(moved(STATES[:2], MOTION, 7, 3), moved(STATES, MOTION, 7, 3)[:2])
    for rcs in ("constant", "swerling1", "swerling3"):
        alphas = echo_amplitudes(STATES, 1.0, rcs, 7, 3)
        np.testing.assert_array_equal(echo_amplitudes(STATES[:2], 1.0, rcs, 7, 3), alphas[:2])


def test_echoes_follow_the_radar_equation_with_a_uniform_phase_per_dwell() -> None:
    alphas = np.array([echo_amplitudes(STATES, 1000.0, "constant", 7, k) for k in range(500)])
    expected = 1000.0 / (STATES[:, 0] ** 2 + STATES[:, 2] ** 2)
    np.testing.assert_allclose(np.abs(alphas), np.tile(expected, (500, 1)), rtol=1e-12)
    assert kstest(np.angle(alphas).ravel() / (2 * np.pi), "uniform", args=(-0.5, 1.0)).pvalue > 1e-6


@pytest.mark.parametrize(("rcs", "shape"), [("swerling1", 1.0), ("swerling3", 2.0)])
def test_a_fluctuating_echo_s_power_has_the_law_s_factor_and_the_same_phase(rcs: str, shape: float) -> None:
    of = {name: np.array([echo_amplitudes(STATES, 1.0, name, 7, k) for k in range(500)]) for name in ("constant", rcs)}
    ratios = of[rcs] / of["constant"]
    factors = np.abs(ratios) ** 2
    np.testing.assert_allclose(np.angle(ratios), 0.0, atol=1e-9)
    assert kstest(factors.ravel(), gamma(shape, scale=1.0 / shape).cdf).pvalue > 1e-6  # of mean 1
    for pair in ((factors[1:, 0], factors[:-1, 0]), (factors[:, 0], factors[:, 1])):  # in two dwells, of two targets
        assert abs(np.corrcoef(*pair)[0, 1]) < 5.0 / np.sqrt(500)
