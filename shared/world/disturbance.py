"""The disturbance of one resolution cell: unknown to the radar, coloured, and by default heavy-tailed.

Symbols: c_n = w_n + sum_i a_i c_{n-i}, autoregressive; A(z) = prod_i (1 - p_i z^-1) with poles p_i; w_n innovations;
S_c(nu) power spectrum. Poles of Lisi et al. (arXiv 2112.02628).
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import times
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import polynomial
from cogradar.shared.scenario.plugins.kinds import DISTURBANCE
from cogradar.shared.scenario.plugins.names import PluginRefused
from cogradar.shared.scenario.plugins.resolver import Caller, resolve

# (modulus, angle / 2 pi) of each pole
_AR6 = ((0.5, -0.4), (0.6, -0.2), (0.7, 0.0), (0.4, 0.1), (0.5, 0.3), (0.6, 0.35))
_AR3 = ((0.5, 0.0), (0.3, -0.1), (0.4, 0.05))
_MAX_ORDER = 6
_TRANSIENT = 128  # samples; the slowest pole leaves 0.7^128 = 1e-20 of the start
_LANES = 8  # stretches of a vector that are filtered side by side
_ROW = 2 * _LANES  # their real parts, then their imaginary parts
_COLUMNS = 64  # partial sums that are kept side by side


class Disturbance(Protocol):
    """What a disturbance model can do; `cogradar.shared.scenario.tables.DISTURBANCES` has the built-in ones."""

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
        """Disturbance of one cell and dwell, (n,) complex, power 1."""

    def power_spectrum(self, nu: ArrayLike) -> NDArray[np.float64]:
        """Power spectrum S_c(nu), normalised to mean 1; (...) -> (...)."""


def draw(model: str, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Disturbance of one cell and dwell under the model of this name, (n,) complex."""
    return _of_name(model).draw(n, rng)


def power_spectrum(model: str, nu: ArrayLike) -> NDArray[np.float64]:
    """Power spectrum S_c(nu) of the model of this name, normalised to mean 1; (...) -> (...)."""
    return _of_name(model).power_spectrum(nu)


def levels(model: str, nus: Sequence[float]) -> list[float]:
    """S_c of each of these directions, (n,), as of one alone; together they take a fraction of the time."""
    found = _of_name(model)
    if isinstance(found, Autoregressive):
        return found.levels(nus)
    return [float(found.power_spectrum(nu)) for nu in nus]


def _of_name(model: str) -> Disturbance:
    found: Disturbance = resolve(DISTURBANCE, model)
    return found


class _Guarded:
    """A user's own model, which draws what can be received."""

    def __init__(self, model: Any, call: Caller) -> None:
        self._model, self._call = model, call

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
        drawn = np.asarray(self._call(self._model.draw, n, rng))
        if drawn.shape != (n,) or drawn.dtype.kind not in "fc" or not np.isfinite(drawn).all():
            raise self._call.failed(
                f"drew {drawn.dtype} of shape {drawn.shape}: must be ({n},) complex numbers, all finite"
            )
        return drawn.astype(np.complex128)

    def power_spectrum(self, nu: ArrayLike) -> NDArray[np.float64]:
        spectrum = np.asarray(self._call(self._model.power_spectrum, nu))
        if spectrum.shape != np.shape(nu) or spectrum.dtype.kind not in "iuf" or not (spectrum >= 0.0).all():
            raise self._call.failed(
                f"has a spectrum of {spectrum.dtype}, shape {spectrum.shape}: must be {np.shape(nu)} numbers from 0"
            )
        return spectrum.astype(np.float64)


def guarded(model: Any, call: Caller) -> Disturbance:
    """A user's own model, or what makes one. Raises PluginRefused if it lacks a method."""
    made = call(model) if isinstance(model, type) else model
    for method in ("draw", "power_spectrum"):
        if not callable(getattr(made, method, None)):
            raise PluginRefused(f"{call.short}: a disturbance needs the method {method}, which it has not")
    return _Guarded(made, call)


def _response(a: NDArray[np.complex128], nu: ArrayLike) -> Any:
    return np.sum(times(np.exp(-2j * np.pi * np.multiply.outer(nu, np.arange(len(a)))), a), axis=-1)


def _inverse_square(a: NDArray[np.complex128], nu: ArrayLike) -> NDArray[np.float64]:
    response = _response(a, nu)
    return np.asarray(1.0 / (response.real**2 + response.imag**2))


