"""A belief of Gaussians against many particles that are weighed one by one."""

from functools import cache
from math import hypot

import numpy as np
import pytest

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import MIXTURE_STATES
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.tracking.belief.gaussian_mixture import (
    GaussianMixture,
    _cut_to_cell,
    begin_at_detection,
    condition,
)
from cogradar.shared.tracking.belief.likelihood import Looks, found_look, likelihood_of, missed_looks
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.belief.turning import LATERAL, moved_modes, turned_state
from cogradar.shared.tracking.model import TrackerModel

UNKNOWN = load("paper-best-range", ["radar.tracks=unknown", "radar.array.n_tx=32", "radar.array.n_rx=32"]).radar
MODEL = TrackerModel.of(UNKNOWN, Strategy.POWER_AWARE, seed=1)
STRAIGHT = np.array([1.0, 0.0, 0.0])
MEAN = np.array([40.0, -0.1, 12.0, 0.2, 0.0])
SPREAD = np.diag([0.1, 0.02, 0.4, 0.03, 0.0]) ** 2
G = 9.80665e-3


def mixture(weights: np.ndarray = STRAIGHT) -> GaussianMixture:
    covariances = np.repeat(SPREAD[np.newaxis], 3, axis=0)
    covariances[:, 4, 4] = LATERAL**2
    return GaussianMixture(weights.copy(), np.repeat(MEAN[np.newaxis], 3, axis=0), covariances)


@cache
def particles(n: int = 400_000) -> np.ndarray:
    return np.random.default_rng(1).multivariate_normal(MEAN[:4], SPREAD[:4, :4], n)


def found(nu_sigma: float = 0.002, off: float = 0.001) -> Looks:
    nu = float(spatial_frequency(MEAN[np.newaxis, :4])[0])
    range_km = MODEL.response.range_cell_km * (int(hypot(MEAN[0], MEAN[2]) / MODEL.response.range_cell_km) + 0.5)
    return found_look(MODEL.response, nu, 0.01, 20.0, 5.0, (nu + off, nu_sigma, range_km), (35.0, 48.0))


def weighted_moments(states: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = weights @ states / weights.sum()
    off = states - mean
    return mean, (weights[:, np.newaxis] * off).T @ off / weights.sum()


@pytest.mark.parametrize("off", [0.0, 0.002, -0.003])
def test_a_detection_leaves_what_particles_say(off: float) -> None:
    states, looks = particles(), found(off=off)
    likelihood = likelihood_of(MODEL.sensor, looks)._replace(hit_log_p=np.empty(0))
    mean, covariance = weighted_moments(states, weigh(states, likelihood).weights)
    after, _ = condition(MODEL, mixture(), looks)
    got_mean, got = after.moments()
    sigma = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(got_mean - mean) < 0.1 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(got)), sigma, rtol=0.08)


def test_a_detection_at_the_other_end_is_one_beside_the_track() -> None:
    def at(nu: float) -> Looks:
        return found_look(MODEL.response, nu, 0.01, 20.0, 5.0, (nu, 0.002, 42.25), (35.0, 48.0))

    belief = begin_at_detection(MODEL, at(0.4975))
    (beyond, probable), (other_end, as_probable) = (condition(MODEL, belief, at(nu)) for nu in (0.5005, -0.4995))
    assert as_probable == pytest.approx(probable, rel=1e-9)
    np.testing.assert_allclose(other_end.means, beyond.means, rtol=1e-9)
    assert float(spatial_frequency(other_end.moments()[0])) > 0.49
    # Also where the belief may be wrong: its target is not 84 km away.
    far = found_look(MODEL.response, 0.4995, 0.01, 20.0, 5.0, (-0.4995, 0.002, 46.25), (35.0, 48.0))
    mean, covariance = condition(MODEL, belief, far)[0].moments()
    assert mean[2] > 42.0
    assert covariance[2, 2] < 2.0**2
    states = np.array([[2.0, 0.0, 42.0, 0.0], [2.0, 0.0, -42.0, 0.0]])
    same = [weigh(states, likelihood_of(MODEL.sensor, at(nu))).weights for nu in (0.4995, -0.5005)]
    np.testing.assert_allclose(same[0], same[1], rtol=1e-9)


