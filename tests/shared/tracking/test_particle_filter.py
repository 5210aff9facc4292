from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from shared.scenario.scenario import AcquisitionSection, BeliefSection
from shared.signal.array import angle_bin, spatial_frequency
from shared.tracking.initiation import initial_belief
from shared.tracking.particle_filter import (
    Motion,
    Observation,
    Sensor,
    Update,
    update,
    update_rejection,
    update_resample,
    weigh,
)
from shared.tracking.sensor import gain_of, table_of
from tests.oracles.belief import GridBelief, likelihood
from tests.oracles.motion import propagate

THRESHOLD = -2.0 * np.log(1e-4)
SENSOR = Sensor(n_bin=100, amplitude_db=60.0, threshold=THRESHOLD)
MOTION = Motion(dt=1.0, sigma_s=0.004)
ACQUISITION = AcquisitionSection(range_min_km=5.0, range_max_km=200.0, v_max_km_s=0.35, max_scans=5000, confirmations=2)
RESAMPLE = BeliefSection(
    n_particle=1000, max_tries=100, update="resample", kernel_bandwidth=0.3, noise_memory="level", reacquire_below=0.0
)
REJECTION = RESAMPLE.model_copy(update={"update": "rejection", "kernel_bandwidth": 0.0})

Rule = Callable[[NDArray[np.float64], Observation, Sensor, Motion, np.random.Generator], Update]
RULES: dict[str, Rule] = {
    "rejection": lambda p, o, s, m, rng: update_rejection(p, o, s, m, 100, rng),
    "resample": lambda p, o, s, m, rng: update_resample(p, o, s, m, 0.0, rng),
    "regularised": lambda p, o, s, m, rng: update_resample(p, o, s, m, 0.3, rng),
}


