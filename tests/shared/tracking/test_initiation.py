import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from shared.scenario.radar_config import AcquisitionSection
from shared.signal.array import angle_bin, spatial_frequency
from shared.tracking.initiation import initial_belief, initiate, redraw_in_bin
from shared.tracking.sensor import Observation, Sensor
from tests.oracles.belief import level_probability

SETTINGS = AcquisitionSection(range_min_km=5.0, range_max_km=200.0, v_max_km_s=0.35, max_scans=5000, confirmations=2)
AMPLITUDE_DB = 60.0
SIGMA = 0.1  # one cell under the orthogonal waveform: sqrt(S/||v||^2) with S = 1, ||v||^2 = 100
THRESHOLD = -2.0 * np.log(1e-4)


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
    sigma_hat = np.full(alpha_hat.size, SIGMA)
    return initial_belief(bin_, n_bin, alpha_hat, sigma_hat, SETTINGS, AMPLITUDE_DB, n, rng(seed))


# ---- track initiation ---------------------------------------------------------------------------------------------

SCANS = st.integers(1, 8).flatmap(
    lambda n_scan: st.lists(
        st.lists(st.tuples(st.booleans(), st.floats(0.0, 50.0)), min_size=5, max_size=5),
        min_size=n_scan,
        max_size=n_scan,
    )
)


def initiate_slowly(
    detected: NDArray[np.bool_], statistic: NDArray[np.float64], n_target: int, confirmations: int
) -> list[int] | None:
    for k in range(1, len(detected) + 1):
        held = [b for b in range(detected.shape[1]) if sum(detected[:k, b]) >= confirmations]
        if len(held) >= n_target:
            strongest = sorted(held, key=lambda b: (-statistic[:k, b].sum(), b))
            return sorted(strongest[:n_target])
    return None


@given(scans=SCANS, n_target=st.integers(1, 4), confirmations=st.integers(1, 3))
def test_initiate_against_a_plain_loop(
    scans: list[list[tuple[bool, float]]], n_target: int, confirmations: int
) -> None:
    detected = np.array([[cell[0] for cell in scan] for scan in scans])
    statistic = np.array([[cell[1] for cell in scan] for scan in scans])
    before = detected.copy(), statistic.copy()
    found = initiate(detected, statistic, n_target, confirmations)
    assert (None if found is None else found.tolist()) == initiate_slowly(detected, statistic, n_target, confirmations)
    np.testing.assert_array_equal(detected, before[0])
    np.testing.assert_array_equal(statistic, before[1])


@given(scans=SCANS, n_target=st.integers(1, 3))
def test_later_scans_do_not_change_the_tracks(scans: list[list[tuple[bool, float]]], n_target: int) -> None:
    detected = np.array([[cell[0] for cell in scan] for scan in scans])
    statistic = np.array([[cell[1] for cell in scan] for scan in scans])
    found = [initiate(detected[:k], statistic[:k], n_target, 2) for k in range(1, len(detected) + 1)]
    first = next((k for k, tracks in enumerate(found) if tracks is not None), len(found))
    assert all(tracks is None for tracks in found[:first])
    for tracks in found[first:]:
        assert tracks is not None
        np.testing.assert_array_equal(tracks, found[first])


def test_a_false_alarm_in_the_last_scan_loses_to_the_targets() -> None:
    detected = np.zeros((3, 10), dtype=bool)
    statistic = np.ones((3, 10))
    detected[:2, 7], statistic[:, 7] = True, 25.0
    detected[2, 4], statistic[:, 4] = True, [10.0, 12.0, 30.0]  # a weak target, on an upward fluctuation
    detected[2, 2], statistic[2, 2] = True, 31.0  # a false alarm: strong once, nothing before
    tracks = initiate(detected, statistic, n_target=2, confirmations=1)
    assert tracks is not None
    assert tracks.tolist() == [4, 7]


def test_no_track_before_all_targets_are_confirmed() -> None:
    detected = np.zeros((4, 10), dtype=bool)
    detected[:, 3], detected[1, 8] = True, True
    assert initiate(detected, np.ones((4, 10)), n_target=2, confirmations=2) is None


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
    with_gap = initial_belief(56, 100, alpha_hat, sigma_hat, SETTINGS, AMPLITUDE_DB, 300, rng(2))
    without = initial_belief(56, 100, alpha_hat[[0, 2]], sigma_hat[[0, 2]], SETTINGS, AMPLITUDE_DB, 300, rng(2))
    np.testing.assert_array_equal(with_gap, without)


def test_no_information_gives_the_prior() -> None:
    particles = initial_belief(56, 100, np.zeros(1, complex), np.zeros(1), SETTINGS, AMPLITUDE_DB, 4000, rng(3))
    drawn = np.hypot(particles[:, 0], particles[:, 2])
    assert stats.kstest(drawn, stats.uniform(5.0, 195.0).cdf).pvalue > 1e-6


def test_complex64_of_a_message_is_accepted() -> None:
    particles = belief(np.array([0.3 + 0.1j, 0.0], dtype=np.complex64), 4)
    assert particles.dtype == np.float64
    assert np.isfinite(particles).all()


# ---- redrawing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("level", "sigma"), [(3, 0.05), (20, 0.01), (1, 0.02), (400, 0.02)])
def test_redraw_follows_the_level_and_keeps_velocities(level: int, sigma: float) -> None:
    particles = np.tile([60.0, 0.2, 7.5, 0.1], (4000, 1)) + rng(5).normal(0.0, 0.1, (4000, 4))
    sigmas = np.zeros(100)
    sigmas[12] = sigma
    redrawn = redraw_in_bin(
        particles, Observation(12, level, sigmas), Sensor(100, AMPLITUDE_DB, THRESHOLD), SETTINGS, rng(6)
    )
    assert (angle_bin(spatial_frequency(redrawn), 100) == 12).all()
    np.testing.assert_array_equal(redrawn[:, 1::2], particles[:, 1::2])
    grid = np.linspace(5.0, 200.0, 100_001)
    p = level_probability(level, THRESHOLD, 1000.0 / grid**2 / sigma)
    cdf = np.concatenate(([0.0], np.cumsum(0.5 * (p[1:] + p[:-1]))))
    drawn = np.hypot(redrawn[:, 0], redrawn[:, 2])
    assert stats.kstest(drawn, lambda x: np.interp(x, grid, cdf / cdf[-1])).pvalue > 1e-6


@pytest.mark.parametrize(("level", "nearest"), [(10**6, 5.0), (0, 200.0)])
def test_redraw_of_a_level_that_no_range_explains_goes_to_the_nearest(level: int, nearest: float) -> None:
    sigmas = np.zeros(100)
    sigmas[12] = 1e-4 if level == 0 else 0.01  # at 200 km: u = 250, far above the threshold
    observation = Observation(12, level, sigmas)
    redrawn = redraw_in_bin(np.ones((50, 4)), observation, Sensor(100, AMPLITUDE_DB, THRESHOLD), SETTINGS, rng(1))
    np.testing.assert_allclose(np.hypot(redrawn[:, 0], redrawn[:, 2]), nearest, rtol=0.02)