@pytest.mark.parametrize("beside", [0.0, 0.01, 0.03])
def test_misses_leave_what_particles_say(beside: float) -> None:
    states = particles()
    nu = float(spatial_frequency(MEAN[np.newaxis, :4])[0])
    looks = missed_looks(MODEL.response, np.array([nu + beside]), np.array([1e-4]), 20.0, (35.0, 48.0))
    model = MODEL.of_echo(1e-6)
    weights = weigh(states, likelihood_of(model.sensor, looks)).weights
    mean, covariance = weighted_moments(states, weights)
    after, evidence = condition(model, mixture(), looks)
    assert evidence == pytest.approx(weights.mean(), rel=0.05, abs=0.005)
    got_mean, got = after.moments()
    sigma = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(got_mean - mean) < 0.15 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(got)), sigma, rtol=0.15)


def test_looks_elsewhere_say_nothing() -> None:
    looks = missed_looks(MODEL.response, np.array([-0.3]), np.array([1e-4]), 20.0, (35.0, 48.0))
    after, evidence = condition(MODEL.of_echo(1e-6), mixture(), looks)
    assert evidence == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(after.means, mixture().means, atol=1e-3)
    np.testing.assert_allclose(after.covariances[0], SPREAD, atol=1e-7)


def test_a_turn_is_a_circle() -> None:
    state, across = MEAN.copy(), 3.0 * G
    state[4] = across
    speed = hypot(state[1], state[3])
    radius = speed**2 / across
    full = 2.0 * np.pi * radius / speed
    np.testing.assert_allclose(turned_state(state, full), state, atol=1e-9)
    half = turned_state(state, full / 2.0)
    assert hypot(half[0] - state[0], half[2] - state[2]) == pytest.approx(2.0 * radius)
    np.testing.assert_allclose(half[[1, 3]], -state[[1, 3]], atol=1e-12)


@pytest.mark.parametrize("dt", [0.1, 1.0, 5.0])
def test_prediction_is_that_of_many_flights(dt: float) -> None:
    """Of a mixture of three modes: mean and spread of places."""
    rng, n = np.random.default_rng(2), 100_000
    before = mixture(np.array([0.5, 0.3, 0.2]))
    after = GaussianMixture(*moved_modes(*before, dt, 0.0005, True))
    assert after.weights.sum() == pytest.approx(1.0)
    mode = rng.choice(3, n, p=after.weights)
    states = np.column_stack((particles(n), rng.standard_normal(n) * LATERAL[mode]))
    flown = np.array([turned_state(state, dt)[[0, 2]] for state in states[:20_000]])
    mean, covariance = after.moments()
    np.testing.assert_allclose(mean[[0, 2]], flown.mean(axis=0), atol=0.02 + 0.02 * dt)
    sigma = np.sqrt(np.diag(covariance)[[0, 2]])
    np.testing.assert_allclose(sigma, flown.std(axis=0), rtol=0.15)


def test_weights_do_not_change_without_turns() -> None:
    after = GaussianMixture(*moved_modes(*mixture(), 1.0, 0.004, False))
    np.testing.assert_array_equal(after.weights, STRAIGHT)
    cv = np.kron(np.eye(2), np.array([[1.0, 1.0], [0.0, 1.0]]))
    added = np.kron(np.eye(2), 0.004**2 * np.array([[0.25, 0.5], [0.5, 1.0]]))
    np.testing.assert_allclose(after.covariances[0, :4, :4], cv @ SPREAD[:4, :4] @ cv.T + added, atol=1e-12)


def test_a_belief_that_was_wrong_begins_anew() -> None:
    """A detection 30 sigmas away is the target's all the same; its velocity is not known any more."""
    after, _ = condition(MODEL, mixture(np.array([0.9, 0.07, 0.03])), found(off=0.15))
    mean, covariance = after.moments()
    anew = begin_at_detection(MODEL, found(off=0.15))
    np.testing.assert_allclose(mean, anew.moments()[0], atol=0.05)
    np.testing.assert_allclose(covariance[[1, 3], [1, 3]], MODEL.acquisition.v_max_km_s**2 / 3.0, rtol=0.05)


def test_a_sample_has_the_moments_of_its_belief() -> None:
    belief = mixture(np.array([0.6, 0.3, 0.1]))
    states = belief.sample()
    mean, covariance = belief.moments()
    assert states.shape == (MIXTURE_STATES, 4)
    assert (np.abs(states.mean(axis=0) - mean) < 0.1 * np.sqrt(np.diag(covariance))).all()
    np.testing.assert_allclose(states.std(axis=0), np.sqrt(np.diag(covariance)), rtol=0.1)
    assert belief.sample().tobytes() == states.tobytes()


