"""A detection beside a sharp belief: with wide looks the belief doubts its velocities, and finds the target again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.signal.radar_equation import amplitude
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.belief.particle_filter import update
from cogradar.shared.tracking.initiation import doubted
from tests.shared.tracking.models import in_bins, paper_model

MODEL = replace(paper_model(n_particle=4000), wide_looks=True)
SIGMA = 0.01
BELIEF = np.array([25.0, 0.0, 5.0, 0.28]) + np.random.default_rng(1).normal(size=(4000, 4)) * [0.05, 0.01, 0.05, 0.01]


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def hit(bin_: int, range_km: float) -> Looks:
    sigma = np.zeros(100)
    sigma[bin_ - 2 : bin_ + 3] = SIGMA
    return in_bins(bin_, float(amplitude(MODEL.sensor.amplitude / SIGMA, np.array(range_km**2))), sigma)


def test_every_second_particle_flies_the_last_dwell_again_at_another_velocity() -> None:
    before = BELIEF.copy()
    after = doubted(MODEL, BELIEF, rng())
    np.testing.assert_array_equal(BELIEF, before)
    np.testing.assert_array_equal(after[1::2], before[1::2])
    started = before[::2, 0::2] - before[::2, 1::2]
    np.testing.assert_allclose(after[::2, 0::2], started + after[::2, 1::2], atol=1e-12)
    assert np.abs(after[::2, 1::2]).max() <= 0.35
    np.testing.assert_allclose(after[::2, 1::2].std(axis=0), 0.35 / np.sqrt(3.0), rtol=0.1)
    assert (doubted(MODEL, BELIEF * [0.0, 1.0, 1.0, 1.0], rng())[:, 0] >= 0.0).all()  # never behind the array


@pytest.mark.parametrize("bin_", [58, 59, 61])
def test_a_detection_beside_the_belief_makes_it_doubt_its_velocity(bin_: int) -> None:
    """Expected in bin 60 at 25.5 km, at 280 m/s; found beside it at that range."""
    found, kept = (update(model, BELIEF, hit(bin_, 25.5), rng()) for model in (MODEL, replace(MODEL, wide_looks=False)))
    assert found.evidence < 0.05
    off = [np.sqrt(((one.particles[:, 1::2] - BELIEF[0, 1::2]) ** 2).mean()) for one in (found, kept)]
    assert off[0] > 5.0 * off[1]
    assert np.hypot(found.particles[:, 0], found.particles[:, 2]).mean() == pytest.approx(25.5, abs=0.3)


def test_what_is_expected_is_not_doubted() -> None:
    alone = replace(MODEL, n_track=1)  # no echo is another target's
    found, kept = (update(model, BELIEF, hit(60, 25.55), rng()) for model in (alone, replace(alone, wide_looks=False)))
    np.testing.assert_array_equal(found.particles, kept.particles)


def test_a_target_that_turns_is_followed() -> None:
    """Half a circle at 6 g, 15 s: detections in its bins, with its ranges."""

    def errors(model_is_wide: bool) -> NDArray[np.float64]:
        model, particles, found = replace(MODEL, wide_looks=model_is_wide), BELIEF, []
        position, velocity = np.array([25.0, 5.0]), np.array([0.0, 0.28])
        for k in range(15):
            angle = 0.0588 / 0.28
            c, s = np.cos(angle), np.sin(angle)
            position = position + velocity
            velocity = np.array([[c, -s], [s, c]]) @ velocity
            bin_ = int(np.rint((0.5 * position[1] / np.hypot(*position) + 0.5) * 99))
            particles = update(model, particles, hit(bin_, float(np.hypot(*position))), rng(k)).particles
            found.append(np.hypot(*(particles[:, 0::2].mean(axis=0) - position)))
        return np.array(found)

    wide, narrow = errors(True), errors(False)
    assert np.sqrt((wide**2).mean()) < 0.75 * np.sqrt((narrow**2).mean())
