"""How strong an echo is: the radar equation of a point target.

Symbols: alpha echo amplitude per virtual channel, R range. The disturbance has power 1, so |alpha|^2 is the
signal-to-noise ratio of one virtual channel, before any array gain.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import log10
from cogradar.shared.numerics.jit import inlined, kernel

NEAREST_SQ_KM2 = 1e-12  # a target may fly over the array itself, where the equation has no finite value

Real = TypeVar("Real", float, NDArray[np.float64])


def amplitude_at_1_km(amplitude_db: float) -> float:
    """Echo amplitude |alpha| of a target at 1 km, given 20 log10 |alpha|."""
    return float(10.0 ** (amplitude_db / 20.0))


@inlined
def amplitude(at_1_km: float | Real, range_sq: Real) -> Real:
    """Echo amplitude |alpha| = at_1_km / R^2; numbers in kernels, arrays elsewhere, broadcast.

    at_1_km  : |alpha| at 1 km, in any unit, such as the standard deviation of its estimate
    range_sq : R^2 in km^2, taken as NEAREST_SQ_KM2 where it is less
    """
    # np.divide: "/" checks for a zero denominator, a branch in every kernel's loop.
    result: Real = np.divide(at_1_km, np.maximum(range_sq, NEAREST_SQ_KM2))
    return result


@kernel
def strength(gain: float, range_sq: float, by_range: bool) -> float:
    """|alpha| / sigma at a range, R^2 in km^2, of a gain at 1 km; of targets of unknown RCS gains are at any range."""
    return amplitude(gain, range_sq) if by_range else gain


def snr_db(range_km: ArrayLike, amplitude_db: float) -> NDArray[np.float64]:
    """Signal-to-noise ratio 20 log10 |alpha| = amplitude_db - 40 log10 R, dB per virtual channel; (...) km -> (...)."""
    range_sq = np.asarray(range_km, dtype=np.float64) ** 2
    return np.asarray(20.0 * log10(amplitude(amplitude_at_1_km(amplitude_db), range_sq)))
