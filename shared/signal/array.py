"""The arrays and the grid of angle bins.

Symbols: nu = 0.5 sin(theta) spatial frequency of direction theta from boresight; a(nu) steering vector of a
half-wavelength uniform linear array; x boresight, y along the array.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# What a track remembers of a dwell with steered looks: these many of them, with what they have in common.
KEPT_LOOKS = 16
LOOKS_ROW = 3 + 2 * KEPT_LOOKS  # numbers: limit and gate, directions, standard deviations


def bin_centres(n_bin: int) -> NDArray[np.float64]:
    """Spatial frequencies of the bin centres, (n_bin,), equally spaced over [-0.5, 0.5], ends included.

    Their spacing is 1/(n_bin - 1): neighbouring steering vectors are nearly, not exactly, orthogonal, and bins 0 and
    n_bin - 1 are one direction (grating).
    """
    return np.linspace(-0.5, 0.5, n_bin)


def steering_vector(nu: ArrayLike, n: int) -> NDArray[np.complex128]:
    """Steering vectors a(nu)_i = exp(j 2 pi nu i), i = 0 .. n-1; (...) -> (..., n) complex."""
    vectors: NDArray[np.complex128] = np.exp(2j * np.pi * np.multiply.outer(nu, np.arange(n)))
    return vectors


def spatial_frequency(states: ArrayLike) -> NDArray[np.float64]:
    """Spatial frequency nu = 0.5 sin(atan2(y, x)) = 0.5 y / R of states [x, vx, y, vy], (..., 4) -> (...).

    0 at the array itself, as atan2 has it; NaN of NaN.
    """
    s = np.asarray(states, dtype=np.float64)
    r = np.hypot(s[..., 0], s[..., 2])
    return np.asarray(np.divide(0.5 * s[..., 2], r, out=np.zeros_like(r), where=r != 0.0))


def angle_bin(nu: ArrayLike, n_bin: int) -> NDArray[np.int64]:
    """Index of the bin whose centre is nearest to nu, 0 .. n_bin-1; (...) -> (...)."""
    return np.floor((np.asarray(nu) + 0.5) * (n_bin - 1) + 0.5).astype(np.int64)
