"""Slow, obvious versions of what looks in any direction tell, for the tests."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.response import LobeResponse
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.sensor import Sensor
from tests.oracles.belief import hit_probability, miss_probability


def response(n: int, d: float) -> float:
    """What an array of n antennas, pointed at 0, has of an echo from d: the length of the mean of n phasors."""
    return float(abs(np.exp(2j * np.pi * d * np.arange(n)).mean()))


def likelihood(states: NDArray[np.float64], looks: Looks, sensor: Sensor) -> NDArray[np.float64]:
    """P(looks | state), one state and one look at a time."""
    aperture = looks.response
    assert isinstance(aperture, LobeResponse)
    values, limited = np.ones(len(states)), sensor._replace(threshold=looks.limit)
    for i, (x, _, y, _) in enumerate(states):
        range_km, nu = np.hypot(x, y), 0.5 * y / np.hypot(x, y)
        if not looks.low_km <= range_km < looks.high_km:
            values[i] = 0.0 if looks.is_hit else 1.0
            continue
        for c, (nu_c, sigma) in enumerate(zip(looks.nus, looks.sigma, strict=True)):
            d = abs(nu - nu_c)
            lost = response(aperture.n_tx, d) * response(aperture.n_rx, d)
            u = np.array([10 ** (sensor.amplitude_db / 20) / range_km**2 / sigma * lost * (d < 1 / aperture.n_rx)])
            if c == looks.hit:
                values[i] *= hit_probability(looks.amplitude, limited, u)[0]
            elif d < 1 / aperture.n_rx:
                values[i] *= miss_probability(looks.limit, u)[0]
        if looks.is_hit and looks.nu_sigma > 0.0:
            values[i] *= np.exp(-0.5 * ((nu - looks.nu_hat) / looks.nu_sigma) ** 2)
        if looks.is_hit and looks.range_km > 0.0:
            values[i] *= abs(range_km - looks.range_km) < 0.5 * aperture.range_cell_km
    return values
