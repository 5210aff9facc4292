"""An objective: what power-aware beams achieve. `--set radar.allocation.objective=FILE.py:equal_echoes` sets it."""

import numpy as np

from cogradar.plugins import Emission, RadarConfig, Requests, beam_factor


def equal_echoes(radar: RadarConfig, requests: Requests) -> Emission:
    """A beam for the first cell of each track, of a power that makes all echoes alike: as R^4.

    Arguments and answer are as for a strategy; this is what "power-aware" does with the power.
    """
    free = np.where(requests.fixed > 0.0, 0.0, 1.0 / requests.weights)
    left = max(radar.array.power - float(requests.fixed.sum()), 0.0)
    shares = requests.fixed + left * free / max(free.sum(), 1e-300)  # what was asked for the accuracy of a track stays
    factor = beam_factor(requests.nus[:, 0], shares, radar.array.n_tx)
    return Emission(0.0, factor, requests.nus[:, :1], shares[:, np.newaxis])
