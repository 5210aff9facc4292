"""What an echo buys of accuracy across the line of sight: as the filter has it, and as Riccati's equation has."""

from dataclasses import replace
from math import hypot, inf, sqrt

import numpy as np
import pytest

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import across_km, spatial_frequency
from cogradar.shared.signal.monopulse import kappa_sq
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.belief.across import echo_gain, needed_zeta, settled_km, settled_zeta
from cogradar.shared.tracking.belief.gaussian_mixture import GaussianMixture, condition
from cogradar.shared.tracking.belief.likelihood import found_look
from cogradar.shared.tracking.model import TrackerModel

RADAR = load("paper-best-range", ["radar.tracks=unknown"]).radar
N_RX = RADAR.array.n_rx
MODEL = TrackerModel.of(RADAR, Strategy.POWER_AWARE, seed=1)
STRAIGHT = replace(MODEL, is_mixture=False, sigma_straight=0.004)
BELIEF = np.array([40.0, -0.1, 30.0, 0.2]), np.diag([0.1, 0.02, 0.1, 0.03]) ** 2


def test_an_echo_of_the_zeta_that_is_needed_leaves_the_accuracy_that_is_wanted() -> None:
    assert across_km(*BELIEF) == pytest.approx(0.1)
    zeta, nu = needed_zeta(N_RX, BELIEF, 0.06), float(spatial_frequency(BELIEF[0][np.newaxis])[0])
    seen = (nu, 1.0 / sqrt(kappa_sq(N_RX) * zeta), hypot(40.0, 30.0) + 0.1)
    looks = found_look(MODEL.response, nu, 0.01, 20.0, 5.0, seen, (35.0, 65.0))
    left, _ = condition(STRAIGHT, GaussianMixture.of_moments(*BELIEF, has_turns=False), looks)
    assert across_km(*left.moments()) == pytest.approx(0.06, rel=0.02)
    assert needed_zeta(N_RX, BELIEF, 0.1001) == 0.0


def test_what_it_settles_to_is_the_fixed_point_of_a_kalman_filter_and_more_where_targets_may_turn() -> None:
    zeta, dt, q = 300.0, MODEL.motion.dt, 0.004
    s = 2.0 * 50.0 / 0.8 / sqrt(kappa_sq(N_RX) * zeta)
    step, by, p = np.array([[1.0, dt], [0.0, 1.0]]), np.array([dt * dt / 2.0, dt]), np.eye(2)
    for _ in range(300):
        p = step @ p @ step.T + q * q * np.outer(by, by)
        p = p - np.outer(p[:, 0], p[0]) / (p[0, 0] + s * s)
    found = settled_km(STRAIGHT, N_RX, BELIEF, zeta)
    assert found == pytest.approx(sqrt(p[0, 0]), rel=0.02)
    assert settled_km(replace(MODEL, sigma_straight=q), N_RX, BELIEF, zeta) > 1.05 * found


def test_the_echo_that_keeps_an_accuracy_is_found_or_there_is_none() -> None:
    best = settled_km(MODEL, N_RX, BELIEF, 1e4)
    zeta = settled_zeta(MODEL, N_RX, BELIEF, 2.0 * best, 1e4)
    assert 0.9 <= settled_km(MODEL, N_RX, BELIEF, zeta) / (2.0 * best) <= 1.0
    assert settled_zeta(MODEL, N_RX, BELIEF, 0.9 * best, 1e4) == inf


def test_the_gain_of_a_plan_is_of_a_threshold_for_all_its_range_cells() -> None:
    gate, p_fa = np.array([48.0, 52.0]), RADAR.detector.p_fa
    assert echo_gain(RADAR, 3.0, gate) == pytest.approx(3.0 * threshold(p_fa, 8) / threshold(p_fa))
    assert echo_gain(RADAR, 3.0, np.zeros(2)) > echo_gain(RADAR, 3.0, gate)
