from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.response import BinResponse
from cogradar.shared.tracking.belief.likelihood import Looks, likelihood_of
from cogradar.shared.tracking.belief.particle_filter import Update, condition, predict, reject, update
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.initiation import initial_belief
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import MAX_AMPLITUDE, Sensor
from tests.oracles.belief import GridBelief, likelihood
from tests.shared.tracking.models import in_bins, in_level, paper_model

RESAMPLE = paper_model(n_particle=1000, reacquire_below=0.0)
LEVELS = paper_model(n_particle=1000, reacquire_below=0.0, is_exact=False)
REJECTION = paper_model(n_particle=1000, filter="published", kernel_bandwidth=0.0)
SENSOR, MOTION, THRESHOLD = RESAMPLE.sensor, RESAMPLE.motion, RESAMPLE.sensor.threshold
STILL = Motion(1.0, 0.0)

Rule = Callable[[TrackerModel, NDArray[np.float64], Looks, np.random.Generator], Update]


def resampled(bandwidth: float) -> Rule:
    """The update by resampling, without a recovery."""

    def rule(
        model: TrackerModel, particles: NDArray[np.float64], observation: Looks, rng: np.random.Generator
    ) -> Update:
        model = replace(model, belief=model.belief.model_copy(update={"kernel_bandwidth": bandwidth}))
        return condition(model, predict(model.motion, particles, rng), observation, rng)

    return rule


RULES: dict[str, Rule] = {"rejection": reject, "resample": resampled(0.0), "regularised": resampled(0.3)}


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
    "hit": in_bins(56, in_level(3), looked_at(0.05, 56)),  # u is 5.5 at 60 km, level 3 is 5.2 .. 6.9
    "miss": in_bins(-1, 0, looked_at(0.08, 56)),  # u is 3.5: P_D = 0.8
    "hit among all cells": in_bins(55, in_level(2), looked_at(0.07, *range(100))),
    "miss in all cells": in_bins(-1, 0, looked_at(0.09, *range(100))),
}


@pytest.mark.parametrize("sensor", [SENSOR, LEVELS.sensor], ids=["exact", "levels"])
@pytest.mark.parametrize("name", OBSERVATIONS)
def test_weights_against_the_plain_likelihood(name: str, sensor: Sensor) -> None:
    particles, observation = wide_belief(300, 1), OBSERVATIONS[name]
    states, weights, total, total_sq, uniform = weigh(particles, likelihood_of(sensor, observation))
    assert states is particles
    # the table's stated error
    np.testing.assert_allclose(weights, likelihood(particles, observation, sensor), rtol=3e-4, atol=1e-12)
    assert total == pytest.approx(weights.sum(), rel=1e-12)
    assert total_sq == pytest.approx((weights**2).sum(), rel=1e-12)
    assert not uniform


def exact_sequence(is_exact: bool) -> tuple[list[Looks], TrackerModel, GridBelief]:
    """Four dwells of a target on boresight: hit, miss, no look, hit. Three bins: it cannot leave the middle one.

    It moves in y as well, by 0.5 km in the end: that adds y^2/(2 x) = 0.002 km to its range, a thousandth of the
    standard deviation of x.
    """
    sensor = Sensor(n_bin=3, amplitude_db=60.0, threshold=THRESHOLD, is_exact=is_exact)
    observations = [
        in_bins(1, in_level(3), looked_at(0.05, 1, n_bin=3)),
        in_bins(-1, 0, looked_at(0.1, 1, n_bin=3)),
        in_bins(-1, 0, looked_at(0.1, 0, n_bin=3)),
        in_bins(1, in_level(2), looked_at(0.06, 1, n_bin=3)),
    ]
    x, vx = np.linspace(42.0, 78.0, 721), np.linspace(-2.0, 2.0, 41)
    p = np.exp(-0.5 * ((x[:, None] - 60.0) / 2.0) ** 2 - 0.5 * ((vx - 0.2) / 0.3) ** 2)
    grid = GridBelief(x, vx, p / p.sum())
    for observation in observations:
        grid = grid.predicted(sigma_s=0.1).conditioned(observation, sensor)
    return (
        observations,
        replace(RESAMPLE, sensor=sensor, response=BinResponse(3), motion=Motion(dt=1.0, sigma_s=0.1)),
        grid,
    )


