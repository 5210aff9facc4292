"""At end-fire, where a bin is kilometres wide: the filter against an unscented Kalman filter on the same detections."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.planning.rules import most_probable_bin
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.motion import propagate_into
from cogradar.shared.tracking.track import observe, start
from tests.oracles.ukf import UnscentedFilter
from tests.shared.tracking.models import paper_model
from tests.shared.tracking.scans import bins_scan

N_SCAN = 12
SIGMA = 0.03  # of a tenth of the power: u = 9 at 60 km
MODEL = paper_model(n_particle=2000)


def scan_of(k: int, bins: NDArray[np.int32], alpha_hat: NDArray[np.complex128], sigma: float, beam: int) -> Detections:
    return bins_scan(
        100,
        k=k,
        bins=bins,
        statistic=2.0 * np.abs(alpha_hat) ** 2 / sigma**2,
        alpha_hat=alpha_hat.astype(np.complex64),
        sigma_hat=np.full(bins.size, sigma),
        signature_power=np.full(bins.size, 1.0 / sigma**2),
        beams=np.array([[beam]], dtype=np.int32),
    )


def every_bin() -> NDArray[np.int32]:
    return np.arange(100, dtype=np.int32)


def squared_errors(seed: int, n_dwell: int) -> NDArray[np.float64]:
    """Of both filters' positions, of the third target of the paper's scenario, (n_dwell, 2) km^2."""
    rng, truth = np.random.default_rng(seed), np.array([[5.0, 0.05, 60.0, 0.01]])

    def alpha_hat(bins: NDArray[np.int32], sigma: float) -> NDArray[np.complex128]:
        there = bins == angle_bin(spatial_frequency(truth), 100)
        echo = 1000.0 / np.hypot(truth[0, 0], truth[0, 2]) ** 2 * np.exp(2j * np.pi * rng.random())
        noise = rng.standard_normal((2, bins.size)) * sigma * np.sqrt(0.5)
        return np.asarray(there * (echo + noise[0] + 1j * noise[1]))

    scans = [scan_of(k, every_bin(), alpha_hat(every_bin(), 0.1), 0.1, beam=-1) for k in range(N_SCAN)]
    state = start(MODEL, 0, 99, scans)
    ukf = UnscentedFilter(state.belief.rows, MODEL.motion.sigma_s, MODEL.sensor.amplitude)
    errors = np.empty((n_dwell, 2))
    for k in range(n_dwell):
        propagate_into(truth, MODEL.motion, rng, truth)
        asked = np.array([most_probable_bin(state.belief.rows, 100, MODEL.motion.dt)], dtype=np.int32)
        scan = scan_of(N_SCAN + k, asked, alpha_hat(asked, SIGMA), SIGMA, beam=int(asked[0]))
        state = observe(MODEL, state, scan)
        ukf.predict()
        if scan.statistic[0] >= MODEL.sensor.threshold:
            ukf.update(int(asked[0]), float(abs(scan.alpha_hat[0])) / SIGMA, SIGMA)
        for i, estimate in enumerate((state.belief.rows.mean(axis=0), ukf.mean)):
            errors[k, i] = (estimate[0] - truth[0, 0]) ** 2 + (estimate[2] - truth[0, 2]) ** 2
    return errors


def outbound_x(seed: int, n_dwell: int) -> NDArray[np.float64]:
    """Mean x, km, (n_dwell,), of a belief that is sure of its target, which flies out of the field of view."""
    rng, truth, bin_ = np.random.default_rng(seed), np.array([[0.3, -0.1, -40.0, 0.0]]), np.zeros(1, dtype=np.int32)
    particles = truth + rng.normal(0.0, [0.1, 0.02, 0.5, 0.02], (MODEL.belief.n_particle, 4))
    state = start(MODEL, 0, 0, [scan_of(0, every_bin(), np.ones(100, complex), 0.1, beam=-1)])
    state = state._replace(belief=Particles(particles))
    sigma, x = 1000.0 / 40.0**2 / 12.0, np.empty(n_dwell)  # u = 12
    for k in range(n_dwell):
        propagate_into(truth, MODEL.motion, rng, truth)
        assert angle_bin(spatial_frequency(truth), 100) == bin_
        noise = sigma * np.sqrt(0.5) * (rng.standard_normal(1) + 1j * rng.standard_normal(1))
        echo = 1000.0 / np.hypot(truth[0, 0], truth[0, 2]) ** 2 + noise
        state = observe(MODEL, state, scan_of(1 + k, bin_, echo, sigma, beam=0))
        assert state.detected
        x[k] = state.belief.rows[:, 0].mean()
    assert truth[0, 0] == 0.0
    return x


def test_a_target_that_flies_out_of_the_field_of_view_is_tracked_at_its_edge() -> None:
    """The world holds it there. Its track came back, by 2.2 km in these dwells, while nothing was believed of x = 0."""
    for seed in range(3):
        assert outbound_x(seed, n_dwell=120)[4:].max() < 0.3


@pytest.mark.parametrize(("n_seed", "n_dwell"), [(6, 100), pytest.param(24, 300, marks=pytest.mark.nightly)])
def test_at_end_fire_the_filter_is_no_worse_than_a_kalman_filter(n_seed: int, n_dwell: int) -> None:
    """It was, by a third, while particles that fly outwards were left at x = 0 to explain every detection."""
    rmse = np.sqrt(np.mean([squared_errors(seed, n_dwell) for seed in range(n_seed)], axis=(0, 1)))
    assert rmse[0] < rmse[1]
