"""Two aircraft in one bin have one echo: the track of the weaker one must not go over to the stronger one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.signal.array import bin_centres
from cogradar.shared.tracking.belief import particle_filter
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.particle_filter import condition, update
from cogradar.shared.tracking.model import NONE, TrackState
from cogradar.shared.tracking.motion import predicted_bins
from cogradar.shared.tracking.track import observe
from tests.shared.tracking.models import in_bins, paper_model
from tests.shared.tracking.scans import bins_scan

BIN, FAR_KM, NEAR_KM, SIGMA = 60, 90.0, 37.0, 0.01  # u = 12 and 73
TOGETHER, N_DWELL = range(15, 45), 60  # dwells with the near aircraft in the bin
MODEL = paper_model(n_particle=2000)


def far_aircraft() -> TrackState:
    """The track of an aircraft that hovers in the middle of the bin."""
    rng = np.random.default_rng(1)
    theta, n = np.arcsin(2.0 * bin_centres(100)[BIN]), MODEL.belief.n_particle
    range_km, bearing = FAR_KM + rng.normal(0.0, 1.0, n), theta + rng.normal(0.0, 0.002, n)
    velocity = rng.normal(0.0, 0.01, (n, 2))
    return TrackState(
        target=0,
        k=0,
        belief=Particles(
            np.column_stack((range_km * np.cos(bearing), velocity[:, 0], range_km * np.sin(bearing), velocity[:, 1]))
        ),
        detected=True,
        depleted=False,
        sigma_hat=SIGMA,
        in_beam=True,
        level=1.0,
        power=1e4,
        echo=0.0,
        remembered=NONE,
        hit_bin=BIN,
        hit_amplitude=1000.0 / FAR_KM**2 / SIGMA,
        measured=np.zeros(4),
        looked=np.empty((0, 100)),
        log_evidence=0.0,
        attempts=0,
    )


def range_errors() -> NDArray[np.float64]:
    """Of the far aircraft's track after each dwell, km."""
    rng, state, errors = np.random.default_rng(2), far_aircraft(), list[float]()
    for k in range(1, N_DWELL + 1):
        turns = np.exp(2j * np.pi * rng.random(2))
        alpha = 1000.0 / FAR_KM**2 * turns[0] + (k in TOGETHER) * 1000.0 / NEAR_KM**2 * turns[1]
        alpha_hat = alpha + SIGMA * np.sqrt(0.5) * (rng.standard_normal() + 1j * rng.standard_normal())
        scan = bins_scan(
            100,
            k=k,
            bins=np.array([BIN], dtype=np.int32),
            statistic=np.array([2.0 * abs(alpha_hat) ** 2 / SIGMA**2]),
            alpha_hat=np.array([alpha_hat], dtype=np.complex64),
            sigma_hat=np.array([SIGMA]),
            signature_power=np.array([1e4]),
            beams=np.array([[BIN]], dtype=np.int32),
        )
        state = observe(MODEL, state, scan)
        errors.append(float(np.hypot(state.belief.rows[:, 0], state.belief.rows[:, 2]).mean()) - FAR_KM)
    return np.array(errors)


def test_the_farther_track_is_not_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = range_errors()
    assert np.abs(np.diff(errors)).max() < 10.0
    assert abs(errors[-1]) < 5.0
    monkeypatch.setattr(particle_filter, "EXPECTED", 2.0)  # never: a range that explains the amplitude is drawn
    assert np.abs(np.diff(range_errors())).max() > 40.0


def test_an_echo_of_another_target_tells_a_track_of_several_cells_nothing() -> None:
    """What it expected there is too weak for it: it coasts, and is where it was when its own echo comes back."""
    model, state = replace(MODEL, wide_looks=True), far_aircraft()
    observation = in_bins(BIN, 1000.0 / 60.0**2 / SIGMA, np.where(np.arange(100) == BIN, SIGMA, 0.0))
    told = update(model, state.belief.rows, observation, np.random.default_rng(3))
    assert not told.depleted
    ranges_km = np.hypot(told.particles[:, 0], told.particles[:, 2])
    assert ranges_km.mean() == pytest.approx(FAR_KM, abs=0.5)
    assert ranges_km.std() == pytest.approx(1.0, abs=0.2)
    own = observation._replace(amplitude=1000.0 / FAR_KM**2 / SIGMA)
    assert update(model, told.particles, own, np.random.default_rng(4)).evidence > 0.1


def test_a_detection_where_nothing_was_expected_is_the_tracks_whatever_its_amplitude() -> None:
    """It was looked for there: the target has turned."""
    model, state = replace(MODEL, wide_looks=True), far_aircraft()
    observation = in_bins(BIN + 4, 1000.0 / FAR_KM**2 / SIGMA, np.where(np.arange(100) == BIN + 4, SIGMA, 0.0))
    told = update(model, state.belief.rows, observation, np.random.default_rng(3))
    assert (predicted_bins(told.particles, 100, 0.0)[BIN + 4]) == told.particles.shape[0]


@pytest.mark.parametrize("sigmas", [6.0, 6.5])
def test_an_echo_of_another_target_draws_no_belief_into_its_bin(sigmas: float) -> None:
    """A belief half in the bin and half beside it: a strong echo moves of it what the weights say, and no more."""
    model, state = replace(MODEL, wide_looks=True, n_track=12), far_aircraft()
    particles, u = state.belief.rows.copy(), 1000.0 / FAR_KM**2 / SIGMA
    theta = np.arcsin(2.0 * (bin_centres(100)[BIN] + 0.5 / 99.0)) + np.arctan2(particles[:, 2], particles[:, 0])
    theta -= np.arcsin(2.0 * bin_centres(100)[BIN])
    range_km = np.hypot(particles[:, 0], particles[:, 2])
    particles[:, 0::2] = range_km[:, np.newaxis] * np.column_stack((np.cos(theta), np.sin(theta)))
    sigma = np.where(np.arange(100) == BIN, SIGMA, 0.0)
    before = told = particles
    for k in range(10):
        hit = in_bins(BIN, u + sigmas * np.sqrt(0.5), sigma)
        told = condition(model, told, hit, np.random.default_rng(k)).particles
    shares = [predicted_bins(one, 100, 0.0)[BIN] / before.shape[0] for one in (before, told)]
    assert 0.3 < shares[0] < 0.7
    assert shares[1] == pytest.approx(shares[0], abs=0.06)
