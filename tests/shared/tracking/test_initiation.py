from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.response import BinResponse
from cogradar.shared.tracking.acquisition import Candidates
from cogradar.shared.tracking.initiation import initial_belief, redraw
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import STEP
from tests.oracles.belief import hit_probability
from tests.shared.tracking.models import in_bins, in_level, paper_model
from tests.shared.tracking.scans import bins_scan

MODEL = paper_model()  # ranges 5 .. 200 km, velocities within 0.35 km/s
SIGMA = 0.1  # one cell under the orthogonal waveform: sqrt(S/||v||^2) with S = 1, ||v||^2 = 100
THRESHOLD = MODEL.sensor.threshold


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


# ---- track initiation ---------------------------------------------------------------------------------------------

SCANS = st.integers(1, 8).flatmap(
    lambda n_scan: st.lists(
        st.lists(st.floats(0.0, 50.0), min_size=5, max_size=5), min_size=n_scan, max_size=n_scan
    ).map(np.array)
)


def initiated(statistic: NDArray[np.float64], n_track: int, confirmations: int) -> list[int] | None:
    """From scans with these statistics, (n_scan, n_bin); one is a detection from 18.4 on."""
    acquisition = MODEL.acquisition.model_copy(update={"confirmations": confirmations})
    n, unread = statistic.shape[1], np.zeros(statistic.shape[1])
    bins, alpha_hat, beams = (
        np.arange(n, dtype=np.int32),
        unread.astype(np.complex64),
        np.full((n_track, 1), -1, np.int32),
    )
    model = replace(of(MODEL.belief.n_particle, n), n_track=n_track, acquisition=acquisition)
    candidates = Candidates(model)
    for k, row in enumerate(statistic):
        columns = {"bins": bins, "statistic": row, "alpha_hat": alpha_hat, "sigma_hat": unread}
        candidates.add(bins_scan(n, k=k, **columns, signature_power=unread, beams=beams))
        if (found := candidates.bins()) is not None:
            return [int(bin_) for bin_ in found]
    return None


def initiated_slowly(statistic: NDArray[np.float64], n_track: int, confirmations: int) -> list[int] | None:
    for k in range(1, len(statistic) + 1):
        detections = (statistic[:k] >= THRESHOLD).sum(axis=0)
        in_sum = stats.chi2.sf(statistic[:k].sum(axis=0), 2 * k) <= 1e-4
        confirmed = [b for b, count in enumerate(detections) if count >= confirmations and in_sum[b]]
        if len(confirmed) >= n_track:
            strongest = sorted(confirmed, key=lambda b: (-statistic[:k, b].sum(), b))
            return sorted(strongest[:n_track])
    return None


@given(statistic=SCANS, n_track=st.integers(1, 4), confirmations=st.integers(1, 3))
def test_initiate_against_a_plain_loop(statistic: NDArray[np.float64], n_track: int, confirmations: int) -> None:
    before = statistic.copy()
    assert initiated(statistic, n_track, confirmations) == initiated_slowly(statistic, n_track, confirmations)
    np.testing.assert_array_equal(statistic, before)


@given(statistic=SCANS, n_track=st.integers(1, 3))
def test_later_scans_do_not_change_the_tracks(statistic: NDArray[np.float64], n_track: int) -> None:
    found = [initiated(statistic[:k], n_track, 2) for k in range(1, len(statistic) + 1)]
    first = next((k for k, tracks in enumerate(found) if tracks is not None), len(found))
    assert all(tracks is None for tracks in found[:first])
    assert all(tracks == found[first] for tracks in found[first:])


def test_a_false_alarm_in_the_last_scan_loses_to_the_targets() -> None:
    statistic = np.ones((3, 10))
    statistic[:, 7] = 25.0
    statistic[:, 4] = [10.0, 12.0, 30.0]  # a weak target, on an upward fluctuation
    statistic[2, 2] = 31.0  # a false alarm: strong once, nothing before
    assert initiated(statistic, n_track=2, confirmations=1) == [4, 7]


def test_no_track_before_all_targets_are_confirmed() -> None:
    statistic = np.ones((4, 10))
    statistic[:, 3], statistic[1, 8] = 20.0, 20.0
    assert initiated(statistic, n_track=2, confirmations=2) is None


def test_two_false_alarms_in_a_hundred_scans_are_no_target() -> None:
    statistic = stats.chi2(2).rvs((100, 10), random_state=rng(9))
    statistic = np.minimum(statistic, THRESHOLD - 1.0)
    statistic[:, 6] = 20.0
    statistic[[30, 60], 2] = 20.0  # false alarms, in a cell with nothing else
    assert initiated(statistic, n_track=2, confirmations=2) is None
    statistic[:, 4] += 5.0  # a weak target, detected as often but stronger in all scans
    statistic[[40, 90], 4] = 20.0
    assert initiated(statistic, n_track=2, confirmations=2) == [4, 6]


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
        over = 2.0 * np.abs(alpha_hat) ** 2 / SIGMA**2 >= THRESHOLD
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