class Autoregressive:
    """The built-in models.

        c_n = w_n + sum_i a_i c_{n-i},   c <- sqrt(tau) c / sqrt(mean |c|^2)

    heavy_tailed : w complex t, CN(0, 1) / sqrt(Gamma(2, 1)), else complex Gaussian
    textured     : one texture tau per vector, mean 1; else tau = 1: each vector has sample power 1
    """

    def __init__(self, poles: tuple[tuple[float, float], ...], *, heavy_tailed: bool, textured: bool) -> None:
        self._heavy_tailed, self._textured = heavy_tailed, textured
        coefficients = polynomial([modulus * np.exp(2j * np.pi * turns) for modulus, turns in poles])
        self._a = np.zeros(_MAX_ORDER + 1, dtype=np.complex128)  # 1, -a_1 .. -a_6 of A(z); zero above its own order
        self._a[: len(poles) + 1] = coefficients
        self._mean = float(np.mean(_inverse_square(self._a, np.arange(512) / 512)))  # of the spectrum

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
        """Disturbance of one cell and dwell, (n,) complex. Cost O(n), about 6 ns a sample."""
        w = np.empty((2, _LANES * (_TRANSIENT - (-n // _LANES))))
        (_draw_complex_t if self._heavy_tailed else _draw_complex_normal)(w, rng)
        c = _autoregress(self._a, w)[:n]
        # Only the speckle has sample power 1: rescaling the product would divide the texture out again. Inverse-gamma
        # (gamma would give K-distributed clutter) makes the vector multivariate complex t with 4 degrees of freedom:
        # the marginal law of the t innovations, but with all samples of a cell large or small together.
        _normalise(c, 1.0 / rng.standard_gamma(2.0) if self._textured else 1.0)
        return c

    def power_spectrum(self, nu: ArrayLike) -> NDArray[np.float64]:
        """Power spectrum S_c(nu) = 1 / |A(e^{j 2 pi nu})|^2, normalised to mean 1; (...) -> (...).

        The mean over 512 points of a period is exact to rounding: the spectrum's Fourier series falls off as 0.7^|m|.
        """
        return np.asarray(_inverse_square(self._a, nu) / self._mean)

    def levels(self, nus: Sequence[float]) -> list[float]:
        """`levels`. The square of a number is rounded as its power is, now and then not as the square of an array."""
        responses = _response(self._a, nus)
        return [float(1.0 / (one.real**2 + one.imag**2) / self._mean) for one in responses]


class Recorded:
    """Of a file (`cogradar.shared.signal.recording`): the world of an array cuts it, nothing is drawn."""

    def draw(self, n: int, rng: np.random.Generator) -> NDArray[np.complex128]:  # noqa: ARG002 - of the protocol
        """It cannot be drawn."""
        raise ValueError("a recorded disturbance is cut out of its file")

    def power_spectrum(self, nu: ArrayLike) -> NDArray[np.float64]:
        """1: what is predicted is white noise's with the recording's mean power; (...) -> (...)."""
        return np.ones_like(np.asarray(nu, dtype=np.float64))


AR6_T = Autoregressive(_AR6, heavy_tailed=True, textured=False)
AR3_T = Autoregressive(_AR3, heavy_tailed=True, textured=False)
COMPOUND_AR6 = Autoregressive(_AR6, heavy_tailed=False, textured=True)
WHITE = Autoregressive((), heavy_tailed=False, textured=False)
RECORDED = Recorded()


def _draw_complex_normal(w: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Real and imaginary parts of independent CN(0, 2), (2, n); the level is normalised later."""
    rng.standard_normal(out=w)


def _draw_complex_t(w: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Real and imaginary parts of independent CN(0, 1) / sqrt(Gamma(shape 2, scale 1)), (2, n)."""
    words = np.asarray(rng.bit_generator.random_raw(w.shape[1]), dtype=np.uint64)
    _to_complex_t(words, w[0], w[1])


@kernel
def _to_complex_t(words: NDArray[np.uint64], re: NDArray[np.float64], im: NDArray[np.float64]) -> None:
    """Turn random words of 64 bits into complex t variates w = re + j im, one each; all (n,).

        |w|^2 = u^{-1/2} - 1,   u uniform in (0, 1), the upper 40 bits
        arg w = a quadrant, 2 bits, + pi/4 + psi,   psi uniform in (-pi/4, pi/4), 22 bits

    |w|^2 = E / G with E exponential and G ~ Gamma(2, 1) has P(|w|^2 > x) = E[exp(-x G)] = (1 + x)^{-2}. The largest
    modulus that 40 bits allow is 1200; one sample in 10^12 would exceed it. Sine and cosine of psi are Taylor sums, to
    7e-12: no library call, no branch, so that the loop is vectorised. Of the 0.16 ms of a cell this saves 0.10 ms
    against the polar method and 0.25 ms against the library's sine and cosine.
    """
    for i in range(words.size):
        word = words[i]
        u = (float(np.int64(word >> np.uint64(24))) + 0.5) * 2.0**-40
        psi = (float(np.int64(word >> np.uint64(2) & np.uint64(0x3FFFFF))) - (2.0**21 - 0.5)) * (np.pi / 2.0**23)
        sign_x = 1.0 - 2.0 * float(np.int64(word & np.uint64(1)))
        sign_y = 1.0 - float(np.int64(word & np.uint64(2)))
        p = psi * psi
        sine = psi * (1 + p * (-1 / 6 + p * (1 / 120 + p * (-1 / 5040 + p * (1 / 362880 + p * (-1 / 39916800))))))
        cosine = 1 + p * (
            -1 / 2 + p * (1 / 24 + p * (-1 / 720 + p * (1 / 40320 + p * (-1 / 3628800 + p * (1 / 479001600)))))
        )
        # cos(pi/4 + psi) = (cosine - sine) / sqrt 2, sin(pi/4 + psi) = (cosine + sine) / sqrt 2.
        # np.divide and not "/", whose check for a zero denominator is a branch.
        root = np.sqrt(u)
        r = np.sqrt(np.divide(0.5 - 0.5 * root, root))
        re[i] = sign_x * (r * (cosine - sine))
        im[i] = sign_y * (r * (cosine + sine))


@kernel
def _autoregress(a: NDArray[np.complex128], w: NDArray[np.float64]) -> NDArray[np.complex128]:
    """c_n = w_n - sum_{i=1..6} a[i] c_{n-i}, without the transient; returns (n_step * _LANES,) complex.

    w : (2, (_TRANSIENT + n_step) * _LANES) real and imaginary parts, step by step, one of each lane per step

    A recursion waits for its previous sample, so the vector is cut into stretches that advance together, one per lane
    of the vector instructions. Each starts from rest with the last _TRANSIENT innovations of the stretch before it
    (its own are not used): the same c, to rounding, as one recursion through lane after lane. One recursion would take
    0.03 ms more of the 0.16 ms of a cell, 3 ms of a dwell that tests 100 cells.
    """
    n_row = w.shape[1] // _LANES
    n_step = n_row - _TRANSIENT
    rows, w_re, w_im = np.empty(_ROW * n_row), w[0], w[1]
    for n in range(n_row):
        for lane in range(_LANES):
            rows[_ROW * n + lane] = w_re[_LANES * n + lane]
            rows[_ROW * n + _LANES + lane] = w_im[_LANES * n + lane]
    for lane in range(1, _LANES):
        for n in range(_TRANSIENT):
            rows[_ROW * n + lane] = rows[_ROW * (n_step + n) + lane - 1]
            rows[_ROW * n + lane + _LANES] = rows[_ROW * (n_step + n) + lane - 1 + _LANES]
    _recurse(a.real.copy(), a.imag.copy(), rows)
    c = np.empty(_LANES * n_step, dtype=np.complex128)
    for n in range(n_step):
        for lane in range(_LANES):
            i = _ROW * (_TRANSIENT + n) + lane
            c[n_step * lane + n] = complex(rows[i], rows[i + _LANES])
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


@kernel
def _normalise(c: NDArray[np.complex128], power: float) -> None:
    """Scale c to mean |c_n|^2 = power, in place.

    In partial sums, as each addition to a single one would wait for the last: that saves 0.013 ms of a cell's 0.16.
    """
    x = c.view(np.float64)
    partial = np.zeros(_COLUMNS)
    whole = x.size - x.size % _COLUMNS
    for n in range(0, whole, _COLUMNS):
        for column in range(_COLUMNS):
            partial[column] += x[n + column] * x[n + column]
    for n in range(whole, x.size):
        partial[0] += x[n] * x[n]
    scale = np.sqrt(power * c.size / np.sum(partial))
    for n in range(x.size):
        x[n] *= scale
