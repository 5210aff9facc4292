"""How strong an echo is: the radar equation of a point target.

Symbols: alpha echo amplitude per virtual channel, R range. The disturbance has power 1, so |alpha|^2 is the
signal-to-noise ratio of one virtual channel, before any array gain.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

NEAREST_KM = 1e-6


def amplitude(range_km: ArrayLike, amplitude_db: float) -> NDArray[np.float64]:
    """Echo amplitude |alpha| = 10^(amplitude_db / 20) / R^2, (...) km -> (...).

    amplitude_db : 20 log10|alpha| of a target at 1 km
    """
    return float(10.0 ** (amplitude_db / 20.0)) / _from(range_km) ** 2


def snr_db(range_km: ArrayLike, amplitude_db: float) -> NDArray[np.float64]:
    """Signal-to-noise ratio 20 log10|alpha| = amplitude_db - 40 log10 R, dB per virtual channel; (...) km -> (...)."""
    return amplitude_db - 40.0 * np.log10(_from(range_km))


def _from(range_km: ArrayLike) -> NDArray[np.float64]:
    """Range of a target that may fly over the array itself: the equation would have it infinitely strong there."""
    return np.maximum(np.asarray(range_km, dtype=np.float64), NEAREST_KM)
