"""Assignment of tracks to targets against brute force."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from cogradar.shared.scoring.matching import GATE_BINS, LOG_RANGE_SIGMA, NU_SIGMA, associate


def cost(estimates: np.ndarray, truths: np.ndarray, order: tuple[int, ...]) -> float:
    total = 0.0
    for track, target in enumerate(order):
        (x, _, y, _), (u, _, v, _) = estimates[track], truths[target]
        r, s = np.hypot(x, y), np.hypot(u, v)
        total += ((0.5 * y / r - 0.5 * v / s) / NU_SIGMA) ** 2 + (np.log(r / s) / LOG_RANGE_SIGMA) ** 2
    return total


scenes = st.integers(1, 5).flatmap(lambda m: arrays(np.float64, (2, m, 4), elements=st.floats(0.5, 200.0, width=32)))


@settings(deadline=None, max_examples=60)
@given(scenes, st.integers(3, 200))
def test_assignment_is_the_cheapest_of_those_with_most_pairs(scene: np.ndarray, n_bin: int) -> None:
    estimates, truths = scene
    chosen = associate(estimates, truths, n_bin)
    paired = [m for m in chosen if m >= 0]
    assert len(set(paired)) == len(paired)
    nu = [0.5 * s[:, 2] / np.hypot(s[:, 0], s[:, 2]) for s in (estimates, truths)]
    near = np.abs(np.subtract.outer(*nu)) <= GATE_BINS / (n_bin - 1)

    def of(order: tuple[int, ...]) -> tuple[int, float]:
        pairs = [i for i, m in enumerate(order) if m >= 0 and near[i, m]]
        return -len(pairs), cost(estimates[pairs], truths[[order[i] for i in pairs]], tuple(range(len(pairs))))

    most, cheapest = min(of(order) for order in permutations(range(len(truths))))
    assert of(tuple(chosen))[0] == -len(paired) == most
    assert of(tuple(chosen))[1] == pytest.approx(cheapest, rel=1e-9, abs=1e-9)


def test_a_track_far_from_every_target_is_no_target_s() -> None:
    """A false alarm, and a track of the second target: not by elimination either is the first of the first."""
    truths = np.array([[400.0, 0.0, 0.0, 0.0], [50.0, 0.0, 30.0, 0.0]])
    estimates = np.array([[60.0, 0.0, -60.0, 0.0], [55.0, 0.0, 33.0, 0.0]])
    np.testing.assert_array_equal(associate(estimates, truths, 16), [-1, 1])
    np.testing.assert_array_equal(associate(estimates[::-1], truths, 16), [1, -1])


def test_bearing_counts_before_a_wrong_range() -> None:
    """Targets two bins apart at 50 and 100 km, tracks with their ranges the wrong way round: by position they swap."""
    nu, ranges = np.array([0.1, 0.12, -0.3]), np.array([50.0, 100.0, 60.0])
    sine = 2 * nu

    def states(r: np.ndarray) -> np.ndarray:
        return np.stack([r * np.sqrt(1 - sine**2), 0 * r, r * sine, 0 * r], axis=-1)

    truths, estimates = states(ranges), states(ranges[[1, 0, 2]])[[2, 0, 1]]
    np.testing.assert_array_equal(associate(estimates, truths, 100), [2, 0, 1])
    distance = np.linalg.norm(estimates[:, None, ::2] - truths[None, :, ::2], axis=2)
    np.testing.assert_array_equal(linear_sum_assignment(distance)[1], [2, 1, 0])


def test_range_decides_within_a_bin() -> None:
    truths = np.array([[30.0, 0.0, 10.0, 0.0], [90.0, 0.0, 30.0, 0.0]])
    np.testing.assert_array_equal(associate(truths[::-1] * 1.2, truths, 100), [1, 0])


FINITE = st.floats(allow_nan=False, allow_infinity=False) | st.just(0.0)


@given(states=arrays(np.float64, (2, 3, 4), elements=FINITE))
def test_any_finite_states_are_associated(states: np.ndarray) -> None:
    assert set(associate(states[0], states[1], 16)) <= {-1, 0, 1, 2}


def test_a_target_at_the_array_itself_is_associated_by_what_is_left() -> None:
    truths = np.array([[0.0, 0.0, 0.0, 0.0], [40.0, 0.0, -30.0, 0.0], [40.0, 0.0, 30.0, 0.0]])
    estimates = np.array([[41.0, 0.0, 31.0, 0.0], [1.0, 0.0, 0.0, 0.0], [41.0, 0.0, -31.0, 0.0]])
    np.testing.assert_array_equal(associate(estimates, truths, 100), [2, 0, 1])
