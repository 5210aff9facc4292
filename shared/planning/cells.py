"""The cells of the next dwell as one track sees them: how probable each is, and what a look at one is worth.

Symbols: S disturbance level at the target's bin; alpha its echo amplitude at the expected range.
"""

from functools import cache
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import ndtri
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import advance, predicted_bins

AHEAD = 10  # dwells, of what a look is worth: about as long as an ordinary track can be left dark
_STEPS = 61
MAX_GAIN = 1e30  # of a target on top of the array, or without any noise
ASTRAY_BELOW = 0.1  # probability of the misses since a detection, under the belief
_LEAST = 1e-6  # km, km^2: keeps a ratio finite


def bin_chances(model: TrackerModel, state: TrackState) -> NDArray[np.float64]:
    """Probability of each bin one dwell later, of A s over the belief; (n_bin,), sums to 1."""
    states = state.belief.sample()
    return np.asarray(predicted_bins(states, model.sensor.n_bin, model.motion.dt) / states.shape[0])


@kernel
def most_probable_cells(chances: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """The most probable bins, at most so many, none that is impossible, the most probable first."""
    found, left = np.empty(most, dtype=np.int64), chances.copy()
    for i in range(most):
        found[i] = np.argmax(left)
        if left[found[i]] <= 0.0:
            return found[:i]
        left[found[i]] = 0.0
    return found


def information_gain(model: TrackerModel, state: TrackState, cells: NDArray[np.integer]) -> float:
    """What a look adds to the probability of the most probable bin AHEAD dwells later.

        sum_b max_c P(b, c) + max_c P(no b, c) - max_c P(c),   b the cells, c the bins AHEAD dwells later

    of a look that finds the target if it is in one of these cells at the next dwell, and says so if it is not. It is
    the value of one step of lookahead. A belief that will stay in one bin gains nothing by it, one at a border much.

    cells   : (n,) bins
    returns : float in [0, 1]
    """
    grid = model.sensor.n_bin, model.motion.dt, model.motion.sigma_s
    return float(_gain(state.belief.sample(), cells, *grid, _normal_quantiles()))


@cache
def _normal_quantiles() -> NDArray[np.float64]:
    """Of N(0, 1), in equal steps: noise without chance, (_STEPS,)."""
    return ndtri((np.arange(_STEPS) + 0.5) / _STEPS)


@kernel
def _gain(
    particles: NDArray[np.float64],
    cells: NDArray[np.integer],
    n_bin: int,
    dt: float,
    sigma_s: float,
    normal: NDArray[np.float64],
) -> float:
    """`information_gain` of a belief, (n, 4).

    The acceleration until then spreads it by sigma_s dt^2 sqrt(sum_{i<AHEAD} (i + 1/2)^2) per axis: without it, a
    belief that is sharp now would never have to be looked at again. Its quantiles are dealt out in turn.
    """
    dwells, index = AHEAD, np.full(n_bin, cells.size, dtype=np.int64)
    for c in range(cells.size):
        index[cells[c]] = c
    count = np.zeros((cells.size + 1, n_bin), dtype=np.int64)
    spread = sigma_s * dt * dt * np.sqrt(dwells * (4.0 * dwells * dwells - 1.0) / 12.0)
    rows = min(max(-(-particles.shape[0] // _STEPS), 1), _STEPS)  # of few states each is dealt other quantiles, evenly
    for i in range(particles.shape[0]):
        s = particles[i]
        x, _vx, y, _vy = advance(s[0], s[1], s[2], s[3], dt, 0.0, 0.0)
        dealt = ((i // _STEPS) * _STEPS // rows + _STEPS // (2 * rows)) % _STEPS
        later_x = max(s[0] + dwells * dt * s[1] + spread * normal[i % _STEPS], 0.0)
        later_y = s[2] + dwells * dt * s[3] + spread * normal[dealt]
        count[index[bin_of(x, y, n_bin)], bin_of(later_x, later_y, n_bin)] += 1
    found, anyway, total = 0.0, 0.0, float(particles.shape[0])
    for i in range(count.shape[0]):
        found += count[i].max() / total
    for b in range(n_bin):
        chance = 0.0
        for i in range(count.shape[0]):
            chance += count[i, b] / total
        anyway = max(anyway, chance)
    return max(found - anyway, 0.0)


def look_gain(model: TrackerModel, state: TrackState, range_km: float) -> float:
    """Gain g of a look: a target in a cell with beam power w is detected with P_D = Q_1(sqrt(g w), sqrt lambda).

        g = zeta / w = 2 |alpha|^2 n_tx n_rx / S,   |alpha| = |alpha|_(1 km) / R^2

    range_km : R >= 0, expected; if nothing is known of the RCS, |alpha|^2 is what the track has learned
    returns  : float in [0, MAX_GAIN], per unit of power
    """
    echo = model.sensor.law.mean_echo(model.sensor.amplitude / max(range_km * range_km, _LEAST), state.echo)
    return min(2.0 * echo * model.n_virtual / max(state.level, 1.0 / MAX_GAIN), MAX_GAIN)


def reach(model: TrackerModel, state: TrackState, range_km: float) -> int:
    """How many cells from where it is expected the target may be in the next dwell, whatever it has done since.

    Across a bearing, kilometres change nu by up to half their ratio to the range.

    range_km : R >= 0, expected
    """
    cells = 0.5 * apart_km(model, state) / max(range_km, _LEAST) * (model.sensor.n_bin - 1)
    return ceil(min(cells, model.sensor.n_bin - 1))


def apart_km(model: TrackerModel, state: TrackState) -> float:
    """How far from where it is expected the target may be in the next dwell, km, if it has turned.

    Since its last detection, T ago, target and belief have flown apart by 2 v_max T along an axis at most.
    """
    dwells = state.n_missed + 1 if state.n_missed else 2 - state.detected
    return 2.0 * model.acquisition.v_max_km_s * dwells * model.motion.dt


def is_astray(state: TrackState) -> bool:
    """Whether the belief cannot explain that its target was missed."""
    return not state.detected and (state.depleted or state.attempts > 0 or state.log_evidence < log(ASTRAY_BELOW))
