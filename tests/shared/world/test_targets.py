"""The true targets against the motion model and the radar equation."""

import numpy as np
from scipy.stats import kstest

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
    np.testing.assert_array_equal(echo_amplitudes(STATES[:2], 1.0, 7, 3), echo_amplitudes(STATES, 1.0, 7, 3)[:2])


def test_echoes_follow_the_radar_equation_with_a_uniform_phase_per_dwell() -> None:
    alphas = np.array([echo_amplitudes(STATES, 1000.0, 7, k) for k in range(500)])
    expected = 1000.0 / (STATES[:, 0] ** 2 + STATES[:, 2] ** 2)
    np.testing.assert_allclose(np.abs(alphas), np.tile(expected, (500, 1)), rtol=1e-12)
    assert kstest(np.angle(alphas).ravel() / (2 * np.pi), "uniform", args=(-0.5, 1.0)).pvalue > 1e-6
