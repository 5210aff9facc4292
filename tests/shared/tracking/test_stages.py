"""A sharp detection that few particles explain, taken in by stages: against a belief of two million particles."""

import numpy as np
import pytest
from numpy.typing import NDArray

from shared.tracking import particle_filter
from shared.tracking.model import TrackerModel
from shared.tracking.particle_filter import condition
from shared.tracking.steered.looks import likelihood_of
from shared.tracking.steered.resampling import weigh_looks
from tests.shared.tracking.models import paper_model
from tests.shared.tracking.test_steered import NU, RANGE_KM, hit, rng, spread

N, N_EXACT, SEEDS = 2000, 2_000_000, range(40)
NU_SIGMA, RANGE_SIGMA = 0.002, 3.0  # of the belief
OFF = NU + 2.0 * NU_SIGMA
SURPRISE = hit(nus=np.array([OFF]), nu_hat=OFF, nu_sigma=0.1 * NU_SIGMA, amplitude=7.0)


def _moments(states: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean and standard deviation of the range, km."""
    ranges_km = np.hypot(states[:, 0], states[:, 2])
    mean = np.average(ranges_km, weights=weights)
    return np.array([mean, np.sqrt(np.average((ranges_km - mean) ** 2, weights=weights))])


def _errors(model: TrackerModel, exact: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of both over many beliefs, root mean square in units of the exact deviation."""
    found = []
    for seed in SEEDS:
        update = condition(model, spread(N, NU_SIGMA, RANGE_SIGMA, seed), SURPRISE, rng(seed, 1))
        assert not update.depleted
        found.append(_moments(update.particles, np.ones(N)) - exact)
    return np.asarray(np.sqrt(np.mean(np.square(found), axis=0)) / exact[1])


def test_a_surprise_leaves_the_belief_that_more_particles_would_have(monkeypatch: pytest.MonkeyPatch) -> None:
    model = paper_model(n_particle=N)
    prior = spread(N_EXACT, NU_SIGMA, RANGE_SIGMA, 99)
    exact = _moments(prior, weigh_looks(prior, likelihood_of(model.sensor, SURPRISE)).weights)
    assert exact[0] < RANGE_KM - 1.0  # it tells of the range, too
    in_stages = _errors(model, exact)
    monkeypatch.setattr(particle_filter, "FEW", 0.0)
    at_once = _errors(model, exact)
    assert (at_once > 0.1).all()
    assert (in_stages < 0.6 * at_once).all()


def test_what_many_particles_explain_is_taken_in_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = hit(nu_hat=NU, nu_sigma=NU_SIGMA)
    model, predicted = paper_model(n_particle=N), spread(N, NU_SIGMA, RANGE_SIGMA)
    found = condition(model, predicted, expected, rng(1))
    monkeypatch.setattr(particle_filter, "FEW", 0.0)
    np.testing.assert_array_equal(found.particles, condition(model, predicted, expected, rng(1)).particles)


def test_the_evidence_is_that_of_the_belief_before_it() -> None:
    model, predicted = paper_model(n_particle=N), spread(N, NU_SIGMA, RANGE_SIGMA)
    weighted = weigh_looks(predicted, likelihood_of(model.sensor, SURPRISE))
    assert condition(model, predicted, SURPRISE, rng(1)).evidence == weighted.total / N
