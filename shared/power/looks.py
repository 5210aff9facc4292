"""What is radiated for cells and powers that are chosen together, and the objective of most detections."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.curve import Curve, curve_of
from cogradar.shared.power.joint import most_detections
from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.power.wide import wanted, widened
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import beam_factor

# Below, a cell beside a track's first one stays dark: what it adds to the detections is less than what its power adds,
# on the first one, to what is known of the range.
LEAST_CHANCE = 0.01


class First(NamedTuple):
    """A cell that gets its power before all others are weighed."""

    track: int
    column: int  # of the track's cells
    power: float  # less than all of it


def detections(radar: RadarConfig, requests: Requests) -> Emission:
    """Most detections expected now, over all cells that tracks ask for."""
    return emitted(radar, requests, requests.chances, np.ones(requests.chances.shape, dtype=np.bool_))


def emitted(
    radar: RadarConfig,
    requests: Requests,
    worths: NDArray[np.float64],
    is_open: NDArray[np.bool_],
    given: First | None = None,
) -> Emission:
    """The waveform of the greatest sum of worths of detections in open cells, with further cells of their tracks.

    worths  : (M, C) of a detection if the target is in the cell, times the chance that it is; of tracks alike in
              priority
    is_open : (M, C), the others are dark
    given   : a cell that is lit whatever its worth
    """
    array = radar.array
    shares = np.zeros(requests.chances.shape)
    shares[:, 0] = np.where(is_open[:, 0], requests.fixed, 0.0)
    is_fixed = shares[:, 0] > 0.0
    given = None if given is None or is_fixed[given.track] else given
    pays = requests.chances > LEAST_CHANCE
    pays[:, 0] = True
    rows, columns = np.nonzero(pays & is_open & ~is_fixed[:, np.newaxis])
    of_given = 0.0 if given is None else given.power
    left = array.power - shares.sum() - of_given
    is_optimal = True
    if rows.size:
        times = wanted(radar, requests)
        worths = worths * (requests.priorities * times)[:, np.newaxis]  # of power: by the priority
        bought = most_detections(_curve(radar), worths[rows, columns], (requests.gains / times)[rows], left)
        shares[rows, columns], is_optimal = bought.powers, bought.is_optimal
    else:  # all have what they asked for
        shares *= (array.power - of_given) / shares.sum()
    if given is not None:
        shares[given.track, given.column] += given.power
    order = np.argsort(-shares, axis=1, kind="stable")
    shares = np.take_along_axis(shares, order, axis=1)
    is_lit = shares > 0.0
    nus = np.where(is_lit, np.take_along_axis(requests.nus, order, axis=1), np.nan)
    n = max(int(is_lit.sum(axis=1).max()), 1)  # the search may have taken all power: then no cell is lit
    factor = beam_factor(nus[is_lit], shares[is_lit], array.n_tx)
    status = "optimal" if is_optimal else "inaccurate"
    sent = Emission(0.0, factor, nus[:, :n].copy(), shares[:, :n].copy(), status)
    return widened(radar, requests, sent)


def _curve(radar: RadarConfig) -> Curve:
    """P_D as the radar's assumption of the RCS has it."""
    return curve_of(threshold(radar.detector.p_fa), "constant" if radar.assumes.rcs == "known" else "swerling1")
