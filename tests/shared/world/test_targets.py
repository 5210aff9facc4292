"""The true targets against the motion model and the radar equation."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import gamma, kstest

from shared.numerics.seeds import Purpose, generator
from shared.scenario.world_config import TargetSection
from shared.tracking.motion import Motion
from shared.world.targets import echo_amplitudes, moved
from tests.oracles.motion import propagate

Floats = NDArray[np.float64]
STATES = np.array([[20.0, 0.05, -60.0, 0.01], [60.0, 0.2, 7.5, 0.1], [0.1, -0.3, 60.0, 0.01]])
MOTION = Motion(1.0, 0.004)
STRAIGHT = [TargetSection(state=state.tolist()) for state in STATES]


def flown(turns: list[dict[str, float]], velocity: tuple[float, float], dt: float, t: int) -> Floats:
    """States at t = 0 .. t of a target without noise."""
    target = TargetSection.model_validate({"state": [30.0, velocity[0], 5.0, velocity[1]], "turns": turns})
    states = [np.array([target.state])]
    for k in range(1, t + 1):
        states.append(moved(states[-1], Motion(dt, 0.0), 7, k, [target]))
    return np.concatenate(states)


def test_targets_move_as_the_model_says_each_with_noise_of_its_own() -> None:
    for t in (1, 2):
        expected = [propagate(STATES[m : m + 1], MOTION, generator(7, Purpose.MOTION, m, t))[0] for m in range(3)]
        np.testing.assert_array_equal(moved(STATES, MOTION, 7, t, STRAIGHT), expected)
    assert moved(STATES, MOTION, 7, 1, STRAIGHT)[2, 0] == 0.0  # never behind the array


def test_a_target_does_not_depend_on_the_others() -> None:
    alone, together = (moved(STATES[:n], MOTION, 7, 3, STRAIGHT[:n]) for n in (2, 3))
    np.testing.assert_array_equal(alone, together[:2])
    for rcs in ("constant", "swerling1", "swerling3"):
        alphas = echo_amplitudes(STATES, 1.0, rcs, 7, 3)
        np.testing.assert_array_equal(echo_amplitudes(STATES[:2], 1.0, rcs, 7, 3), alphas[:2])


def test_a_turn_is_a_circle_at_constant_speed_and_its_sign_is_its_sense() -> None:
    """6 g at 280 m/s: a radius of v^2 / a = 1.33 km, round in 2 pi v / a = 29.9 s; the chords meet the circle."""
    g, speed = 9.80665e-3, 0.28
    for sense in (1.0, -1.0):
        path = flown([{"from_s": 2.0, "to_s": 42.0, "g": 6.0 * sense}], (0.0, speed), 1.0, 50)
        radius = speed**2 / (6.0 * g)
        centre = path[2, [0, 2]] + [-sense * radius, 0.0]  # from +x towards +y is to the left of +y, at -x
        np.testing.assert_allclose(np.hypot(*(path[2:43, [0, 2]] - centre).T), radius, rtol=1e-9)
        np.testing.assert_allclose(np.hypot(path[:, 1], path[:, 3]), speed, rtol=1e-9)
        angle = np.unwrap(np.arctan2(path[2:43, 3], path[2:43, 1]))
        np.testing.assert_allclose(np.diff(angle), sense * 6.0 * g / speed, rtol=1e-9)
        for straight in (path[:3], path[42:]):
            np.testing.assert_array_equal(straight[:, 1::2], np.tile(straight[0, 1::2], (len(straight), 1)))


def test_a_turn_may_begin_and_end_within_a_dwell_and_needs_a_speed() -> None:
    whole = flown([{"from_s": 1.0, "to_s": 2.0, "g": 3.0}], (0.2, 0.1), 1.0, 3)
    parted = flown([{"from_s": 0.5, "to_s": 1.0, "g": 3.0}, {"from_s": 1.0, "to_s": 1.5, "g": 3.0}], (0.2, 0.1), 1.0, 3)
    np.testing.assert_allclose(parted[-1, 1::2], whole[-1, 1::2], rtol=1e-12)
    np.testing.assert_array_equal(flown([{"from_s": 0.0, "to_s": 9.0, "g": 6.0}], (0.0, 0.0), 1.0, 3)[:, 0], 30.0)


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