@pytest.mark.parametrize("rule", RULES)
def test_against_the_exact_belief_on_a_grid(rule: str) -> None:
    observations, model, grid = exact_sequence(is_exact=rule != "rejection")
    x, vx = grid.x[:, None], grid.vx
    m = np.array([grid.mean(x), grid.mean(vx)])
    exact = [*m, grid.mean((x - m[0]) ** 2), grid.mean((vx - m[1]) ** 2), grid.mean((x - m[0]) * (vx - m[1]))]
    runs = []
    for run in range(40):
        generator = rng(1, run)
        particles = generator.normal([60.0, 0.2, 0.0, 0.0], [2.0, 0.3, 0.0, 0.0], (4000, 4))
        for observation in observations:
            particles, depleted, *_ = RULES[rule](model, particles, observation, generator)
            assert not depleted
        d = particles[:, :2] - m
        runs.append([*particles[:, :2].mean(axis=0), *(d**2).mean(axis=0), (d[:, 0] * d[:, 1]).mean()])
    # The mean of 40 independent runs against the exact value, in standard errors: Student's t, 39 degrees, 1e-6 level
    z = (np.mean(runs, axis=0) - exact) / (np.std(runs, axis=0, ddof=1) / np.sqrt(40))
    assert np.abs(z).max() < stats.t.isf(0.5e-6, 39)


def by_law(model: TrackerModel, rcs: str) -> TrackerModel:
    return replace(model, sensor=model.sensor._replace(rcs=rcs, echo=0.07))


BOTH = {
    "hit by its level": ("hit", LEVELS),
    **{name: (name, RESAMPLE) for name in OBSERVATIONS},
    "mean RCS, hit": ("hit", by_law(RESAMPLE, "mean")),
    "mean RCS, hit by its level": ("hit", by_law(LEVELS, "mean")),
    "mean RCS, miss": ("miss", by_law(RESAMPLE, "mean")),
    "unknown RCS, miss": ("miss", by_law(RESAMPLE, "unknown")),
}


@pytest.mark.parametrize(("name", "model"), BOTH.values(), ids=BOTH)
def test_both_updates_have_the_same_posterior(name: str, model: TrackerModel) -> None:
    particles, observation = wide_belief(3000, 2), OBSERVATIONS[name]

    def features(rule: str, run: int) -> NDArray[np.float64]:
        s, depleted, *_ = RULES[rule](model, particles, observation, rng(3, run, len(rule)))
        assert not depleted
        d = s - [60.0, 0.2, 7.5, 0.1]
        share = [np.mean(bins_of(s) == b) for b in (54, 55, 56, 57)]
        return np.concatenate((d.mean(axis=0), (d.T @ d / len(s))[np.triu_indices(4)], share))

    a, b = (np.array([features(rule, run) for run in range(40)]) for rule in ("rejection", "resample"))
    varies = (a.std(axis=0) > 0.0) | (b.std(axis=0) > 0.0)
    np.testing.assert_array_equal(a[:, ~varies], b[:, ~varies])
    # two-sample t test of each feature at the 1e-6 level
    assert stats.ttest_ind(a[:, varies], b[:, varies], equal_var=False).pvalue.min() > 1e-6


