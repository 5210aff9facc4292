"""Directions and gates that a track asks for, against searches over every direction and plain counting."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.planning.steering import direction_in, directions, expected_at, gate
from cogradar.shared.signal.array import apart, around, bin_centres, spatial_frequency
from cogradar.shared.signal.response import LobeResponse
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.track import start
from tests.shared.tracking.models import smoke_model
from tests.shared.tracking.test_steered import ACQUISITION

RESPONSE = LobeResponse(16, 16, 16, 0.5)
LOBE = 1.0 / 16.0
BEST_RANGE = smoke_model("best-range")


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def covered(nus: NDArray[np.float64], nu: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(nus - nu) <= 0.5 * LOBE)


def test_one_look_at_a_narrow_belief_is_at_its_mean() -> None:
    nus = 0.2 + 0.002 * rng(1).standard_normal(2000)
    found = directions(RESPONSE, nus, 3)
    assert found.nus == pytest.approx([nus.mean()], abs=2e-5)
    assert found.chances.tolist() == [1.0]
    assert found.loss == pytest.approx((RESPONSE.loss(nus - nus.mean()) ** 2).mean(), rel=1e-3)
    assert 0.95 < found.loss < 1.0


@pytest.mark.parametrize("seed", range(5))
def test_the_first_look_covers_nearly_as_much_as_any_could(seed: int) -> None:
    """The one that receives most of what it covers is not quite the one that covers most."""
    generator = rng(seed)
    clusters = [
        generator.uniform(-0.45, 0.45) + generator.uniform(0.01, 0.06) * generator.standard_normal(n)
        for n in (700, 500)
    ]
    nus = np.clip(np.concatenate(clusters), -0.5, 0.5)
    found = directions(RESPONSE, nus, 3)
    left, shares = nus, list[float]()
    for nu, chance in zip(found.nus.tolist(), found.chances.tolist(), strict=True):
        best = max(covered(left, candidate).mean() for candidate in np.linspace(-0.5, 0.5, 2001))
        assert covered(left, nu).mean() > 0.9 * best
        assert chance == pytest.approx(covered(left, nu).sum() / nus.size, abs=1e-12)
        shares.append(chance)
        left = left[~covered(left, nu)]
    assert 1 <= len(shares) <= 3
    assert sum(shares) <= 1.0


@pytest.mark.parametrize("width", [0.6, 0.75, 1.2])
def test_the_cells_of_a_broad_belief_are_a_lobe_apart(width: float) -> None:
    """Beams a lobe apart are orthogonal; what is beyond the first cell on both sides has one of its own."""
    nus = 0.1 + width * LOBE * rng(7).uniform(-1.0, 1.0, 4000)
    found = directions(RESPONSE, nus, 3)
    gaps = np.diff(np.sort(found.nus))
    assert gaps.size == 2
    assert (gaps >= LOBE * (1.0 - 1e-9)).all()
    assert found.chances.sum() == pytest.approx(1.0, abs=0.02)


def test_two_clusters_have_a_look_each_the_larger_first() -> None:
    nus = np.concatenate((np.full(300, -0.1), np.full(700, 0.3))) + 0.001 * rng(2).standard_normal(1000)
    found = directions(RESPONSE, nus, 3)
    assert found.nus == pytest.approx([0.3, -0.1], abs=2e-4)
    assert found.chances.tolist() == [0.7, 0.3]
    assert directions(RESPONSE, nus, 1).nus.size == 1


@pytest.mark.parametrize("turn", np.arange(1, 16).tolist())
@pytest.mark.parametrize("width", [0.3, 0.75, 1.2])
def test_looks_turn_with_a_belief_around_the_ends(width: float, turn: int) -> None:
    """Shifted by whole lobes, so that the places at which cells are tried are the same."""
    nus = 0.1 + width * LOBE * np.append(rng(7).uniform(-1.0, 1.0, 400), rng(8).uniform(0.0, 0.5, 100))
    inside, across = directions(RESPONSE, nus, 3), directions(RESPONSE, around(nus + turn * LOBE), 3)
    assert apart(across.nus, inside.nus + turn * LOBE) == pytest.approx(np.zeros(inside.nus.size), abs=0.005 * LOBE)
    assert across.chances == pytest.approx(inside.chances, abs=0.005)
    assert across.loss == pytest.approx(inside.loss, abs=0.005)
    assert (np.abs(across.nus) <= 0.5).all()


@pytest.mark.parametrize("bin_", [0, 15])
def test_the_bins_at_both_ends_are_one_cell(bin_: int) -> None:
    found = direction_in(RESPONSE, np.array([0.49, -0.488, 0.3]), bin_)
    assert apart(found.nus, [-0.499]) == pytest.approx([0.0], abs=1e-12)
    assert found.chances == pytest.approx([2.0 / 3.0])
    assert found.loss == pytest.approx((RESPONSE.loss(np.array([0.011, 0.011])) ** 2).mean())


@pytest.mark.parametrize("nu", [-0.5, 0.5])
def test_a_belief_at_the_edge_of_the_field(nu: float) -> None:
    assert directions(RESPONSE, np.full(50, nu), 3).nus.tolist() == [nu]


def test_the_look_into_a_chosen_bin_is_where_its_particles_are() -> None:
    centre = bin_centres(16)[9]
    nus = np.concatenate((np.full(6, centre + 0.01), np.full(4, centre + 0.02), np.full(10, centre + 0.06)))
    found = direction_in(RESPONSE, nus, 9)
    assert found.nus == pytest.approx([centre + 0.014], abs=1e-12)
    assert found.chances.tolist() == [0.5]
    assert direction_in(RESPONSE, nus, 2).nus.tolist() == [bin_centres(16)[2]]


def test_where_particles_will_be() -> None:
    state = start(BEST_RANGE, 1, 9, ACQUISITION)
    moved = state.belief.rows + np.array([1.0, 0.0, 1.0, 0.0]) * state.belief.rows[:, [1, 1, 3, 3]]
    nus, ranges_km = expected_at(BEST_RANGE, state)
    np.testing.assert_allclose(nus, spatial_frequency(moved), rtol=1e-12)
    np.testing.assert_allclose(ranges_km, np.hypot(moved[:, 0], moved[:, 2]), rtol=1e-12)


def of_width(range_cell_km: float) -> TrackerModel:
    return replace(BEST_RANGE, response=replace(RESPONSE, range_cell_km=range_cell_km))


@pytest.mark.parametrize("width", [0.5, 0.3, 2.0])
@pytest.mark.parametrize(("mean", "sigma"), [(50.0, 0.01), (50.0, 0.3), (80.0, 2.0), (5.0, 3.0)])
def test_gates_are_whole_cells_a_power_of_two_that_hold_the_belief(mean: float, sigma: float, width: float) -> None:
    ranges_km = np.abs(mean + sigma * rng(3).standard_normal(4000))
    low, high = gate(of_width(width), ranges_km, 0.0).tolist()
    n_cell = round((high - low) / width, 9)
    assert low / width == pytest.approx(round(low / width), abs=1e-9)
    assert n_cell == pytest.approx(2 ** round(np.log2(n_cell)), abs=1e-9)
    assert n_cell >= 4
    assert n_cell <= max(4, 2 * (8.0 * sigma / width + 2))  # none that a smaller power would have done for
    inner = np.clip(ranges_km, ranges_km.mean() - 4 * ranges_km.std(), ranges_km.mean() + 4 * ranges_km.std())
    assert low <= inner.min()
    assert inner.max() <= high


def test_an_unsure_track_and_one_without_range_cells_have_the_whole_field_tested() -> None:
    assert gate(of_width(0.5), np.linspace(5.0, 200.0, 100), 0.0).tolist() == [0.0, 0.0]
    assert gate(of_width(np.inf), np.full(10, 50.0), 0.0).tolist() == [0.0, 0.0]


def test_the_ranges_of_a_target_that_may_have_turned_are_tested_too() -> None:
    calm, astray = (gate(of_width(0.5), np.full(10, 50.0), apart_km) for apart_km in (0.0, 3.0))
    assert astray[0] <= 47.0 < calm[0] < calm[1] < 53.0 <= astray[1]
