"""What the radar assumes of the RCS: laws against integrals and simulation, and what a track learns of its echoes."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import binom, kstest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.signal.echo_laws import LAWS, echo_after_hit, echo_after_miss, first_echo
from cogradar.shared.signal.receiver import detection_probability
from cogradar.shared.tracking.belief.likelihood import likelihood_of
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.initiation import initial_belief
from cogradar.shared.tracking.sensor import (
    STEP,
    Sensor,
    hit_table,
    interpolate,
    log_hit_probability,
    log_level_probability,
    log_miss_probability,
    miss_table,
)
from cogradar.shared.tracking.track import start
from tests.shared.tracking.models import in_bins, smoke_model
from tests.shared.tracking.scans import ACQUISITION, ALPHA, BIN, TARGET

Floats = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], Floats]

THRESHOLD = -2.0 * np.log(1e-4)
EDGE = float(np.sqrt(0.5 * THRESHOLD))
FACTORS: dict[str, Draw] = {
    "constant": lambda _, n: np.ones(n),
    "swerling1": lambda rng, n: rng.standard_exponential(n),
    "swerling3": lambda rng, n: 0.5 * rng.standard_gamma(2.0, n),
}
WORLD = {"known": "constant", "mean": "swerling1", "unknown": "swerling1"}  # in which each law is exact


def amplitudes(rcs: str, u: float, n: int, rng: np.random.Generator) -> Floats:
    """r of n looks at a target of a world."""
    noise = np.sqrt(0.5) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    return np.asarray(np.abs(u * np.sqrt(FACTORS[rcs](rng, n)) + noise))


def in_5_sigma(count: int, n: int, p: float) -> bool:
    low, high = binom.interval(1.0 - 5.7e-7, n, p)
    return bool(low <= count <= high)


@pytest.mark.parametrize("rcs", LAWS)
@pytest.mark.parametrize("u", [0.0, 0.7, 3.0, 12.0])
def test_bands_are_integrals_of_the_density_and_exhaust_what_can_happen(rcs: str, u: float) -> None:
    law, at = LAWS[rcs], np.array(u)

    def density(r: float) -> float:
        return float(2.0 * r * np.exp(law.log_likelihood(np.array(r), at))) if r > 0.0 else 0.0

    reach = 6.0 * np.sqrt(1.0 + u * u) if law.fluctuates else u + 8.0
    edges = [0.0, EDGE, *(STEP * np.arange(2.0, np.ceil(reach / STEP) + 1.0))]
    bands = [float(np.exp(law.log_band(low, high, at))) for low, high in itertools.pairwise(edges)]
    for (low, high), band in zip(itertools.pairwise(edges), bands, strict=True):
        assert band == pytest.approx(quad(density, low, high, epsabs=1e-13, epsrel=1e-12)[0], rel=1e-8, abs=1e-12)
    assert sum(bands) == pytest.approx(1.0, abs=1e-9)
    p_d = float(detection_probability(2.0 * u * u, THRESHOLD, WORLD[rcs]))
    assert np.exp(log_miss_probability(THRESHOLD, u, rcs)) == pytest.approx(1.0 - p_d, abs=1e-9)


@pytest.mark.parametrize("rcs", ["known", "mean"])
@pytest.mark.parametrize("u", [0.0, 2.0, 5.0])
def test_frequencies_of_levels_are_as_the_law_says(rcs: str, u: float) -> None:
    r, n = amplitudes(WORLD[rcs], u, 40_000, np.random.default_rng(1)), 40_000
    assert in_5_sigma(int((r < EDGE).sum()), n, float(np.exp(log_miss_probability(THRESHOLD, u, rcs))))
    for level in range(1, 9):
        found = int(((r >= max(EDGE, level * STEP)) & (r < (level + 1) * STEP)).sum())
        assert in_5_sigma(found, n, float(np.exp(log_level_probability(level, THRESHOLD, u, rcs))))


@pytest.mark.parametrize("is_exact", [True, False])
@pytest.mark.parametrize("r", [0.0, 3.5, 20.0, 900.0])  # 0: a miss
def test_a_table_over_the_logarithm_interpolates_within_its_stated_error(is_exact: bool, r: float) -> None:
    sensor = Sensor(5, 60.0, THRESHOLD, is_exact, "mean")
    start, log_p = hit_table(sensor, r) if r else miss_table(sensor)
    u = np.exp(np.random.default_rng(1).uniform(-3.0, 20.0, 400))
    exact = log_hit_probability(sensor, r, u) if r else log_miss_probability(THRESHOLD, u, "mean")
    for less, atol in ((10.0, 7e-3), (1.0, 1.5e-3)):  # 4 r^2/u^2 / (8 * 32^2), r^2/u^2 < 14 and < 3.2
        probable = exact > exact.max() - less
        ours = np.log([interpolate(value, start, log_p, True) for value in u[probable]])
        np.testing.assert_allclose(ours, exact[probable], atol=atol)
    for beyond, end in ((0.0, 0), (1e-9, 0), (1e30, -1), (np.inf, -1)):
        assert interpolate(beyond, start, log_p, True) == pytest.approx(np.exp(log_p[end]), rel=1e-9)


def test_weights_against_the_formula() -> None:
    """Three bins, hits and misses at 20 to 150 km; of an unknown RCS no weight depends on the range."""
    rng = np.random.default_rng(2)
    theta, range_km = rng.uniform(-1.2, 1.2, 300), rng.uniform(20.0, 150.0, 300)
    zero = np.zeros(300)
    particles = np.column_stack((range_km * np.cos(theta), zero, range_km * np.sin(theta), zero))
    bins = np.clip(np.round(0.5 * np.sin(theta) * 2.0 + 1.0), 0, 2).astype(int)
    sigma = np.array([0.05, 0.1, 0.0])
    for is_exact in (True, False):
        mean = Sensor(3, 60.0, THRESHOLD, is_exact, "mean")
        u = 1000.0 / range_km**2 / np.where(sigma > 0.0, sigma, 1.0)[bins]
        missed = np.where(sigma[bins] > 0.0, 1.0 - 1e-4 ** (1.0 / (1.0 + u * u)), 1.0)
        weights = weigh(particles, likelihood_of(mean, in_bins(-1, 0.0, sigma))).weights
        np.testing.assert_allclose(weights, missed, rtol=1e-3)
        hit = in_bins(1, 4.0, sigma)
        low, high, m = 2 * STEP, 3 * STEP, 1.0 + u * u
        exact, band = STEP * 8.0 / m * np.exp(-16.0 / m), np.exp(-(low**2) / m) - np.exp(-(high**2) / m)
        weights = weigh(particles, likelihood_of(mean, hit)).weights
        np.testing.assert_allclose(weights, np.where(bins == 1, exact if is_exact else band, 0.0), rtol=1e-2, atol=1e-9)

        unknown = Sensor(3, 60.0, THRESHOLD, is_exact, "unknown", 0.09)
        p_d = 1e-4 ** (1.0 / (1.0 + np.array([36.0, 9.0])))  # E / sigma^2
        weights = weigh(particles, likelihood_of(unknown, hit)).weights
        np.testing.assert_allclose(weights, np.where(bins == 1, p_d[1], 0.0), rtol=1e-3)
        by_bin = np.append(1.0 - p_d, 1.0)
        weights = weigh(particles, likelihood_of(unknown, in_bins(-1, 0.0, sigma))).weights
        np.testing.assert_allclose(weights, by_bin[bins], rtol=1e-3)


@pytest.mark.parametrize("rcs", ["mean", "unknown"])
def test_ranges_of_the_acquisition_follow_the_posterior_of_the_law(rcs: str) -> None:
    model = smoke_model("robust", n_particle=4000)
    model = replace(model, sensor=model.sensor._replace(rcs=rcs))
    alpha_hat, sigma = np.array([0.9, 1.7, 0.2]), np.array([0.25, 0.3, 0.2])
    belief = initial_belief(model, BIN, alpha_hat, sigma, np.random.default_rng(3))
    grid = np.linspace(5.0, 200.0, 20_001)
    m = 1.0 + (model.sensor._replace(rcs="known").amplitude / grid**2 / sigma[:, np.newaxis]) ** 2
    log_p = (-np.log(m) - (alpha_hat / sigma)[:, np.newaxis] ** 2 / m).sum(axis=0)
    density = np.exp(log_p - log_p.max()) if rcs == "mean" else np.ones(grid.size)
    cdf = np.cumsum(density) / density.sum()
    ranges = np.hypot(belief[:, 0], belief[:, 2])
    assert kstest(ranges, lambda x: np.interp(x, grid, cdf)).pvalue > 1e-6


def learned(rcs: str, u: float, looks: int, rng: np.random.Generator, start: float) -> Floats:
    """E / sigma^2 of a track that looks into its target's cell, dwell after dwell."""
    echo, found = start, np.empty(looks)
    for k, r in enumerate(amplitudes(rcs, u, looks, rng).tolist()):
        missed = echo_after_miss(echo, THRESHOLD, np.ones(1), np.ones(1))
        echo = echo_after_hit(echo, r, 1.0) if r >= EDGE else missed
        found[k] = echo
    return found