@pytest.mark.parametrize("model", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
def test_the_filter_is_calibrated(model: TrackerModel) -> None:
    """Simulation-based calibration (Talts et al. 2018): a truth drawn from the first belief ranks uniformly later on.

    Five dwells, each a look at the bin with most particles.
    """
    sigma, ranks = 0.05, []
    for run in range(200):
        generator, particle_rng = rng(4, run), rng(5, run)
        alpha_hat = np.full(3, 0.25 + 0j)
        of_truth, of_belief = (
            replace(model, belief=model.belief.model_copy(update={"n_particle": n})) for n in (1, 600)
        )
        truth = initial_belief(of_truth, 56, alpha_hat, np.full(3, 0.1), generator)
        particles = initial_belief(of_belief, 56, alpha_hat, np.full(3, 0.1), particle_rng)
        for _ in range(5):
            truth = predict(MOTION, truth, generator)
            bin_ = int(np.bincount(bins_of(particles)).argmax())
            u = 1000.0 / np.hypot(truth[0, 0], truth[0, 2]) ** 2 / sigma * (bins_of(truth)[0] == bin_)
            r = np.abs(u + np.sqrt(0.5) * (generator.standard_normal() + 1j * generator.standard_normal()))
            seen = 2.0 * r * r >= THRESHOLD
            observation = in_bins(bin_ if seen else -1, float(r) * seen, looked_at(sigma, bin_))
            particles, *_ = update(model, particles, observation, particle_rng)
        below, at = (particles < truth).mean(axis=0), (particles == truth).mean(axis=0)
        ranks.append(below + at * generator.random(4))
    for component in np.array(ranks).T:
        assert stats.kstest(component, "uniform").pvalue > 1e-4


def test_nothing_looked_at_is_propagation() -> None:
    particles = wide_belief(500, 3)
    result = update(RESAMPLE, particles, in_bins(-1, 0, np.zeros(100)), rng(1))
    np.testing.assert_array_equal(result.particles, predict(MOTION, particles, rng(1)))


def test_the_prior_belief_is_left_alone() -> None:
    particles = wide_belief(500, 3)
    before = particles.copy()
    for model in (RESAMPLE, REJECTION):
        for observation in (*OBSERVATIONS.values(), in_bins(3, in_level(5), looked_at(0.1, 3))):
            update(model, particles, observation, rng(1))
    np.testing.assert_array_equal(particles, before)


def test_same_generator_same_belief() -> None:
    for model in (RESAMPLE, REJECTION):
        for observation in OBSERVATIONS.values():
            a, b = (update(model, wide_belief(500, 3), observation, rng(8)) for _ in "ab")
            np.testing.assert_array_equal(a.particles, b.particles)


def test_after_a_hit_all_particles_are_in_its_bin() -> None:
    for rule in RULES.values():
        result = rule(RESAMPLE, wide_belief(2000, 4), OBSERVATIONS["hit"], rng(1))
        assert (bins_of(result.particles) == 56).all()


def test_rejection_fills_up_with_what_it_has_kept() -> None:
    particles = wide_belief(1000, 5)
    # level 4 at sigma 0.05 is |alpha| = 0.35 .. 0.43, 48 .. 54 km: in the tail of 60 +- 4 km, one bin of five
    observation = in_bins(56, in_level(4), looked_at(0.05, 56))
    result = reject(paper_model(max_tries=1), particles, observation, rng(1))
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
    r=st.one_of(st.floats(0.0, 50.0), st.floats(0.0, MAX_AMPLITUDE)),
    is_exact=st.booleans(),
    sigma=st.one_of(st.floats(1e-3, 1.0), st.floats(1e-9, 1e6)),
    everywhere=st.booleans(),
    kernel_bandwidth=st.sampled_from([0.0, 0.3, 1.0]),
    filter=st.sampled_from(["likelihood", "published"]),
    seed=st.integers(0, 2**32),
)
def test_any_observation_gives_a_belief(
    name: str, hit_bin: int, r: float, sigma: float, everywhere: bool, seed: int, **belief: Any
) -> None:
    sigmas = np.full(100, sigma) if everywhere else looked_at(sigma, max(hit_bin, 56))
    if hit_bin >= 0:
        sigmas[hit_bin] = sigma
    model = paper_model(**belief, max_tries=5)
    observation = in_bins(hit_bin, r if hit_bin >= 0 else 0.0, sigmas)
    result = update(model, BELIEFS[name], observation, rng(seed))
    assert result.particles.shape == (60, 4)
    assert np.isfinite(result.particles).all()
    assert (result.particles[:, 0] >= 0.0).all()
    if hit_bin >= 0:
        assert (bins_of(result.particles) == hit_bin).all()


