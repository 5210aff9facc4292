import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.belief.likelihood import likelihood_of
from cogradar.shared.tracking.belief.resampling import Weighted, moments, optimal_bandwidth, regularise, resample
from tests.shared.tracking.models import in_bins, paper_model

PAPER = paper_model()
WEIGHTS = st.lists(st.one_of(st.just(0.0), st.floats(1e-6, 1.0)), min_size=1, max_size=30).filter(lambda w: sum(w) > 0)

NOWHERE = np.zeros(100, dtype=np.bool_)  # no cell was looked at


def weigh_all(states: NDArray[np.float64], weights: NDArray[np.float64] | None = None) -> Weighted:
    w = np.ones(len(states)) if weights is None else weights
    return Weighted(states, w, float(np.cumsum(w)[-1]), float(np.sum(w**2)), bool((w == w[0]).all()))


def moved(
    particles: Weighted,
    ancestors: NDArray[np.int64],
    h: float,
    hit_bin: int,
    looked: NDArray[np.bool_],
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Regularised after a look at these cells; what was found in them does not matter."""
    looks = in_bins(hit_bin, 5.0 if hit_bin >= 0 else 0.0, looked.astype(float))
    return regularise(particles, ancestors, h, likelihood_of(PAPER.sensor, looks), generator)


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def counts(weights: NDArray[np.float64], offset: float) -> NDArray[np.int64]:
    ancestors = resample(weigh_all(np.empty((weights.size, 4)), weights), offset)
    assert (np.diff(ancestors) >= 0).all()
    return np.bincount(ancestors, minlength=weights.size)


@settings(deadline=None)  # the first call compiles
@given(weights=WEIGHTS)
def test_expected_copies_are_proportional_to_weight(weights: list[float]) -> None:
    w, n = np.array(weights), len(weights)
    expected = n * w / w.sum()
    offsets = (np.arange(100) + 0.5) / 100
    drawn = np.array([counts(w, offset) for offset in offsets])
    assert (drawn.sum(axis=1) == n).all()
    assert (np.abs(drawn - expected) < 1.0 + 1e-9).all()
    # A count is a step function of the offset with at most two jumps, each known to half a grid step.
    np.testing.assert_allclose(drawn.mean(axis=0), expected, atol=0.01 + 1e-9)


def test_the_example_that_residual_resampling_gets_wrong() -> None:
    w = np.array([0.4, 0.3, 0.2, 0.1])
    mean = np.mean([counts(w, (i + 0.5) / 1000) for i in range(1000)], axis=0)
    np.testing.assert_allclose(mean, [1.6, 1.2, 0.8, 0.4], atol=1e-9)


@settings(deadline=None)  # the first call compiles
@given(weights=WEIGHTS, offset=st.sampled_from([0.0, 1.0 - 2.0**-53]))
def test_an_impossible_particle_is_never_chosen(weights: list[float], offset: float) -> None:
    w = np.array(weights)
    assert not counts(w, offset)[w == 0.0].any()


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32), st.booleans())
def test_moments_against_numpy(seed: int, some_zero: bool) -> None:
    generator = rng(seed)
    states = generator.normal([60.0, 0.2, 7.5, 0.1], [3.0, 0.1, 2.0, 0.05], (40, 4)) @ generator.normal(size=(4, 4))
    weights = generator.random(40)
    if some_zero:
        weights[::3] = 0.0
    mean, factor = moments(weigh_all(states, weights))
    cov = np.cov(states.T, aweights=weights, ddof=0)
    np.testing.assert_allclose(mean, np.average(states, axis=0, weights=weights), rtol=1e-12)
    scale = np.sqrt(np.diag(cov))
    np.testing.assert_allclose((factor @ factor.T) / np.outer(scale, scale), cov / np.outer(scale, scale), atol=1e-9)


def degenerate_beliefs() -> dict[str, NDArray[np.float64]]:
    states = rng(1).normal([0.0, 0.2, 60.0, 0.1], [0.0, 0.1, 2.0, 0.05], (4000, 4))
    centre = np.array([60.0, 0.2, 7.5, 0.1])
    line = centre + np.outer(rng(2).normal(size=4000), [1.0, 0.1, -2.0, 0.03])
    return {"clipped": states, "one line": line, "copies": np.tile(centre, (4000, 1))}


@pytest.mark.parametrize("name", ["clipped", "one line", "copies"])
def test_degenerate_covariance_keeps_its_null_space(name: str) -> None:
    states = degenerate_beliefs()[name]
    n = len(states)
    _, factor = moments(weigh_all(states))
    cov = np.cov(states.T, ddof=0)
    np.testing.assert_allclose(factor @ factor.T, cov, atol=1e-10)
    out = moved(weigh_all(states), np.arange(n), 0.5, -1, NOWHERE, rng(3))
    null = np.linalg.svd(cov)[0][:, np.linalg.matrix_rank(cov, tol=1e-9) :]
    np.testing.assert_allclose((out - states.mean(axis=0)) @ null, 0.0, atol=1e-8)


@pytest.mark.parametrize("weighted", [False, True])
def test_regularisation_keeps_mean_and_covariance(weighted: bool) -> None:
    n, h = 20_000, 0.5
    generator = rng(4)
    # two clusters, far from Gaussian
    states = generator.normal([60.0, 0.2, 7.5, 0.1], [1.0, 0.1, 0.5, 0.05], (n, 4))
    states[::3] += [4.0, 0.0, -1.0, 0.1]
    weights = generator.random(n) if weighted else np.ones(n)
    particles = weigh_all(states, weights)
    out = moved(particles, resample(particles, 0.5), h, -1, NOWHERE, generator)
    mean, cov = np.average(states, axis=0, weights=weights), np.cov(states.T, aweights=weights, ddof=0)
    # 5 sigma. Mean: the jitter adds h^2 C/n, and systematic resampling less than C/n. Covariance: that of a Gaussian
    # sample has variance (C_aa C_bb + C_ab^2)/n; without the shrinkage C would grow by h^2 = 25 %, which is 25 sigma.
    assert (np.abs(out.mean(axis=0) - mean) < 5.0 * np.sqrt((1.0 + h**2) * np.diag(cov) / n)).all()
    tolerance = 5.0 * np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / n)
    assert (np.abs(np.cov(out.T, ddof=0) - cov) < tolerance).all()
    assert len(np.unique(out[:, 0])) == n


def test_regularised_particles_stay_in_the_bin_of_the_detection() -> None:
    n, n_bin, bin_ = 5000, 100, 56
    generator = rng(5)
    centre = bin_ / (n_bin - 1) - 0.5
    theta = np.arcsin(2.0 * (centre + generator.uniform(-0.499, 0.499, n) / (n_bin - 1)))
    range_km = generator.normal(60.0, 2.0, n)
    velocities = generator.normal(0.0, 0.1, (n, 2))
    states = np.column_stack((range_km * np.cos(theta), velocities[:, 0], range_km * np.sin(theta), velocities[:, 1]))
    out = moved(weigh_all(states), np.arange(n), 0.3, bin_, np.arange(n_bin) == bin_, generator)
    assert (angle_bin(spatial_frequency(out), n_bin) == bin_).all()
    # a uniform bearing jittered by 0.3 sigma leaves its bin with probability p of about 0.1; p^4 stay unmoved
    assert (out == states).all(axis=1).mean() < 0.02
    free = moved(weigh_all(states), np.arange(n), 0.3, -1, NOWHERE, generator)
    assert (angle_bin(spatial_frequency(free), n_bin) != bin_).mean() > 0.03


def test_a_belief_split_by_a_miss_is_not_filled_again() -> None:
    """Two halves either side of a cell that was looked at in vain: their common kernel spans the cell."""
    n, n_bin, bin_ = 5000, 100, 56
    generator = rng(8)
    side = np.where(generator.random(n) < 0.5, -1.0, 1.0)
    theta = np.arcsin(2.0 * (bin_ / (n_bin - 1) - 0.5 + side * generator.uniform(0.52, 0.7, n) / (n_bin - 1)))
    range_km = generator.normal(60.0, 0.2, n)
    states = np.column_stack((range_km * np.cos(theta), np.zeros(n), range_km * np.sin(theta), np.zeros(n)))
    out = moved(weigh_all(states), np.arange(n), 0.3, -1, np.arange(n_bin) == bin_, generator)
    assert (angle_bin(spatial_frequency(out), n_bin) != bin_).all()
    assert (np.sign(out[:, 2] - states[:, 2].mean()) == side).mean() > 0.95  # and neither half crosses over
    free = moved(weigh_all(states), np.arange(n), 0.3, -1, NOWHERE, generator)
    assert (angle_bin(spatial_frequency(free), n_bin) == bin_).mean() > 0.1  # what the rule prevents


def test_x_is_clipped() -> None:
    n = 5000
    states = np.abs(rng(6).normal([0.0, 0.2, 60.0, 0.1], [1.0, 0.1, 2.0, 0.05], (n, 4)))
    out = moved(weigh_all(states), np.arange(n), 0.3, -1, NOWHERE, rng(7))
    assert (out[:, 0] >= 0.0).all()
    assert (out[:, 0] == 0.0).any()


def test_optimal_bandwidth() -> None:
    # d = 4: (4/6)^(1/8) n^(-1/8); n = 256 gives (2/3)^(1/8)/2
    assert optimal_bandwidth(256.0) == pytest.approx((2.0 / 3.0) ** 0.125 / 2.0, rel=1e-14)
