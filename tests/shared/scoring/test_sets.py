"""GOSPA and OSPA against their definitions, and as the metrics that they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cogradar.shared.scoring.figures import CUT_OFF_KM
from cogradar.shared.scoring.sets import assigned, squared_distances
from tests.oracles.sets import set_distance, slow_gospa, slow_ospa

# Sets of states so near to each other that some pairs are within the cut-off, some are not, and some are of one place.
places = st.sampled_from([0.0, 1.0, 2.5, 4.0, 5.0, 7.0, 11.0])
sets = st.integers(0, 4).flatmap(lambda n: arrays(np.float64, (n, 4), elements=places))


def gospa_km(tracks: np.ndarray, truths: np.ndarray) -> float:
    found = set_distance(tracks, truths)
    return float(np.sqrt(found.localisation + found.missed + found.false))


def ospa_km(tracks: np.ndarray, truths: np.ndarray) -> float:
    return float(np.sqrt(set_distance(tracks, truths).ospa))


@given(sets, sets)
def test_the_distances_are_those_of_their_definitions(tracks: np.ndarray, truths: np.ndarray) -> None:
    assert gospa_km(tracks, truths) == pytest.approx(slow_gospa(tracks, truths), abs=1e-12)
    assert ospa_km(tracks, truths) == pytest.approx(slow_ospa(tracks, truths), abs=1e-12)


@given(sets, sets)
def test_the_parts_count_what_is_missed_and_what_is_false(tracks: np.ndarray, truths: np.ndarray) -> None:
    squared = squared_distances(tracks, truths)
    targets = assigned(squared)
    paired = [(i, j) for i, j in enumerate(targets) if j >= 0]
    assert len({j for _, j in paired}) == len(paired)
    assert all(squared[pair] < CUT_OFF_KM**2 for pair in paired)
    found, swapped = set_distance(tracks, truths), set_distance(truths, tracks)
    assert found.localisation == pytest.approx(sum(squared[pair] for pair in paired))
    assert (found.missed, found.false) == (12.5 * (len(truths) - len(paired)), 12.5 * (len(tracks) - len(paired)))
    assert gospa_km(truths, tracks) == pytest.approx(gospa_km(tracks, truths), abs=1e-12)
    assert swapped.missed - swapped.false == found.false - found.missed


@settings(max_examples=50)
@given(sets, sets, sets)
def test_a_detour_is_not_shorter(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    assert gospa_km(a, c) <= gospa_km(a, b) + gospa_km(b, c) + 1e-12
    assert ospa_km(a, c) <= ospa_km(a, b) + ospa_km(b, c) + 1e-12
    assert gospa_km(a, a) == ospa_km(a, a) == 0.0


def test_velocities_do_not_count() -> None:
    assert gospa_km(np.array([[30.0, 0.3, 40.0, -0.2]]), np.array([[33.0, 0.0, 44.0, 0.0]])) == CUT_OFF_KM
    assert gospa_km(np.array([[30.0, 0.3, 40.0, -0.2]]), np.array([[30.0, 0.0, 42.0, 0.0]])) == 2.0
