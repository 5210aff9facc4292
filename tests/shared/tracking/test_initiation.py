from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.response import BinResponse
from cogradar.shared.tracking.initiation import initial_belief, redraw
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import STEP
from tests.oracles.belief import hit_probability
from tests.shared.tracking.models import in_bins, in_level, paper_model

MODEL = paper_model()  # ranges 5 .. 200 km, velocities within 0.35 km/s
SIGMA = 0.1  # one cell under the orthogonal waveform: sqrt(S/||v||^2) with S = 1, ||v||^2 = 100


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def estimates(range_km: float, n_scan: int, generator: np.random.Generator) -> NDArray[np.complex128]:
    """alpha_hat of a cell with a target at this range."""
    noise = generator.standard_normal(n_scan) + 1j * generator.standard_normal(n_scan)
    echo = 1000.0 / range_km**2 * np.exp(2j * np.pi * generator.random(n_scan))
    return np.asarray(echo + SIGMA * np.sqrt(0.5) * noise)


def belief(
    alpha_hat: NDArray[np.complexfloating], seed: int, bin_: int = 56, n_bin: int = 100, n: int = 4000
) -> NDArray[np.float64]:
    return initial_belief(of(n, n_bin), bin_, alpha_hat, np.full(alpha_hat.size, SIGMA), rng(seed))


def of(n_particle: int, n_bin: int = 100) -> TrackerModel:
    model = paper_model(n_particle=n_particle)
    return replace(model, sensor=model.sensor._replace(n_bin=n_bin), response=BinResponse(n_bin))


