"""Two aircraft that meet: their looks hear both, and those of one range cell as one."""

import numpy as np

from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.model import TrackState
from cogradar.shared.tracking.motion import predicted_states
from cogradar.shared.tracking.track import observe
from tests.shared.tracking.contested import BEST_RANGE, EXISTENCE, LOBE, NU_SIGMA, Floats, begun, placed, scan_of

N_DWELL, MEET, RATES = 30, 15, np.array([0.003, 0.04])  # dwells; nu and km per dwell, of the second one the opposite


def places_at(k: int) -> Floats:
    """Direction and range of both, (2, 2)."""
    return np.asarray(np.array([0.05, 50.25]) + np.array([[1.0], [-1.0]]) * RATES * (k - MEET))


def expected_of(state: TrackState) -> list[float]:
    x, _vx, y, _vy = predicted_states(state.belief.rows, BEST_RANGE.motion.dt).T
    nus, ranges_km = 0.5 * y / np.hypot(x, y), np.hypot(x, y)
    return [nus.mean(), nus.std(), ranges_km.mean(), ranges_km.std(), EXISTENCE]


def met(k: int, expected: Floats, rng: np.random.Generator) -> Detections:
    """What is seen of both where they are expected: of each range cell the sum of the echoes."""
    nus, ranges_km = places_at(k).T
    echoes, cells, turns = list[tuple[float, float, float]](), np.floor(ranges_km / 0.5), np.exp(6.3j * rng.random(2))
    for nu in expected[:, 0].tolist():
        for cell in np.unique(cells).tolist():
            heard = turns * LOBE.loss(nus - nu) * (cells == cell)
            if abs(heard.sum()) > 0.3:
                nu_hat = float((heard @ nus / heard.sum()).real) + NU_SIGMA * rng.normal()
                echoes.append((nu, nu_hat, (cell + 0.5) * 0.5))
    return scan_of(echoes, expected[:, [0, 2]].tolist(), missed=expected[:, 0].tolist(), k=k)._replace(
        expected=expected
    )


def are_kept(seed: int, *, is_told: bool) -> bool:
    """Whether each track is near its own aircraft at the end; told where both tracks were expected, or not."""
    rng, first = np.random.default_rng(seed), places_at(0)
    rates = np.array([[1.0], [-1.0]]) * RATES
    states = [begun(m, (first[m, 0], rates[m, 0]), (first[m, 1], rates[m, 1])) for m in range(2)]
    for k in range(1, N_DWELL + 1):
        scan = met(k, np.array([expected_of(state) for state in states]), rng)
        states = [observe(BEST_RANGE, state, scan if is_told else scan._replace(expected=None)) for state in states]
    ends = np.array([state.belief.rows[:, ::2].mean(axis=0) for state in states])
    return bool(np.linalg.norm(ends - placed(*places_at(N_DWELL).T), axis=1).max() < 1.0)


def test_two_that_meet_come_out_as_two_with_their_identities() -> None:
    assert all(are_kept(seed, is_told=True) for seed in range(6))
    assert not all(are_kept(seed, is_told=False) for seed in range(6))
