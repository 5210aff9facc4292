"""The disturbance of one resolution cell: unknown to the radar, coloured, and by default heavy-tailed.

Symbols: c_n = w_n + sum_i a_i c_{n-i}, autoregressive; A(z) = prod_i (1 - p_i z^-1) with poles p_i; w_n innovations;
S_c(nu) power spectrum. Poles of Lisi et al. (arXiv 2112.02628).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.jit import kernel

# (modulus, angle / 2 pi) of each pole
_AR6 = ((0.5, -0.4), (0.6, -0.2), (0.7, 0.0), (0.4, 0.1), (0.5, 0.3), (0.6, 0.35))
_AR3 = ((0.5, 0.0), (0.3, -0.1), (0.4, 0.05))
_MAX_ORDER = 6
_TRANSIENT = 128  # samples; the slowest pole leaves 0.7^128 = 1e-20 of the start
_LANES = 8  # stretches of a vector that are filtered side by side
_ROW = 2 * _LANES  # their real parts, then their imaginary parts


class _Model(NamedTuple):
    """A disturbance: its poles, the law of its innovations, and whether one texture scales the whole vector."""

    poles: tuple[tuple[float, float], ...]
    heavy_tailed: bool
    textured: bool

    def coefficients(self) -> NDArray[np.complex128]:
        """Coefficients 1, -a_1 .. -a_6 of A(z), (7,) complex; zero above the model's own order."""
        poles = [modulus * np.exp(2j * np.pi * turns) for modulus, turns in self.poles]
        padded = np.zeros(_MAX_ORDER + 1, dtype=np.complex128)
        padded[: len(poles) + 1] = np.poly(poles)
        return padded


_MODELS = {
    "ar6-t": _Model(_AR6, heavy_tailed=True, textured=False),
    "ar3-t": _Model(_AR3, heavy_tailed=True, textured=False),
    "compound-ar6": _Model(_AR6, heavy_tailed=False, textured=True),
    "white": _Model((), heavy_tailed=False, textured=False),
}
_COEFFICIENTS = {name: model.coefficients() for name, model in _MODELS.items()}


