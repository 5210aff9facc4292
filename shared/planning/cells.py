"""The cells of the next dwell as one track sees them: how probable each is, and what a look at one is worth.

Symbols: S disturbance level at the target's bin; alpha its echo amplitude at the expected range.
"""

from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_bins

AHEAD = 5  # dwells, of the outlook: by then an ordinary belief has moved by a bin or not
MAX_GAIN = 1e30  # of a target on top of the array, or without any noise
ASTRAY_BELOW = 0.1  # probability of the misses since a detection, under the belief
_LEAST = 1e-6  # km, km^2: keeps a ratio finite


def bin_chances(model: TrackerModel, state: TrackState, dwells: int = 1) -> NDArray[np.float64]:
    """Probability of each bin so many dwells later, of A^dwells s over the particles; (n_bin,), sums to 1."""
    count = predicted_bins(state.particles, model.sensor.n_bin, dwells * model.motion.dt)
    return np.asarray(count / state.particles.shape[0])


def most_probable_cells(chances: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """The most probable bins, at most so many, none that is impossible, the most probable first."""
    order = np.argsort(-chances, kind="stable")[:most]
    return order[chances[order] > 0.0]


def look_gain(model: TrackerModel, state: TrackState, range_km: float) -> float:
    """Gain g of a look: a target in a cell with beam power w is detected with P_D = Q_1(sqrt(g w), sqrt lambda).

        g = zeta / w = 2 |alpha|^2 n_tx n_rx / S,   |alpha| = |alpha|_(1 km) / R^2

    range_km : R >= 0, expected; if nothing is known of the RCS, |alpha|^2 is what the track has learned
    returns  : float in [0, MAX_GAIN], per unit of power
    """
    echo = state.echo
    if model.sensor.law.tells_range:
        echo = (model.sensor.amplitude / max(range_km * range_km, _LEAST)) ** 2
    return min(2.0 * echo * model.n_virtual / max(state.level, 1.0 / MAX_GAIN), MAX_GAIN)


def reach(model: TrackerModel, state: TrackState, range_km: float) -> int:
    """How many cells from where it is expected the target may be in the next dwell, whatever it has done since.

    Since its last detection, T ago, target and belief have flown apart by 2 v_max T at most: across a bearing, so many
    kilometres change nu by up to half their ratio to the range.

    range_km : R >= 0, expected
    """
    dwells = state.looked.shape[0] + 1 if state.looked.size else 2 - state.detected
    apart_km = 2.0 * model.acquisition.v_max_km_s * dwells * model.motion.dt
    cells = 0.5 * apart_km / max(range_km, _LEAST) * (model.sensor.n_bin - 1)
    return ceil(min(cells, model.sensor.n_bin - 1))


def is_astray(state: TrackState) -> bool:
    """Whether the belief cannot explain that its target was missed."""
    return not state.detected and (state.depleted or state.attempts > 0 or state.log_evidence < log(ASTRAY_BELOW))