@pytest.mark.parametrize("rcs", FACTORS)
@pytest.mark.parametrize("u", [2.0, 4.0, 12.0])  # P_D .16, .58, .94 (Swerling I)
@pytest.mark.parametrize("error_db", [-5.0, 5.0])
def test_what_is_learned_of_an_echo_is_neither_where_it_began_nor_that_of_detections(
    rcs: str, u: float, error_db: float
) -> None:
    """Unbiased for Swerling I; else within 2 dB, where detections alone are up to 5 dB too strong."""
    rng = np.random.default_rng(4)
    found = learned(rcs, u, 4000, rng, u * u * 10.0 ** (error_db / 10.0))[200:]
    bias_db = 10.0 * np.log10(found.mean() / u**2)
    assert abs(bias_db) < (0.5 if rcs == "swerling1" else 2.0)
    assert 10.0 * np.std(np.log10(found)) < 1.5
    r = amplitudes(rcs, u, 4000, rng)
    if u == 2.0:
        assert 10.0 * np.log10((np.mean(r[r >= EDGE] ** 2) - 1.0) / u**2) > 4.0


def test_one_echo_of_another_target_is_not_believed() -> None:
    assert echo_after_hit(10.0, 1e6, 1.0) < 1.5 * 10.0


def test_a_cell_that_hardly_holds_the_target_tells_nothing_of_its_echo() -> None:
    whole = echo_after_miss(9.0, THRESHOLD, np.ones(1), np.ones(1))
    assert whole < 9.0
    assert echo_after_miss(9.0, THRESHOLD, np.ones(2), np.array([0.5, 0.0])) == pytest.approx(9.0 - 0.5 * (9.0 - whole))