def test_rows_carry_a_belief() -> None:
    belief = condition(MODEL, mixture(np.array([0.6, 0.3, 0.1])), found())[0]
    again = GaussianMixture.of_rows(belief.rows)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(belief, again, strict=True))
    assert belief.rows.nbytes < 1000


def test_covariances_stay_covariances() -> None:
    """Symmetric to the last bit, and none with a negative variance, through hits, misses and turns."""
    rng, belief = np.random.default_rng(3), begin_at_detection(MODEL, found())
    for _ in range(300):
        belief = belief.ahead(MODEL)
        if rng.random() < 0.7:
            mean = belief.moments()[0]
            nu = float(np.clip(spatial_frequency(mean[np.newaxis])[0] + rng.normal(0.0, 0.003), -0.499, 0.499))
            range_km = 0.5 * (int(max(hypot(mean[0], mean[2]) + rng.normal(0.0, 0.5), 6.0) / 0.5) + 0.5)
            looks = found_look(MODEL.response, nu, 0.01, 20.0, 5.0, (nu, 0.002, range_km), (5.0, 100.0))
        else:
            nus = spatial_frequency(belief.sample()[:2]).copy()
            looks = missed_looks(MODEL.response, nus, np.full(2, 1e-3), 20.0, (5.0, 100.0))
        belief, _ = condition(MODEL.of_echo(1e-5), belief, looks)
        covariance = belief.moments()[1]
        assert (covariance == covariance.T).all()
        assert np.linalg.eigvalsh(covariance).min() > -1e-12
        assert belief.weights.sum() == pytest.approx(1.0)


def test_the_farther_a_range_cell_is_the_less_probable_it_is() -> None:
    """And what the cut leaves lies in the cell, through the tail where the probability is an asymptote."""
    spread = np.diag([0.03, 0.02, 0.03, 0.03, 0.0]) ** 2
    chances = list[float]()
    for low in np.arange(0.1, 0.4, 0.002):
        cell = np.array([40.0 + low, 40.5 + low])
        moved, left = np.array([40.0, 0.0, 0.0, 0.0, 0.0]), spread.copy()
        chances.append(_cut_to_cell(moved, left, cell))
        assert cell[0] <= moved[0] <= cell[1]
        assert 0.0 < left[0, 0] < spread[0, 0]
    ratios = np.array(chances[1:]) / np.array(chances[:-1])
    assert (ratios < 1.0).all()
    assert (np.abs(np.diff(np.log(ratios))) < 0.1).all()  # no jump


def test_a_belief_at_the_edge_of_the_field_learns_directions() -> None:
    """It has flown to x < 0, where nobody is: one detection brings it back, a miss says something."""
    mean, covariance = np.array([-0.05, -0.02, 40.0, 0.0]), np.diag([0.5, 0.1, 0.5, 0.1]) ** 2
    belief = GaussianMixture.of_moments(mean, covariance, has_turns=False)
    assert (belief.sample()[:, 0] >= 0.0).all()
    hit = found_look(MODEL.response, 0.49, 0.01, 20.0, 5.0, (0.4999, 0.0005, 40.25), (35.0, 48.0))
    after, _ = condition(MODEL, belief, hit)
    assert np.isfinite(after.means).all()
    assert 39.5 < float(np.hypot(*after.moments()[0][[0, 2]])) < 41.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_target_found_at_end_fire_is_where_its_directions_are(side: float) -> None:
    """A direction is cut off at +-0.5: the belief has the mean direction of those that are left."""
    nu_sigma, range_km = 0.0005, 60.25
    nus = np.random.default_rng(1).normal(0.5, nu_sigma, 200_000)
    expected = float(nus[nus < 0.5].mean())
    hit = found_look(MODEL.response, 0.5 * side, 0.01, 20.0, 5.0, (0.5 * side, nu_sigma, range_km), (35.0, 70.0))
    mean, covariance = begin_at_detection(MODEL, hit).moments()
    assert side * float(spatial_frequency(mean[np.newaxis])[0]) == pytest.approx(expected, abs=1e-5)
    assert mean[0] < 3.0 * np.sqrt(covariance[0, 0])