@pytest.mark.parametrize("model", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
def test_a_hit_that_nobody_explains_moves_the_belief_there(model: TrackerModel) -> None:
    particles = wide_belief(1000, 7)
    observation = in_bins(20, in_level(9), looked_at(0.02, 20))  # |alpha| = 0.31 .. 0.35: 54 .. 57 km
    result = update(replace(model, motion=STILL), particles, observation, rng(1))
    assert result.depleted
    assert (bins_of(result.particles) == 20).all()
    np.testing.assert_array_equal(result.particles[:, 1::2], particles[:, 1::2])
    # four noise deviations beyond the level's edges: u = 15.6 .. 17.3, +- 2.8
    u = 1000.0 / (result.particles[:, 0] ** 2 + result.particles[:, 2] ** 2) / 0.02
    assert ((u > 12.5) & (u < 20.5)).all()


@pytest.mark.parametrize("model", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
@pytest.mark.parametrize("collapsed", [False, True])
def test_a_miss_that_nobody_explains_widens_the_belief(model: TrackerModel, collapsed: bool) -> None:
    spread = 0.0 if collapsed else 0.05
    particles = rng(1).normal([60.0, 0.2, 7.9, 0.1], [spread, 0.0, spread, 0.0], (1000, 4))
    observation = in_bins(-1, 0, looked_at(0.01, *np.unique(bins_of(particles))))  # u = 27: P_D = 1
    result = update(model, particles, observation, rng(2))
    assert result.depleted
    assert (likelihood(result.particles, observation, SENSOR) > 1e-3).mean() > 0.5
    # the next bins are 1.2 km off: the belief is out there, but not everywhere
    assert 0.5 < np.std(result.particles[:, 2]) < 10.0


def test_a_miss_in_every_cell_still_returns() -> None:
    observation = in_bins(-1, 0, np.full(100, 1e-6))
    for model in (RESAMPLE, REJECTION):
        result = update(model, wide_belief(200, 8), observation, rng(1))
        assert result.depleted
        assert np.isfinite(result.particles).all()


def test_both_updates_give_up_on_the_same_evidence() -> None:
    """Depletion is fewer than one particle expected in n max_tries draws of the rejection sampler."""
    n, max_tries = 100, 20
    particles = np.tile([60.0, 0.0, 7.9, 0.0], (n, 1))
    # u = 1000/(60^2 + 7.9^2)/0.02 = 13.65. n max_tries Z: level 8 (13.9 .. 15.6) 700, 9 (15.6 .. 17.3) 6, 10 2e-4;
    # at level 9 rejection keeps none with probability exp(-6). Of r = 15.5 68, of 16 9, of 17.5 8e-4.
    by_level = [(False, in_level(level), depleted) for level, depleted in ((8, False), (9, False), (10, True))]
    for is_exact, r, expected in (*by_level, (True, 15.5, False), (True, 16.0, False), (True, 17.5, True)):
        model = replace(paper_model(max_tries=max_tries, is_exact=is_exact), motion=STILL)
        observation = in_bins(56, r, looked_at(0.02, 56))
        evidence = likelihood(particles[:1], observation, model.sensor)[0]
        assert (n * max_tries * evidence < 1.0) == expected
        assert RULES["resample"](model, particles, observation, rng(1)).depleted == expected
        assert RULES["rejection"](model, particles, observation, rng(1)).depleted == expected


def test_a_kernel_needs_five_particles() -> None:
    """Fewer than d + 1 have a covariance without volume; the plain filter goes on with what it has."""
    particles = np.tile([60.0, 0.2, -20.0, 0.1], (1000, 1))
    for several, depleted in ((4, True), (6, False)):
        particles[:several, 2] = 7.9
        observation = in_bins(56, in_level(3), looked_at(0.05, 56))
        assert RULES["regularised"](RESAMPLE, particles, observation, rng(1)).depleted == depleted
        assert not RULES["resample"](RESAMPLE, particles, observation, rng(1)).depleted


def few_in_the_bin(elsewhere: tuple[float, float]) -> NDArray[np.float64]:
    """Three particles in bin 56 at 60 km, the others at this (x, y); ranges +- 0.2 km."""
    particles = np.tile([elsewhere[0], 0.2, elsewhere[1], 0.1], (1000, 1))
    particles[:3, 0::2] = 59.5, 7.9
    particles[:, 0::2] *= 1.0 + 0.2 / 60.0 * rng(9).standard_normal((1000, 1))
    return particles


LEVEL_3 = in_bins(56, in_level(3), looked_at(0.05, 56))  # u is 5.5 at 60 km, level 3 is 5.2 .. 6.9


@pytest.mark.parametrize("y", [6.6, -20.0])
def test_a_hit_that_a_few_expected_keeps_what_is_known_of_the_range(y: float) -> None:
    """The others are in the next bin, or in another one at the same range: 60 +- 0.2 km, and a second of motion."""
    particles = few_in_the_bin((np.sqrt(60.0**2 - y**2), y))
    result = update(RESAMPLE, particles, LEVEL_3, rng(1))
    assert result.depleted
    assert (bins_of(result.particles) == 56).all()
    range_km = np.hypot(result.particles[:, 0], result.particles[:, 2])
    assert np.abs(range_km - 60.1).max() < 1.2
    assert 0.1 < range_km.std() < 0.4
    theta = np.arctan2(result.particles[:, 2], result.particles[:, 0])
    edges = np.arcsin(2.0 * ((56 + np.array([-0.5, 0.5])) / 99.0 - 0.5))
    assert stats.kstest(theta, stats.uniform(edges[0], edges[1] - edges[0]).cdf).pvalue > 1e-6


def test_the_range_is_forgotten_if_none_was_expected_there_or_it_explains_no_such_echo() -> None:
    """A single amplitude in the middle of level 3 stands for 50 to 70 km."""
    none, other_range = few_in_the_bin((59.5, 6.6))[3:], few_in_the_bin((15.0, 1.6))
    for particles in (none, other_range):
        result = update(RESAMPLE, particles, LEVEL_3, rng(2))
        assert result.depleted
        assert (bins_of(result.particles) == 56).all()
        assert np.hypot(result.particles[:, 0], result.particles[:, 2]).std() > 2.0


@pytest.mark.parametrize("model", [RESAMPLE, REJECTION], ids=["resample", "rejection"])
@pytest.mark.parametrize(("share", "kept"), [(0.04, False), (0.06, True), (1.0, True)])
def test_an_amplitude_that_nobody_explains_keeps_the_ranges_of_whom_it_was_expected(
    model: TrackerModel, share: float, kept: bool
) -> None:
    """60 +- 0.2 km in bin 56, u = 13.9; an echo of 30 sigma would be at 41 km."""
    particles = few_in_the_bin((np.sqrt(60.0**2 - 6.6**2), 6.6))
    particles[: int(share * 1000), 0::2] = 59.5, 7.9
    particles[:, 0::2] *= 1.0 + 0.2 / 60.0 * rng(9).standard_normal((1000, 1))
    result = update(model, particles, in_bins(56, 30.0, looked_at(0.02, 56)), rng(3))
    assert result.depleted
    assert (bins_of(result.particles) == 56).all()
    assert np.hypot(result.particles[:, 0], result.particles[:, 2]).mean() == pytest.approx(60.0 if kept else 41, abs=1)


def test_a_detection_is_of_a_target_in_front_of_the_array() -> None:
    """Bin 99 at 60 km is 8.5 km wide; a particle that the motion model holds at x = 0 would have flown out of it."""
    particles = np.column_stack(
        (rng(1).uniform(0.0, 8.0, 3000), np.full(3000, -0.3), np.full(3000, 60.0), np.zeros(3000))
    )
    particles[::3, :2] = 0.0, -0.3
    hit = in_bins(99, 1000.0 / 3600.0 / 0.02, looked_at(0.02, 99))
    for _ in range(10):
        after = update(RESAMPLE, particles, hit, rng(2)).particles
        assert (after[:, 0] > 0.0).all()
        assert after[:, 0].mean() == pytest.approx(particles[particles[:, 0] > 0.0, 0].mean(), abs=0.6)
        particles = after
    # A miss says nothing of those that have left.
    assert (update(RESAMPLE, particles * [0.0, 1.0, 1.0, 1.0], in_bins(-1, 0.0, np.zeros(100)), rng(3))).evidence == 1