def draw(model: str, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Disturbance of one cell and dwell, (n,) complex.

        c_n = w_n + sum_i a_i c_{n-i},   c <- sqrt(tau) c / sqrt(mean |c|^2)

    "ar6-t", "ar3-t" : w complex t, CN(0, 1) / sqrt(Gamma(2, 1)); tau = 1: each vector has sample power 1
    "white"          : w complex Gaussian, no poles; tau = 1
    "compound-ar6"   : w complex Gaussian; one texture tau per vector, mean 1
    Cost O(n), about 15 ns a sample.
    """
    law = _MODELS[model]
    whole = _LANES * -(-n // _LANES)
    w = (_complex_t if law.heavy_tailed else _complex_normal)(_TRANSIENT + whole, rng)
    c = _autoregress(_COEFFICIENTS[model], w)[:n]
    scale = n / np.sum(np.square(c.view(np.float64)))
    if law.textured:
        # Only the speckle has sample power 1: rescaling the product would divide the texture out again. Inverse-gamma
        # (gamma would give K-distributed clutter) makes the vector multivariate complex t with 4 degrees of freedom:
        # the marginal law of the t innovations, but with all samples of a cell large or small together.
        scale /= rng.standard_gamma(2.0)
    c *= np.sqrt(scale)
    return c


def power_spectrum(model: str, nu: ArrayLike) -> NDArray[np.float64]:
    """Power spectrum S_c(nu) = 1 / |A(e^{j 2 pi nu})|^2, normalised to mean 1; (...) -> (...).

    The mean over 512 points of a period is exact to rounding: the spectrum's Fourier series falls off as 0.7^|m|.
    """
    a = _COEFFICIENTS[model]
    return np.asarray(_inverse_square(a, nu) / np.mean(_inverse_square(a, np.arange(512) / 512)))


def _inverse_square(a: NDArray[np.complex128], nu: ArrayLike) -> NDArray[np.float64]:
    response = np.exp(-2j * np.pi * np.multiply.outer(nu, np.arange(len(a)))) @ a
    return np.asarray(1.0 / (response.real**2 + response.imag**2))


def _complex_normal(n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Independent CN(0, 2), (n,) complex; the level is normalised later."""
    return rng.standard_normal(2 * n).view(np.complex128)


def _complex_t(n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Independent CN(0, 1) / sqrt(Gamma(shape 2, scale 1)), (n,) complex."""
    w = np.empty(n, dtype=np.complex128)
    filled = 0
    while filled < n:
        # pi/4 of the points fall into the disc, so 1.4 per sample are all but always enough.
        points = rng.random((int(1.4 * (n - filled)) + 32, 2))
        filled += _fill_complex_t(points, w[filled:])
    return w


@kernel
def _fill_complex_t(points: NDArray[np.float64], w: NDArray[np.complex128]) -> int:
    """Turn uniform points of the unit square into complex t variates w[:end]; returns end.

        w = z g(s),   z uniform in the unit disc,  s = |z|^2 uniform,  g^2 = (s^{-1/2} - 1) / s

    Bailey (1994), "Polar generation of random variates with the t-distribution": |w|^2 = E / G with E exponential and
    G ~ Gamma(2, 1) has P(|w|^2 > x) = E[exp(-x G)] = (1 + x)^{-2}, so s^{-1/2} - 1 has its law; the angle is z's own.
    """
    # Points in the disc, in order. Always stored, kept by moving on: a branch would be mispredicted at every fifth.
    end = 0
    for i in range(points.shape[0]):
        if end == w.size:
            break
        x, y = 2.0 * points[i, 0] - 1.0, 2.0 * points[i, 1] - 1.0
        s = x * x + y * y
        w[end] = complex(x, y)
        end += (s < 1.0) and (s > 0.0)
    # Their moduli. np.divide and not "/", whose check for a zero denominator keeps the loop from being vectorised.
    for i in range(end):
        s = w[i].real * w[i].real + w[i].imag * w[i].imag
        r = np.sqrt(s)
        w[i] = w[i] * np.sqrt(np.divide(1.0 - r, s * r))
    return end


@kernel
def _autoregress(a: NDArray[np.complex128], w: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """c_n = w_n - sum_{i=1..6} a[i] c_{n-i}, without the transient: (_TRANSIENT + n,) -> (n,), n a multiple of _LANES.

    A recursion waits for its previous sample, so the vector is cut into stretches that advance together, one per lane
    of the vector instructions. Each starts from rest _TRANSIENT innovations early: the same c, to rounding.
    """
    n_step = (w.size - _TRANSIENT) // _LANES
    b = np.empty(_ROW * (_TRANSIENT + n_step))
    for n in range(_TRANSIENT + n_step):
        for lane in range(_LANES):
            b[_ROW * n + lane] = w[n_step * lane + n].real
            b[_ROW * n + lane + _LANES] = w[n_step * lane + n].imag
    _recurse(a.real.copy(), a.imag.copy(), b)
    c = np.empty(w.size - _TRANSIENT, dtype=np.complex128)
    for n in range(n_step):
        for lane in range(_LANES):
            i = _ROW * (_TRANSIENT + n) + lane
            c[n_step * lane + n] = complex(b[i], b[i + _LANES])
    return c


@kernel
def _recurse(a: NDArray[np.float64], b: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Filter rows of lanes in place, (n_row * _ROW,), coefficients a + j b.

    Written out, with unsigned indices into one array: only so does the compiler see that lanes do not overlap and
    vectorise them. Oldest terms first, so that only one product waits for the previous row.
    """
    a1, a2, a3, a4, a5, a6 = a[1], a[2], a[3], a[4], a[5], a[6]
    b1, b2, b3, b4, b5, b6 = b[1], b[2], b[3], b[4], b[5], b[6]
    row, imag = np.uint64(_ROW), np.uint64(_LANES)
    for n in range(_MAX_ORDER, rows.size // _ROW):
        for lane in range(_LANES):
            r0 = np.uint64(_ROW * n + lane)
            r1, r2, r3 = r0 - row, r0 - np.uint64(2) * row, r0 - np.uint64(3) * row
            r4, r5, r6 = r0 - np.uint64(4) * row, r0 - np.uint64(5) * row, r0 - np.uint64(6) * row
            i0, i1, i2, i3, i4, i5, i6 = r0 + imag, r1 + imag, r2 + imag, r3 + imag, r4 + imag, r5 + imag, r6 + imag
            re = (a6 * rows[r6] - b6 * rows[i6]) + (a5 * rows[r5] - b5 * rows[i5])
            im = (a6 * rows[i6] + b6 * rows[r6]) + (a5 * rows[i5] + b5 * rows[r5])
            re += (a4 * rows[r4] - b4 * rows[i4]) + (a3 * rows[r3] - b3 * rows[i3])
            im += (a4 * rows[i4] + b4 * rows[r4]) + (a3 * rows[i3] + b3 * rows[r3])
            re = ((rows[r0] - re) - (a2 * rows[r2] - b2 * rows[i2])) - (a1 * rows[r1] - b1 * rows[i1])
            im = ((rows[i0] - im) - (a2 * rows[i2] + b2 * rows[r2])) - (a1 * rows[i1] + b1 * rows[r1])
            rows[r0], rows[i0] = re, im
