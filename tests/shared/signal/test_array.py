"""The array and the grid of angle bins."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogradar.shared.signal import angle
from cogradar.shared.signal.array import (
    angle_bin,
    apart,
    around,
    bin_centres,
    in_plane,
    mean_direction,
    near_pairs,
    on_ground,
    spatial_frequency,
    steering_vector,
)

N_BIN = st.integers(3, 400)
POSITION = st.floats(-300.0, 300.0)


def test_bin_centres_include_both_ends() -> None:
    np.testing.assert_allclose(bin_centres(100), -0.5 + np.arange(100) / 99, atol=1e-15)
    assert (bin_centres(100)[0], bin_centres(100)[-1]) == (-0.5, 0.5)


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.4, 0.49, -0.52, -0.6])
def test_the_mean_of_directions_turns_with_them(turn: float) -> None:
    nus = 0.1 + 0.03 * np.random.default_rng(1).standard_normal(500)
    mean, sigma = mean_direction(around(nus + turn))
    assert apart(mean, nus.mean() + turn) == pytest.approx(0.0, abs=1e-12)
    assert sigma == pytest.approx(nus.std(), rel=1e-9)
    assert -0.5 <= mean <= 0.5


def test_first_and_last_bin_are_one_direction() -> None:
    np.testing.assert_allclose(steering_vector(-0.5, 100), steering_vector(0.5, 100), atol=1e-12)


@given(nu=st.floats(-0.5, 0.5), other=st.floats(-0.5, 0.5))
def test_distances_of_directions_are_those_of_a_circle(nu: float, other: float) -> None:
    assert apart(nu, other) == pytest.approx(min(abs(nu - other + turn) for turn in (-1.0, 0.0, 1.0)), abs=1e-15)
    assert angle.apart(nu, other) == apart(nu, other)


@given(nu=st.floats(-0.5, 0.5), n=st.integers(1, 200))
def test_steering_vector_turns_at_its_frequency(nu: float, n: int) -> None:
    a = steering_vector(nu, n)
    assert a[0] == 1.0
    np.testing.assert_allclose(np.abs(a), 1.0, rtol=1e-12)
    np.testing.assert_allclose(a[1:] * a[:-1].conj(), np.exp(2j * math.pi * nu), rtol=1e-10)


def test_steering_vectors_of_many_directions_are_rows() -> None:
    nus = np.array([[-0.3, 0.0], [0.1, 0.5]])
    rows = steering_vector(nus, 7)
    assert rows.shape == (2, 2, 7)
    for index in np.ndindex(2, 2):
        np.testing.assert_array_equal(rows[index], steering_vector(nus[index], 7))


def test_neighbouring_bins_are_nearly_orthogonal() -> None:
    # |sum_n e^{j 2 pi n / 99}| over n = 0 .. 99 is one term too many for a full turn: exactly 1 of 100.
    nus = bin_centres(100)
    product = np.vdot(steering_vector(nus[40], 100), steering_vector(nus[41], 100))
    assert abs(product) == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize(
    ("x", "y", "nu"),
    [(60.0, 0.0, 0.0), (60.0, -60.0, -math.sqrt(2) / 4), (0.0, 5.0, 0.5), (0.0, -5.0, -0.5), (math.sqrt(3), 1.0, 0.25)],
)
def test_spatial_frequency_is_half_the_sine_of_the_bearing(x: float, y: float, nu: float) -> None:
    assert spatial_frequency([x, 9.0, y, 9.0]) == pytest.approx(nu)


@given(states=st.lists(st.tuples(st.floats(0.1, 300.0), POSITION, POSITION, POSITION), min_size=1, max_size=5))
def test_spatial_frequency_of_many_states(states: list[tuple[float, ...]]) -> None:
    expected = [0.5 * math.sin(math.atan2(y, x)) for x, _, y, _ in states]
    np.testing.assert_allclose(spatial_frequency(states), expected, atol=1e-12)


@given(nu=st.floats(-0.5, 0.5), n_bin=N_BIN)
def test_angle_bin_has_the_nearest_centre(nu: float, n_bin: int) -> None:
    index = int(angle_bin(nu, n_bin))
    assert 0 <= index < n_bin
    assert abs(nu - bin_centres(n_bin)[index]) <= 0.5 / (n_bin - 1) + 1e-12


@given(n_bin=N_BIN)
def test_centres_belong_to_their_bins(n_bin: int) -> None:
    np.testing.assert_array_equal(angle_bin(bin_centres(n_bin), n_bin), np.arange(n_bin))


def test_a_state_at_the_array_itself_is_at_boresight() -> None:
    """As atan2(0, 0) = 0 has it."""
    np.testing.assert_array_equal(spatial_frequency([[0.0, 1.0, 0.0, 1.0], [3.0, 0.0, 4.0, 0.0]]), [0.0, 0.4])


def test_positions_of_one_range_and_direction_are_a_circle_about_the_line_of_the_array() -> None:
    angles = np.linspace(0.0, 1.5, 7)
    states = np.column_stack((20.0 * np.cos(angles), np.ones(7), np.full(7, 30.0), np.ones(7)))
    heights = 20.0 * np.sin(angles)
    flat = in_plane(states, heights)
    r = np.sqrt(states[:, 0] ** 2 + states[:, 2] ** 2 + heights**2)
    np.testing.assert_allclose(np.hypot(flat[:, 0], flat[:, 2]), r)
    np.testing.assert_allclose(spatial_frequency(flat), 0.5 * states[:, 2] / r)
    np.testing.assert_allclose([angle.from_line(x, z) for x, z in zip(states[:, 0], heights, strict=True)], flat[:, 0])
    assert (in_plane(states, np.zeros(7)) == states).all()


@pytest.mark.parametrize("x_km", [9.0, 20.0, 80.0])
def test_on_the_ground_is_what_heights_leave_of_a_position_in_the_plane(x_km: float) -> None:
    """Against positions and heights drawn evenly, of which those are kept whose distance from the array's line fits."""
    rng, highest_km, sigma = np.random.default_rng(4), 8.0, 0.05
    z = rng.uniform(0.0, highest_km, 4_000_000)
    x = rng.uniform(max(x_km - 6.0, 0.0), x_km + 1.0, z.size)
    kept = np.abs(np.hypot(x, z) - x_km) < np.sqrt(3.0) * sigma
    x, z = x[kept], z[kept]
    vx = 0.2 * np.hypot(x, z) / x  # of v_x' = 0.2
    mean, covariance = np.array([x_km, 0.2, -3.0, 0.1]), np.diag([sigma**2, 1e-6, 0.01, 1e-6])
    ground, spread = on_ground(mean, covariance, highest_km)
    assert ground[0] == pytest.approx(x.mean(), abs=0.01)
    assert spread[0, 0] ** 0.5 == pytest.approx(x.std(), rel=0.05)
    assert ground[1] == pytest.approx(vx.mean(), rel=0.02)
    assert ground[2:].tolist() == mean[2:].tolist()
    np.testing.assert_allclose(on_ground(mean, covariance, 0.0)[1], covariance, atol=1e-15)


@pytest.mark.parametrize("reach", [0.0, 0.01, 0.3, 0.5])
def test_pairs_of_near_directions_are_those_of_all_pairs(reach: float) -> None:
    rng = np.random.default_rng(1)
    nus, others = (np.append(rng.uniform(-0.5, 0.5, n), [-0.5, 0.5, 0.0]) for n in (40, 60))
    i, j = near_pairs(nus, others, reach)
    expected = np.argwhere(apart(nus[:, np.newaxis], others) < reach)
    assert np.column_stack((i, j)).tolist() == expected.tolist()
    assert [found.size for found in near_pairs(nus, np.empty(0), reach)] == [0, 0]
