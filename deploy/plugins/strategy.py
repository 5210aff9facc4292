"""A strategy: how the power is spread. `cogradar run paper --strategy FILE.py:strongest` uses it."""

import numpy as np

from cogradar.plugins import Emission, RadarConfig, Requests, beam_factor


def strongest(radar: RadarConfig, requests: Requests) -> Emission:
    """All power on the nearest target.

    radar    : the table [radar]; radar.array.power is what there is to spend
    requests : of M tracks, among others nus (M, C) of the cells they ask for and ranges_km (M,)
    returns  : R = (isotropic / n_tx) I + F F^H with the factor F, the cells lit for each track, and their shares
    """
    shares = np.zeros(requests.ranges_km.size)
    shares[np.argmin(requests.ranges_km)] = radar.array.power
    factor = beam_factor(requests.nus[:, 0], shares, radar.array.n_tx)
    return Emission(0.0, factor, requests.nus[:, :1], shares[:, np.newaxis])
