"""A sharp detection that few particles explain, taken in by stages: against a belief of two million particles."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.tracking.belief import particle_filter
from cogradar.shared.tracking.belief.likelihood import likelihood_of
from cogradar.shared.tracking.belief.particle_filter import condition
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.model import TrackerModel
from tests.shared.tracking.models import paper_model
from tests.shared.tracking.test_steered import NU, RANGE_KM, SIGMA, hit, rng, spread

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
    exact = _moments(prior, weigh(prior, likelihood_of(model.sensor, SURPRISE)).weights)
    assert exact[0] < RANGE_KM - 1.0  # it tells of the range, too
    in_stages = _errors(model, exact)
    monkeypatch.setattr(particle_filter, "MIN_ESS_FRACTION", 0.0)
    at_once = _errors(model, exact)
    assert (at_once > 0.1).all()
    assert (in_stages < 0.6 * at_once).all()


def test_what_many_particles_explain_is_taken_in_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = hit(nu_hat=NU, nu_sigma=NU_SIGMA)
    model, predicted = paper_model(n_particle=N), spread(N, NU_SIGMA, RANGE_SIGMA)
    found = condition(model, predicted, expected, rng(1))
    monkeypatch.setattr(particle_filter, "MIN_ESS_FRACTION", 0.0)
    np.testing.assert_array_equal(found.particles, condition(model, predicted, expected, rng(1)).particles)


def test_the_evidence_is_that_of_the_belief_before_it() -> None:
    model, predicted = paper_model(n_particle=N), spread(N, NU_SIGMA, RANGE_SIGMA)
    weighted = weigh(predicted, likelihood_of(model.sensor, SURPRISE))
    assert condition(model, predicted, SURPRISE, rng(1)).evidence == weighted.total / N


def test_where_a_direction_is_not_measured_both_sides_of_a_cell_stay() -> None:
    """An echo of half its amplitude on axis is from either side; a kernel would fill the middle."""
    model, predicted = paper_model(n_particle=N), spread(N, 2.0 * NU_SIGMA, 0.3)
    strong = hit(amplitude=100.0, sigma=np.array([SIGMA * 5.5 / 200.0]))
    weighted = weigh(predicted, likelihood_of(model.sensor, strong))
    assert weighted.total**2 / weighted.total_sq < particle_filter.MIN_ESS_FRACTION * N
    found = condition(model, predicted, strong, rng(1))
    left = spatial_frequency(predicted) < NU
    share = float((spatial_frequency(found.particles) < NU).mean())
    assert share == pytest.approx(weighted.weights[left].sum() / weighted.total, abs=0.1)
    assert 0.2 < share < 0.8


def test_stages_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they lead nowhere the detection is taken in at once."""
    model, predicted = paper_model(n_particle=N), spread(N, NU_SIGMA, RANGE_SIGMA)
    monkeypatch.setattr(particle_filter, "MIN_ESS_FRACTION", 2.0)  # more than there can be
    found = condition(model, predicted, SURPRISE, rng(1))
    assert not found.depleted
    assert np.isfinite(found.particles).all()