def rng(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def looked_at(sigma: float, *bins: int, n_bin: int = 100) -> NDArray[np.float64]:
    out = np.zeros(n_bin)
    out[list(bins)] = sigma
    return out


def bins_of(particles: NDArray[np.float64], n_bin: int = 100) -> NDArray[np.int64]:
    return angle_bin(spatial_frequency(particles), n_bin)


def wide_belief(n: int, seed: int) -> NDArray[np.float64]:
    """Around target 2, over some five bins: bin 56 is nu = 0.0657, 60 km * 2 nu = 7.9 km off boresight."""
    particles = rng(seed).normal([60.0, 0.2, 7.5, 0.1], [4.0, 0.3, 1.5, 0.3], (n, 4))
    particles[:, 2] += 0.1 * (particles[:, 0] - 60.0)
    return particles


OBSERVATIONS = {
    "hit": Observation(56, 3, looked_at(0.05, 56)),  # u is 5.5 at 60 km, level 3 is 5.2 .. 6.9
    "miss": Observation(-1, 0, looked_at(0.08, 56)),  # u is 3.5: P_D = 0.8
    "hit among all cells": Observation(55, 2, looked_at(0.07, *range(100))),
    "miss in all cells": Observation(-1, 0, looked_at(0.09, *range(100))),
}


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_weights_against_the_plain_likelihood(name: str) -> None:
    particles, observation = wide_belief(300, 1), OBSERVATIONS[name]
    weights = np.empty(300)
    start, log_p = table_of(observation, SENSOR)
    total, total_sq, uniform = weigh(
        particles, gain_of(observation, SENSOR), observation.hit_bin, start, log_p, weights
    )
    # the table's stated error
    np.testing.assert_allclose(weights, likelihood(particles, observation, SENSOR), rtol=3e-4, atol=1e-12)
    assert total == pytest.approx(weights.sum(), rel=1e-12)
    assert total_sq == pytest.approx((weights**2).sum(), rel=1e-12)
    assert not uniform


def exact_sequence() -> tuple[list[Observation], Sensor, Motion, GridBelief]:
    """Four dwells of a target on boresight: hit, miss, no look, hit. Three bins: it cannot leave the middle one.

    It moves in y as well, by 0.5 km in the end: that adds y^2/(2 x) = 0.002 km to its range, a thousandth of the
    standard deviation of x.
    """
    sensor = Sensor(n_bin=3, amplitude_db=60.0, threshold=THRESHOLD)
    observations = [
        Observation(1, 3, looked_at(0.05, 1, n_bin=3)),
        Observation(-1, 0, looked_at(0.1, 1, n_bin=3)),
        Observation(-1, 0, looked_at(0.1, 0, n_bin=3)),
        Observation(1, 2, looked_at(0.06, 1, n_bin=3)),
    ]
    x, vx = np.linspace(42.0, 78.0, 721), np.linspace(-2.0, 2.0, 41)
    p = np.exp(-0.5 * ((x[:, None] - 60.0) / 2.0) ** 2 - 0.5 * ((vx - 0.2) / 0.3) ** 2)
    grid = GridBelief(x, vx, p / p.sum())
    for observation in observations:
        grid = grid.predicted(sigma_s=0.1).conditioned(observation, sensor)
    return observations, sensor, Motion(dt=1.0, sigma_s=0.1), grid


@pytest.mark.parametrize("rule", RULES)
def test_against_the_exact_belief_on_a_grid(rule: str) -> None:
    observations, sensor, motion, grid = exact_sequence()
    x, vx = grid.x[:, None], grid.vx
    m = np.array([grid.mean(x), grid.mean(vx)])
    exact = [*m, grid.mean((x - m[0]) ** 2), grid.mean((vx - m[1]) ** 2), grid.mean((x - m[0]) * (vx - m[1]))]
    runs = []
    for run in range(40):
        generator = rng(1, run)
        particles = generator.normal([60.0, 0.2, 0.0, 0.0], [2.0, 0.3, 0.0, 0.0], (4000, 4))
        for observation in observations:
            particles, depleted, _ = RULES[rule](particles, observation, sensor, motion, generator)
            assert not depleted
        d = particles[:, :2] - m
        runs.append([*particles[:, :2].mean(axis=0), *(d**2).mean(axis=0), (d[:, 0] * d[:, 1]).mean()])
    # The mean of 40 independent runs against the exact value, in standard errors: Student's t, 39 degrees, 1e-6 level
    z = (np.mean(runs, axis=0) - exact) / (np.std(runs, axis=0, ddof=1) / np.sqrt(40))
    assert np.abs(z).max() < stats.t.isf(0.5e-6, 39)


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_both_updates_have_the_same_posterior(name: str) -> None:
    particles, observation = wide_belief(3000, 2), OBSERVATIONS[name]

    def features(rule: str, run: int) -> NDArray[np.float64]:
        s, depleted, _ = RULES[rule](particles, observation, SENSOR, MOTION, rng(3, run, len(rule)))
        assert not depleted
        d = s - [60.0, 0.2, 7.5, 0.1]
        share = [np.mean(bins_of(s) == b) for b in (54, 55, 56, 57)]
        return np.concatenate((d.mean(axis=0), (d.T @ d / len(s))[np.triu_indices(4)], share))

    a, b = (np.array([features(rule, run) for run in range(40)]) for rule in ("rejection", "resample"))
    varies = (a.std(axis=0) > 0.0) | (b.std(axis=0) > 0.0)
    np.testing.assert_array_equal(a[:, ~varies], b[:, ~varies])
    # two-sample t test of each feature at the 1e-6 level
    assert stats.ttest_ind(a[:, varies], b[:, varies], equal_var=False).pvalue.min() > 1e-6


@pytest.mark.parametrize("settings_", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
def test_the_filter_is_calibrated(settings_: BeliefSection) -> None:
    """Simulation-based calibration (Talts et al. 2018): a truth drawn from the first belief ranks uniformly later on.

    Five dwells, each a look at the bin with most particles.
    """
    sigma, ranks = 0.05, []
    for run in range(200):
        generator, particle_rng = rng(4, run), rng(5, run)
        alpha_hat = np.full(3, 0.25 + 0j)
        args = (56, 100, alpha_hat, np.full(3, 0.1), ACQUISITION, 60.0)
        truth = initial_belief(*args, 1, generator)
        particles = initial_belief(*args, 600, particle_rng)
        for _ in range(5):
            truth = propagate(truth, MOTION, generator)
            bin_ = int(np.bincount(bins_of(particles)).argmax())
            u = 1000.0 / np.hypot(truth[0, 0], truth[0, 2]) ** 2 / sigma * (bins_of(truth)[0] == bin_)
            r = np.abs(u + np.sqrt(0.5) * (generator.standard_normal() + 1j * generator.standard_normal()))
            seen = 2.0 * r * r >= THRESHOLD
            observation = Observation(bin_ if seen else -1, int(r / np.sqrt(3.0)) * seen, looked_at(sigma, bin_))
            particles, *_ = update(particles, observation, SENSOR, MOTION, settings_, ACQUISITION, particle_rng)
        below, at = (particles < truth).mean(axis=0), (particles == truth).mean(axis=0)
        ranks.append(below + at * generator.random(4))
    for component in np.array(ranks).T:
        assert stats.kstest(component, "uniform").pvalue > 1e-4


def test_nothing_looked_at_is_propagation() -> None:
    particles = wide_belief(500, 3)
    result = update_resample(particles, Observation(-1, 0, np.zeros(100)), SENSOR, MOTION, 0.3, rng(1))
    np.testing.assert_array_equal(result.particles, propagate(particles, MOTION, rng(1)))


def test_the_prior_belief_is_left_alone() -> None:
    particles = wide_belief(500, 3)
    before = particles.copy()
    for settings_ in (RESAMPLE, REJECTION):
        for observation in (*OBSERVATIONS.values(), Observation(3, 5, looked_at(0.1, 3))):
            update(particles, observation, SENSOR, MOTION, settings_, ACQUISITION, rng(1))
    np.testing.assert_array_equal(particles, before)


def test_same_generator_same_belief() -> None:
    for settings_ in (RESAMPLE, REJECTION):
        for observation in OBSERVATIONS.values():
            a, b = (
                update(wide_belief(500, 3), observation, SENSOR, MOTION, settings_, ACQUISITION, rng(8)) for _ in "ab"
            )
            np.testing.assert_array_equal(a.particles, b.particles)


def test_after_a_hit_all_particles_are_in_its_bin() -> None:
    for rule in RULES.values():
        result = rule(wide_belief(2000, 4), OBSERVATIONS["hit"], SENSOR, MOTION, rng(1))
        assert (bins_of(result.particles) == 56).all()


def test_rejection_fills_up_with_what_it_has_kept() -> None:
    particles = wide_belief(1000, 5)
    # level 4 at sigma 0.05 is |alpha| = 0.35 .. 0.43, 48 .. 54 km: in the tail of 60 +- 4 km, one bin of five
    observation = Observation(56, 4, looked_at(0.05, 56))
    result = update_rejection(particles, observation, SENSOR, MOTION, 1, rng(1))
    assert not result.depleted
    kept, copies = np.unique(result.particles, axis=0, return_counts=True)
    assert 0 < len(kept) < 1000
    assert copies.max() - copies.min() <= 1


BELIEFS: dict[str, NDArray[np.float64]] = {
    "wide": wide_belief(60, 6),
    "copies": np.tile([60.0, 0.2, 7.5, 0.1], (60, 1)),
    "clipped": rng(7).normal([0.0, -0.2, 60.0, 0.1], [0.0, 0.1, 2.0, 0.05], (60, 4)),
    "at the radar": np.zeros((60, 4)),
    "far": rng(8).normal([1e6, 0.2, 1e5, 0.1], [1e3, 0.1, 1e3, 0.1], (60, 4)),
}


@settings(deadline=None, max_examples=300)
@given(
    name=st.sampled_from(sorted(BELIEFS)),
    hit_bin=st.integers(-1, 99),
    level=st.one_of(st.integers(0, 30), st.integers(0, 10**6)),
    sigma=st.one_of(st.floats(1e-3, 1.0), st.floats(1e-9, 1e6)),
    everywhere=st.booleans(),
    bandwidth=st.sampled_from([0.0, 0.3, 1.0]),
    kind=st.sampled_from(["resample", "rejection"]),
    seed=st.integers(0, 2**32),
)
def test_any_observation_gives_a_belief(
    name: str, hit_bin: int, level: int, sigma: float, everywhere: bool, bandwidth: float, kind: str, seed: int
) -> None:
    sigmas = np.full(100, sigma) if everywhere else looked_at(sigma, max(hit_bin, 56))
    if hit_bin >= 0:
        sigmas[hit_bin] = sigma
    chosen = RESAMPLE.model_copy(update={"kernel_bandwidth": bandwidth, "update": kind, "max_tries": 5})
    observation = Observation(hit_bin, level if hit_bin >= 0 else 0, sigmas)
    result = update(BELIEFS[name], observation, SENSOR, Motion(1.0, 0.004), chosen, ACQUISITION, rng(seed))
    assert result.particles.shape == (60, 4)
    assert np.isfinite(result.particles).all()
    assert (result.particles[:, 0] >= 0.0).all()
    if hit_bin >= 0:
        assert (bins_of(result.particles) == hit_bin).all()


@pytest.mark.parametrize("settings_", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
def test_a_hit_that_nobody_explains_moves_the_belief_there(settings_: BeliefSection) -> None:
    particles = wide_belief(1000, 7)
    observation = Observation(20, 9, looked_at(0.02, 20))  # |alpha| = 0.31 .. 0.35: 54 .. 57 km
    result = update(particles, observation, SENSOR, Motion(1.0, 0.0), settings_, ACQUISITION, rng(1))
    assert result.depleted
    assert (bins_of(result.particles) == 20).all()
    np.testing.assert_array_equal(result.particles[:, 1::2], particles[:, 1::2])
    # four noise deviations beyond the level's edges: u = 15.6 .. 17.3, +- 2.8
    u = 1000.0 / (result.particles[:, 0] ** 2 + result.particles[:, 2] ** 2) / 0.02
    assert ((u > 12.5) & (u < 20.5)).all()


@pytest.mark.parametrize("settings_", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
@pytest.mark.parametrize("collapsed", [False, True])
def test_a_miss_that_nobody_explains_widens_the_belief(settings_: BeliefSection, collapsed: bool) -> None:
    spread = 0.0 if collapsed else 0.05
    particles = rng(1).normal([60.0, 0.2, 7.9, 0.1], [spread, 0.0, spread, 0.0], (1000, 4))
    observation = Observation(-1, 0, looked_at(0.01, *np.unique(bins_of(particles))))  # u = 27: P_D = 1
    result = update(particles, observation, SENSOR, MOTION, settings_, ACQUISITION, rng(2))
    assert result.depleted
    assert (likelihood(result.particles, observation, SENSOR) > 1e-3).mean() > 0.5
    # the next bins are 1.2 km off: the belief is out there, but not everywhere
    assert 0.5 < np.std(result.particles[:, 2]) < 10.0


def test_a_miss_in_every_cell_still_returns() -> None:
    observation = Observation(-1, 0, np.full(100, 1e-6))
    for settings_ in (RESAMPLE, REJECTION):
        result = update(wide_belief(200, 8), observation, SENSOR, MOTION, settings_, ACQUISITION, rng(1))
        assert result.depleted
        assert np.isfinite(result.particles).all()


def test_both_updates_give_up_on_the_same_evidence() -> None:
    """Depletion is fewer than one particle expected in n max_tries draws of the rejection sampler."""
    n, max_tries = 100, 20
    particles = np.tile([60.0, 0.0, 7.9, 0.0], (n, 1))
    # u = 1000/(60^2 + 7.9^2)/0.02 = 13.65. n max_tries Z: level 8 (13.9 .. 15.6) 700, 9 (15.6 .. 17.3) 6, 10 2e-4;
    # at level 9 rejection keeps none with probability exp(-6)
    for level, expected in ((8, False), (9, False), (10, True)):
        observation = Observation(56, level, looked_at(0.02, 56))
        evidence = likelihood(particles[:1], observation, SENSOR)[0]
        assert (n * max_tries * evidence < 1.0) == expected
        resampled = update_resample(particles, observation, SENSOR, Motion(1.0, 0.0), 0.0, rng(1), max_tries)
        assert resampled.depleted == expected
        rejected = update_rejection(particles, observation, SENSOR, Motion(1.0, 0.0), max_tries, rng(1))
        assert rejected.depleted == expected


def test_a_kernel_needs_five_particles() -> None:
    """Fewer than d + 1 have a covariance without volume; the plain filter goes on with what it has."""
    particles = np.tile([60.0, 0.2, -20.0, 0.1], (1000, 1))
    for several, depleted in ((4, True), (6, False)):
        particles[:several, 2] = 7.9
        observation = Observation(56, 3, looked_at(0.05, 56))
        assert update_resample(particles, observation, SENSOR, MOTION, 0.3, rng(1)).depleted == depleted
        assert not update_resample(particles, observation, SENSOR, MOTION, 0.0, rng(1)).depleted