def test_all_scans_of_the_acquisition_count() -> None:
    """Stopped at the second detection, a weak target's detections are 6 dB too strong, all of its scans 3."""
    u, first = 2.0, []
    for run in range(300):
        r = amplitudes("swerling1", u, 400, generator(1, Purpose.RCS, 0, run))
        r = r[: np.flatnonzero(r >= EDGE)[1] + 1]
        first.append(first_echo(r.astype(complex), np.ones(r.size), np.full(r.size, True), 1e-3))
    assert 10.0 * np.log10(np.median(first) / u**2) < 3.0
    own = np.full(3, True)
    assert first_echo(np.zeros(3, complex), np.ones(3), own, 0.01) == 0.01
    assert first_echo(np.array([2.0, 50.0j, 2.0]), np.array([1.0, 0.0, 1.0]), own, 0.01) == pytest.approx(3.0)


def test_where_noise_is_stronger_than_the_target_it_was_at_most_as_strong() -> None:
    """Of a bin's range cells the largest is told: the target's own, or that of the noise in 400 others."""
    rng, u, first = np.random.default_rng(5), 3.0, []
    for _ in range(100):
        r, noise = amplitudes("swerling1", u, 200, rng), np.sqrt(rng.standard_exponential((200, 400)).max(axis=1))
        first.append(first_echo(np.maximum(r, noise).astype(complex), np.ones(200), r > noise, 1e-3))
        assert first_echo(np.maximum(r, noise).astype(complex), np.ones(200), np.full(200, True), 1e-3) > u * u
    assert np.mean(first) == pytest.approx(u * u, rel=0.05)


def test_a_track_without_an_rcs_begins_with_its_echoes() -> None:
    model = smoke_model("robust")
    unknown = replace(model, sensor=model.sensor._replace(rcs="unknown"))
    assert start(model, TARGET, BIN, ACQUISITION).echo == 0.0
    assert start(unknown, TARGET, BIN, ACQUISITION).echo == pytest.approx(ALPHA**2 - 0.25**2, rel=1e-6)
