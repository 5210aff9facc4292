"""The search for targets that nobody announced: where it looks in a dwell, and how much power it has."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.rules import Requests
from cogradar.shared.power.wide import KEPT, sure_powers
from cogradar.shared.scenario.radar_config import RadarConfig, SearchSection
from cogradar.shared.signal.array import bin_centres

Floats = NDArray[np.float64]

LEAST_SHARE = 0.1  # of the power, however much the tracks need: else nobody who comes would ever be found


def search_directions(radar: RadarConfig, search: SearchSection, k: int) -> Floats:
    """Directions of the search beams of dwell k, (n,) ascending; none if it goes everywhere.

    The beams of a dwell are far apart, and step on by a bin from dwell to dwell. Every second sweep is half a bin
    further: a target at the border of two bins is met with a sixth of its power.
    """
    if search.pattern == "isotropic":
        return np.empty(0)
    n_bin = radar.array.n_bin
    length = -(-n_bin // search.beams)  # dwells of a sweep
    sweep, step = divmod(k, length)
    bins = step + length * np.arange(search.beams)
    centres = bin_centres(n_bin)[bins[bins < n_bin]]
    return np.unique(np.minimum(centres + 0.5 * (sweep % 2) / (n_bin - 1), 0.5))


def search_power(radar: RadarConfig, search: SearchSection, requests: Requests | None) -> float:
    """Power of the search: its share, or what tracks do not need to be found for sure; all of it without any track.

    requests : of the tracks there are; None: of none
    """
    power = radar.array.power
    if requests is None:
        return power
    if search.share != "auto":
        return float(search.share) * power
    needed = KEPT * float((sure_powers(radar, requests.gains) * (requests.chances.sum(axis=1) > 0.0)).sum())
    return max(power - needed, LEAST_SHARE * power)