# ---- first belief -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_bin", [3, 16, 100, 1024])
def test_every_particle_is_in_the_bin_and_in_view(n_bin: int) -> None:
    for bin_ in sorted({0, 1, n_bin // 2, n_bin - 2, n_bin - 1}):
        particles = belief(np.array([0.3 + 0j]), bin_, bin_, n_bin)
        assert (angle_bin(spatial_frequency(particles), n_bin) == bin_).all()
        assert (particles[:, 0] >= 0.0).all()


@pytest.mark.parametrize(
    ("bin_", "low", "high"), [(0, -np.pi / 2, np.arcsin(-1 + 1 / 99)), (50, 0.0, np.arcsin(2 / 99))]
)
def test_bearing_and_velocities_are_uniform(bin_: int, low: float, high: float) -> None:
    particles = belief(np.array([0.3 + 0j]), 1, bin_)
    theta = np.arctan2(particles[:, 2], particles[:, 0])
    # bin 50 of 100 is centred on nu = 1/198 and reaches from 0 to 1/99; bin 0 is cut in half by end-fire.
    # Kolmogorov-Smirnov at the 1e-6 level, here and below
    assert stats.kstest(theta, stats.uniform(low, high - low).cdf).pvalue > 1e-6
    for velocity in (particles[:, 1], particles[:, 3]):
        assert stats.kstest(velocity, stats.uniform(-0.35, 0.7).cdf).pvalue > 1e-6


@pytest.mark.parametrize(("range_km", "n_scan"), [(5.2, 3), (20.0, 1), (60.0, 12), (85.0, 25), (190.0, 40), (60.0, 1)])
def test_range_against_the_integrated_posterior(range_km: float, n_scan: int) -> None:
    alpha_hat = estimates(range_km, n_scan, rng(n_scan))
    particles = belief(alpha_hat, 2, n=40_000)
    grid = np.geomspace(5.0, 200.0, 40_001)  # at 5.2 km a sixth of the posterior's standard deviation
    log_p = sum(_log_rice(r, 1000.0 / grid**2 / SIGMA) for r in np.abs(alpha_hat) / SIGMA)
    p = np.exp(log_p - np.max(log_p))
    cdf = np.concatenate(([0.0], np.cumsum(0.5 * (p[1:] + p[:-1]) * np.diff(grid))))
    rank = np.interp(np.hypot(particles[:, 0], particles[:, 2]), grid, cdf / cdf[-1])
    assert stats.kstest(rank, "uniform").pvalue > 1e-6
    # the tails, which that test does not see: 80 draws of 40 000 are expected there, 5 sigma is 45
    assert abs(np.sum((rank < 0.001) | (rank > 0.999)) - 80) < 45


def _log_rice(r: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """SciPy's noncentral chi-square density of 2 r^2; far from r, where it fails, any value that is as small."""
    near = np.abs(r - u) < 20.0
    out = -((r - u) ** 2)
    out[near] = stats.ncx2.logpdf(2.0 * r * r, 2, 2.0 * u[near] ** 2)
    return out


def test_posterior_is_calibrated_and_detections_alone_are_not() -> None:
    """Simulation-based calibration (Talts et al. 2018): the truth's rank among the particles is uniform."""
    generator = rng(7)
    ranks: list[float] = []
    ranks_detected: list[float] = []
    while len(ranks) < 250:
        truth = generator.uniform(5.0, 200.0)
        alpha_hat = estimates(truth, 30, generator)
        over = 2.0 * np.abs(alpha_hat) ** 2 / SIGMA**2 >= MODEL.sensor.threshold
        if over.sum() < 2 or truth < 45.0:  # strong targets are seen in each scan, both ways are the same
            continue
        held = np.flatnonzero(over)[1] + 1  # acquisition ends with the second detection
        for ranking, used in ((ranks, alpha_hat[:held]), (ranks_detected, alpha_hat[:held][over[:held]])):
            particles = belief(used, len(ranks), n=500)
            drawn = np.hypot(particles[:, 0], particles[:, 2])
            drawn = drawn[drawn >= 45.0]  # the same condition as on the truth
            ranking.append(float(np.mean(drawn < truth)))
    assert stats.kstest(ranks, "uniform").pvalue > 1e-4
    assert stats.kstest(ranks_detected, "uniform").pvalue < 1e-6


def test_scans_without_a_noise_estimate_are_left_out() -> None:
    alpha_hat = estimates(60.0, 3, rng(1))
    sigma_hat = np.array([SIGMA, 0.0, SIGMA])
    with_gap = initial_belief(of(300), 56, alpha_hat, sigma_hat, rng(2))
    without = initial_belief(of(300), 56, alpha_hat[[0, 2]], sigma_hat[[0, 2]], rng(2))
    np.testing.assert_array_equal(with_gap, without)


def test_no_information_gives_the_prior() -> None:
    particles = initial_belief(of(4000), 56, np.zeros(1, complex), np.zeros(1), rng(3))
    drawn = np.hypot(particles[:, 0], particles[:, 2])
    assert stats.kstest(drawn, stats.uniform(5.0, 195.0).cdf).pvalue > 1e-6


def test_complex64_of_a_message_is_accepted() -> None:
    particles = belief(np.array([0.3 + 0.1j, 0.0], dtype=np.complex64), 4)
    assert particles.dtype == np.float64
    assert np.isfinite(particles).all()


# ---- redrawing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_exact", [True, False])
@pytest.mark.parametrize(("level", "sigma"), [(3, 0.05), (20, 0.01), (1, 0.02), (400, 0.02)])
def test_redraw_follows_the_amplitude_and_keeps_velocities(level: int, sigma: float, is_exact: bool) -> None:
    model, hit = paper_model(is_exact=is_exact), in_level(level) + 0.6
    particles = np.tile([60.0, 0.2, 7.5, 0.1], (4000, 1)) + rng(5).normal(0.0, 0.1, (4000, 4))
    sigmas = np.zeros(100)
    sigmas[12] = sigma
    redrawn = redraw(model, particles, in_bins(12, hit, sigmas), rng(6))
    assert (angle_bin(spatial_frequency(redrawn), 100) == 12).all()
    np.testing.assert_array_equal(redrawn[:, 1::2], particles[:, 1::2])
    grid = np.linspace(5.0, 200.0, 100_001)
    p = hit_probability(hit, model.sensor, 1000.0 / grid**2 / sigma)
    cdf = np.concatenate(([0.0], np.cumsum(0.5 * (p[1:] + p[:-1]))))
    drawn = np.hypot(redrawn[:, 0], redrawn[:, 2])
    assert stats.kstest(drawn, lambda x: np.interp(x, grid, cdf / cdf[-1])).pvalue > 1e-6


@pytest.mark.parametrize("is_exact", [True, False])
@pytest.mark.parametrize(("level", "nearest"), [(10**6, 5.0), (0, 200.0)])
def test_redraw_of_an_amplitude_that_no_range_explains_goes_to_the_nearest(
    level: int, nearest: float, is_exact: bool
) -> None:
    sigmas = np.zeros(100)
    sigmas[12] = 1e-4 if level == 0 else 0.01  # at 200 km: u = 250, far above the threshold
    observation = in_bins(12, level * STEP, sigmas)
    redrawn = redraw(paper_model(is_exact=is_exact), np.ones((50, 4)), observation, rng(1))
    np.testing.assert_allclose(np.hypot(redrawn[:, 0], redrawn[:, 2]), nearest, rtol=0.02)
