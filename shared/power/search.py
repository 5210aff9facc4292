"""The search for an unknown number of targets: where it looks in a dwell, and how much power it has."""

from collections.abc import Callable
from functools import cache, lru_cache
from math import gcd

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.roots import root
from cogradar.shared.power.rules import Requests
from cogradar.shared.power.wide import KEPT, sure_powers, wanted
from cogradar.shared.scenario.radar_config import RadarConfig, SearchSection
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.looks import n_range_cells
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.tracking.existence import alert_p_fa

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST = 10  # dwells of a sweep: the range of detection falls with the fourth root of the beams only
P_D = 0.8  # of a look at the end of the range
_STRONGEST = 1e9  # zeta of an echo that is found at any limit
LEAST_SHARE = 0.1  # of the power, however much the tracks need: else no new target would ever be found


Sweep = Callable[[Floats], Ints]  # how often each of some directions is searched in a sweep; (n,) -> (n,)


def _once(nus: Floats) -> Ints:
    """All directions alike."""
    return np.ones(nus.shape, np.int64)


def search_directions(
    radar: RadarConfig, search: SearchSection, first: int, power: float, times: Sweep = _once
) -> tuple[Floats, int]:
    """Directions of the search beams of a dwell, (n,) ascending, none if it goes everywhere; number of the next beam.

    A sweep makes as many visits to each bin as `times` says, one without a command. It goes in steps of the golden
    section of the field of view, so that the beams of a dwell are far apart. Every second sweep is half a bin further,
    since a target at the border of two bins is met with a sixth of its power. With "auto" it makes as many beams as the
    power allows. Each then finds the echo that the radar expects from the end of its range with a probability of P_D.
    It makes at least so many that a sweep takes LONGEST dwells at most.

    first : number of the first beam, counted from the first one of the run
    power : of the search in this dwell
    times : 0 for some direction in which there is to be no beam, not for all
    """
    if search.pattern == "isotropic":
        return np.empty(0), first
    n_bin = radar.array.n_bin
    centres = bin_centres(n_bin)
    visits = np.repeat(centres, times(centres))
    n_visit = visits.size
    n = search.beams if search.beams != "auto" else max(int(power / edge_power(radar)), -(-n_visit // LONGEST))
    numbers = first + np.arange(min(n, n_visit))
    found = visits[numbers % n_visit * _stride(n_visit) % n_visit]
    shifted = np.minimum(found + 0.5 * (numbers // n_visit % 2) / (n_bin - 1), 0.5)
    return np.unique(np.where(times(shifted) > 0, shifted, found)), first + numbers.size


def edge_power(radar: RadarConfig) -> float:
    """Power of a beam that finds the echo expected from the end of the range with probability P_D, S = 1."""
    array, prior = radar.array, radar.acquisition
    n_cell = n_range_cells(*prior.ranges_km, radar.receiver.range_cell_km)
    alpha = amplitude(amplitude_at_1_km(radar.echo.amplitude_db), np.array(prior.range_max_km**2))
    return _needed(threshold(alert_p_fa(array.n_bin), n_cell)) / (2.0 * float(alpha) ** 2 * array.n_tx * array.n_rx)


@lru_cache(maxsize=16)
def _needed(limit: float) -> float:
    """zeta at which P_D is reached."""
    return root(lambda zeta: float(detection_probability(zeta, limit)) - P_D, 0.0, _STRONGEST)


@cache
def _stride(n_bin: int) -> int:
    """The step nearest to the golden section of n bins with which each is met once."""
    wanted = 0.5 * (5.0**0.5 - 1.0) * n_bin
    return min((step for step in range(1, n_bin + 1) if gcd(step, n_bin) == 1), key=lambda step: abs(step - wanted))


def most_for_tracks(radar: RadarConfig) -> float:
    """Power that all tracks together can have."""
    if radar.search is None:
        return radar.array.power
    return radar.array.power * (1.0 - (LEAST_SHARE if radar.search.share == "auto" else float(radar.search.share)))


def search_power(radar: RadarConfig, search: SearchSection, requests: Requests | None) -> float:
    """Power of the search: its share, or what tracks do not need to be found for sure; all of it without any track.

    requests : of the tracks there are; None: of none
    """
    power = radar.array.power
    if requests is None:
        return power
    if search.share != "auto":
        return float(search.share) * power
    kept = KEPT * sure_powers(radar, requests.gains / wanted(radar, requests))
    kept = np.where(requests.fixed > 0.0, requests.fixed, kept)
    needed = float((kept * (requests.chances.sum(axis=1) > 0.0)).sum())
    return max(power - needed, LEAST_SHARE * power)
