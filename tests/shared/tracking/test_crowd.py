"""Hundreds of tracks: what is looked up in sorted lists is what a search of all pairs finds."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from cogradar.shared.tracking import association
from cogradar.shared.tracking.assignment import clusters

Floats = NDArray[np.float64]
LOBE, N_TRACK, N_LOOK = 0.01, 120, 150


def crowd(seed: int, cell_km: float) -> tuple[Floats, Floats]:
    """Tracks and detections as `_separate` takes them: some near each other, at both ends, and without ranges."""
    rng = np.random.default_rng(seed)
    nus, ranges_km = rng.uniform(-0.5, 0.5, N_TRACK), rng.uniform(1.0, 40.0, N_TRACK)
    nus[::9], nus[4::9] = -0.4995, 0.4995
    sigmas = rng.uniform(1e-4, 3e-3, N_TRACK), rng.uniform(0.05, 0.6, N_TRACK)
    gates = ranges_km[:, np.newaxis] + rng.uniform(0.5, 4.0, N_TRACK)[:, np.newaxis] * np.array([-1.0, 1.0])
    gates[::7] = 0.0
    looks = np.column_stack((nus, np.where(rng.random(N_TRACK) < 0.5, nus + LOBE, np.nan)))
    tracks = np.column_stack((nus, sigmas[0], ranges_km, sigmas[1], rng.uniform(0.3, 1.0, N_TRACK), gates, looks))
    of = rng.integers(N_TRACK, size=N_LOOK)
    axis = np.where(rng.random(N_LOOK) < 0.6, nus[of], nus[of] + rng.normal(0.0, 0.5 * LOBE, N_LOOK))
    at_km = ranges_km[of] + rng.normal(0.0, 2.0, N_LOOK)
    at_km[::11] = 0.0
    seen = np.array([axis, np.abs(at_km), axis + rng.normal(0.0, 1e-3, N_LOOK), np.full(N_LOOK, 5e-4)])
    return tracks, seen if cell_km < np.inf else seen * np.array([[1.0], [0.0], [1.0], [1.0]])


@pytest.mark.parametrize("cell_km", [0.5, np.inf])
@pytest.mark.parametrize("seed", range(5))
def test_clusters_of_a_crowd_are_those_of_all_pairs(seed: int, cell_km: float) -> None:
    tracks, seen = crowd(seed, cell_km)
    order = np.random.default_rng(seed).permutation(N_LOOK)
    labels, theirs, alone = clusters.separate(tracks, seen, order, LOBE, cell_km)
    may_be = np.array([[clusters._may_be(one, look, LOBE, cell_km) for look in seen.T.copy()] for one in tracks])
    graph = np.block([[np.zeros((N_TRACK, N_TRACK)), may_be], [may_be.T, np.zeros((N_LOOK, N_LOOK))]])
    _, parts = connected_components(graph, directed=False)
    first = {part: int(np.flatnonzero(parts == part)[0]) for part in parts.tolist()}
    assert labels.tolist() == [first[part] for part in parts[:N_TRACK].tolist()]
    assert theirs.tolist() == [
        first[part] if may_be[:, j].any() else -1 for j, part in enumerate(parts[N_TRACK:].tolist())
    ]
    competes = np.bincount(parts[:N_TRACK])[parts[:N_TRACK]] > 1
    assert (alone == clusters.COMPETES).tolist() == competes.tolist()
    assert may_be[np.flatnonzero(alone >= 0), alone[alone >= 0]].all()
    assert cell_km == np.inf or (alone >= 0).any()
    assert may_be.sum() > N_TRACK


@pytest.mark.parametrize("seed", range(5))
def test_the_looks_of_each_track_of_a_crowd_are_those_of_all_rows(seed: int) -> None:
    tracks, seen = crowd(seed, 0.5)
    gates, lit = tracks[:, 5:7].copy(), tracks[:, 7:].copy()
    gates[gates[:, 1] == 0.0] = 0.0, 1e9
    ends, rows = association._rows_in(seen[0], seen[1], lit, gates)
    for m in range(N_TRACK):
        is_lit = (seen[0][:, np.newaxis] == lit[m]).any(axis=1)
        is_in_gate = (seen[1] == 0.0) | ((seen[1] > gates[m, 0]) & (seen[1] < gates[m, 1]))
        assert rows[ends[m] : ends[m + 1]].tolist() == np.flatnonzero(is_lit & is_in_gate).tolist()
    assert ends[-1] > N_TRACK // 2
