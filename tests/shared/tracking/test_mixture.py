"""Motion as a mixture of straight flight and turns: its kernels, its Markov chain, and a turn that is followed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from cogradar.shared.planning.steering import expected_at, gate
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.response import FAR_KM
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.belief.particle_filter import predict, update
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.motion import (
    CERTAINLY_HARD,
    CERTAINLY_STRAIGHT,
    HARD,
    MODES,
    STRAIGHT,
    TURN,
    Motion,
    covariance_of_state,
    expected_states,
    mean_state,
    mode_of,
    mode_quantile,
    modes_after,
    modes_at_first,
    modes_told,
    predicted_moments,
    predicted_states,
    propagate_into,
)
from cogradar.shared.tracking.track import warm_up
from tests.oracles.motion import propagate_mixture
from tests.plain import plain

G = 9.80665e-3
MIXED = Motion(1.0, 0.004, 0.2, 0.1)
PAPER = load("paper-best-range", ["radar.motion.modes=mixture", "radar.belief.n_particle=3000"]).radar
MODEL = TrackerModel.of(PAPER, Strategy.POWER_AWARE, 5)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def belief(n: int = 3000) -> NDArray[np.float64]:
    return rng().normal([40.0, 0.15, 20.0, 0.2], [0.05, 0.01, 0.05, 0.01], (n, 4))


def modes_of(motion: Motion, n: int) -> NDArray[np.int64]:
    return np.array([mode_of(motion, mode_quantile(i)) for i in range(n)])


@pytest.mark.parametrize("motion", [MIXED, Motion(2.0, 0.0, 0.0, 1.0), Motion(0.5, 0.1, 1.0, 0.0)])
def test_kernel_equals_one_target_after_the_other(motion: Motion) -> None:
    states, out = belief(400), np.empty((400, 4))
    states[::7, 0] = 0.05  # which are clipped, or nearly
    expected = propagate_mixture(states, motion, rng(2))
    for kernel in (propagate_into, plain(propagate_into)):
        kernel(states, motion, rng(2), out)
        np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-13)


def test_modes_are_dealt_as_evenly_as_can_be() -> None:
    """Any neighbours, who may come from one ancestor, have all modes."""
    modes = modes_of(MIXED, 12_000)
    assert np.bincount(modes) / modes.size == pytest.approx([0.7, 0.2, 0.1], abs=1e-3)
    for first in range(0, 11_900, 77):
        assert np.bincount(modes[first : first + 100]) / 100 == pytest.approx([0.7, 0.2, 0.1], abs=0.04)
    assert not modes_of(Motion(1.0, 0.004), 100).any()


def test_a_turn_keeps_the_speed_and_is_within_its_limits() -> None:
    quiet = MIXED._replace(sigma_s=0.0)
    before, modes = belief(), modes_of(quiet, 3000)
    after = predict(quiet, before, rng(9))
    was, now = (states[:, 1] + 1j * states[:, 3] for states in (before, after))
    across = np.abs(np.angle(now / was)) * np.abs(was) / G
    assert across[modes == STRAIGHT].max() < 1e-9
    assert np.abs(now / was)[modes != HARD] == pytest.approx(1.0, abs=1e-12)
    for mode, most in ((TURN, 3.0), (HARD, 9.0)):
        assert 0.97 * most < across[modes == mode].max() <= most
        assert across[modes == mode].mean() == pytest.approx(most / 2.0, rel=0.1)
    along = (np.abs(now) - np.abs(was))[modes == HARD] / G
    assert 2.8 < np.abs(along).max() <= 3.0
    still = np.zeros((300, 4))
    assert np.isfinite(predict(Motion(1.0, 0.0, 0.0, 1.0), still, rng())).all()  # who stands cannot turn


def test_what_is_expected_is_the_mixture_without_chance() -> None:
    particles = belief(12_000)
    np.testing.assert_array_equal(expected_states(particles, Motion(2.0, 0.1)), predicted_states(particles, 2.0))
    expected, drawn = expected_states(particles, MIXED), predict(MIXED._replace(sigma_s=0.0), particles, rng(9))
    assert expected.mean(axis=0) == pytest.approx(drawn.mean(axis=0), abs=2e-4)
    assert np.cov(expected.T) == pytest.approx(np.cov(drawn.T), abs=3e-5)  # those of hard turns brake besides
    np.testing.assert_array_equal(expected, plain(expected_states)(particles, MIXED))


def test_predicted_covariance_has_the_turns() -> None:
    particles = belief(200_000)
    motion = Motion(1.0, 0.004, 0.3, 0.6)
    covariances, modes = np.cov(particles.T)[np.newaxis], np.array([[0.1, motion.turning, motion.hard]])
    _, (within,) = predicted_moments(np.zeros((1, 4)), covariances, modes, np.ones(1), motion.sigma_s)
    drawn = np.cov(predict(motion, particles, rng(9)).T)
    # the mean over the directions of flight: of one direction the sum of both axes is the same
    assert np.trace(within[1::2, 1::2]) == pytest.approx(np.trace(drawn[1::2, 1::2]), rel=0.06)
    assert np.trace(within[::2, ::2]) == pytest.approx(np.trace(drawn[::2, ::2]), rel=0.06)


def test_modes_follow_a_markov_chain() -> None:
    """Of small steps, the one with these rates: straight for 100 s, a turn for 6 s."""
    rates = np.array([[-1.0, 0.5, 0.5], [0.9, -1.0, 0.1], [0.9, 0.1, -1.0]]) / np.array([[100.0], [6.0], [6.0]])
    modes = np.array([0.2, 0.5, 0.3])
    for _ in range(1000):
        modes = modes_after(modes, 0.01)
    assert modes == pytest.approx(np.array([0.2, 0.5, 0.3]) @ expm(10.0 * rates), abs=1e-3)
    assert modes_after(modes, 60.0).sum() == pytest.approx(1.0, abs=1e-15)
    first = modes_at_first()
    assert first.size == len(MODES)
    assert first == pytest.approx([0.99, 0.005, 0.005], abs=1e-4)


def test_what_modes_are_told_is_their_share_of_the_weights() -> None:
    weights, modes = rng().random(999), modes_of(MIXED, 999)
    expected = np.bincount(modes, weights) / weights.sum()
    for kernel in (modes_told, plain(modes_told)):
        assert kernel(weights, MIXED) == pytest.approx(expected, rel=1e-12)


def test_a_gate_holds_who_may_turn_hard() -> None:
    turning = MODEL.of_modes(np.array([0.0, 0.0, 1.0]))
    state = warm_up(turning)._replace(belief=Particles(belief()), modes=turning.modes)
    _, ranges_km = expected_at(turning, state)
    low, high = gate(turning, ranges_km, 0.0).tolist()
    assert low < ranges_km.min() < ranges_km.max() < high
    assert high - low < 4.0
    assert expected_at(MODEL, state._replace(modes=CERTAINLY_STRAIGHT))[1].std() < ranges_km.std()


def test_a_mixture_is_what_an_unknown_number_of_tracks_means() -> None:
    def modes(*settings: str) -> str:
        return load("paper-best-range", settings).radar.motion.modes

    assert modes() == "constant-velocity"
    assert modes('radar.tracks="unknown"') == "mixture"
    assert modes('radar.tracks="unknown"', "radar.motion.modes=constant-velocity") == "constant-velocity"
    constant = TrackerModel.of(load("paper-best-range").radar, Strategy.POWER_AWARE, 5)
    assert constant.of_modes(CERTAINLY_HARD) is constant
    assert constant.modes.tolist() == CERTAINLY_STRAIGHT.tolist()


def seen(position: NDArray[np.float64], source: np.random.Generator) -> Looks:
    """A detection: the range cell of a target, and its direction with an error."""
    range_km, sigma = float(np.hypot(*position)), 2e-4
    nu = 0.5 * position[1] / range_km
    cell = 0.5 * (np.floor(range_km / 0.5) + 0.5)
    at, nu_hat = np.array([nu]), float(nu + sigma * source.standard_normal())
    return Looks(MODEL.response, 0, 40.0, nu_hat, sigma, cell, at, np.array([0.01]), 18.0, 0.0, FAR_KM)


def flown(model: TrackerModel, g: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """NEES, (40,), and probabilities of the modes, (40, 3); the target turns from dwell 20 to 28."""
    source, particles, modes = rng(7), belief(), model.modes
    position, velocity = np.array([40.0, 20.0]), 0.15 + 0.2j
    errors, told = [], []
    for k in range(40):
        turned = velocity * np.exp(1j * g * G / abs(velocity)) if 20 <= k < 28 else velocity
        chord = 0.5 * (velocity + turned)
        position, velocity = position + np.array([chord.real, chord.imag]), turned
        now = model.of_modes(modes).of_echo(0.16)
        updated = update(now, particles, seen(position, source), rng(k))
        particles, modes = updated.particles, updated.modes
        mean = mean_state(particles)
        off = mean - [position[0], velocity.real, position[1], velocity.imag]
        errors.append(off @ np.linalg.solve(covariance_of_state(particles, mean), off))
        told.append(modes)
    return np.array(errors), np.array(told)


@pytest.mark.parametrize("g", [3.0, 7.0])
def test_a_turn_is_noticed_and_followed(g: float) -> None:
    """A belief of constant velocity errs by more than it knows for as long as the target turns."""
    errors, modes = flown(MODEL, g)
    assert modes.sum(axis=1) == pytest.approx(1.0)
    assert modes[20:32, STRAIGHT].min() < min(modes[5:20, STRAIGHT].min(), 0.9)
    constant = replace(MODEL, motion=MODEL.motion._replace(turning=0.0, hard=0.0), is_mixture=False)
    others, _ = flown(constant, g)
    assert np.median(errors[20:30]) < 0.5 * np.median(others[20:30])
