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
    Cost O(n), about 20 ns a sample.
    """
    law = _MODELS[model]
    c = (_complex_t if law.heavy_tailed else _complex_normal)(n + _TRANSIENT, rng)
    _autoregress(_COEFFICIENTS[model], c)
    c = c[_TRANSIENT:]
    scale = 1.0 / np.mean(c.real**2 + c.imag**2)
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
def _autoregress(a: NDArray[np.complex128], c: NDArray[np.complex128]) -> None:
    """Replace innovations by c_n = w_n - sum_{i=1..6} a[i] c_{n-i}, in place, (n,) complex, from the seventh on.

    Written out, oldest term first, so that only one product waits for the previous sample.
    """
    a1, a2, a3, a4, a5, a6 = a[1], a[2], a[3], a[4], a[5], a[6]
    for n in range(6, c.size):
        older = (a6 * c[n - 6] + a5 * c[n - 5]) + (a4 * c[n - 4] + a3 * c[n - 3])
        c[n] = ((c[n] - older) - a2 * c[n - 2]) - a1 * c[n - 1]
