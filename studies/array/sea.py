"""A stand-in for recorded I/Q of the sea: correlated noise and a strong line, both with an impulsive texture.

Of range cell i in a dwell, n_tx = n_rx = N:

    Y_i = sqrt(tau_i) (C_i + g_i a(nu_0) a(nu_0)^T),    1 / tau_i ~ Gamma(2, 1),    g_i ~ CN(0, 10^(dB / 10))

C_i : noise of power 1, a first-order autoregression along the receive array, independent between transmit channels

The line is coherent along both arrays, as the echo of a target would be. Its gain and the texture change from range
cell to range cell and from dwell to dwell.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import steering_vector

AXES = ("dwell", "range", "tx", "rx")
N, N_RANGE = 20, 64  # antennas of each array, range cells
LINE_NU, LINE_DB = 0.1892, 20.0  # beside a look's axis: its neighbours hear the line, too
_POLE = 0.6 * np.exp(0.2j * np.pi)

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]


class Sea(NamedTuple):
    """The range cells of a dwell."""

    y: Complexes  # (n, N, N)
    texture: Floats  # (n,) tau


def dwells(n: int, seed: int = 1) -> Iterator[Sea]:
    """The dwells of a recording, one by one."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        plain, texture = untextured(rng, N_RANGE), 1.0 / rng.standard_gamma(2.0, N_RANGE)
        yield Sea(np.sqrt(texture)[:, np.newaxis, np.newaxis] * plain, texture)


def untextured(rng: np.random.Generator, n: int) -> Complexes:
    """Noise and line of n range cells with a texture of 1, (n, N, N)."""
    noise = _normal(rng, (n, N, N))
    for i in range(1, N):
        noise[:, :, i] = np.sqrt(1.0 - abs(_POLE) ** 2) * noise[:, :, i] + _POLE * noise[:, :, i - 1]
    gains, a = 10.0 ** (LINE_DB / 20.0) * _normal(rng, (n,)), steering_vector(LINE_NU, N)
    return np.asarray(noise + np.multiply.outer(gains, np.outer(a, a)), np.complex128)


def write(file: Path, n: int, seed: int = 1) -> Floats:
    """Write a recording of n dwells as .npy with the axes AXES; returns the texture, (n, N_RANGE)."""
    file.parent.mkdir(parents=True, exist_ok=True)
    data = np.lib.format.open_memmap(file, "w+", np.complex64, (n, N_RANGE, N, N))
    textures = np.empty((n, N_RANGE))
    for k, dwell in enumerate(dwells(n, seed)):
        data[k], textures[k] = dwell
    data.flush()
    return textures


def _normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Complexes:
    """CN(0, 1)."""
    return np.asarray(np.sqrt(0.5) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)), np.complex128)
