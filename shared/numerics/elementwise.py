"""Functions of arrays that give the same bytes on every processor (ADR 42).

NumPy and SciPy choose a code for each processor, and the codes round apart. Here a compiled loop calls the C library,
whose functions agree wherever a processor has fused multiply-add, or sums a series of its own. Nothing is contracted:
the compiler fuses a product and a sum only where `fastmath` allows it, and no kernel does.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics import moduli
from cogradar.shared.numerics.error_function import erfc
from cogradar.shared.numerics.jit import inlined, kernel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

hypot = inlined(moduli.hypot)  # the same, also in kernels
squared_modulus = inlined(moduli.squared_modulus)
modulus = inlined(moduli.modulus)

_EXP, _EXPM1, _LOG, _LOG10, _LOG1P, _TAN, _ARCSIN, _NDTR, _NDTRI, _I0E, _I1E = range(11)
_LARGEST = 709.782712893384  # whose exponential is finite
_SERIES = 20.0  # up to here Bessel functions are summed from 0, and from infinity above
_EPS = 2.0**-54
# Wichura 1988, "Algorithm AS 241": numerator and denominator, highest power first, of three intervals.
_CENTRE = (
    (2509.0809287301227, 33430.57558358813, 67265.7709270087, 45921.95393154987),
    (13731.69376550946, 1971.5909503065513, 133.14166789178438, 3.3871328727963665),
    (5226.495278852854, 28729.085735721943, 39307.89580009271, 21213.794301586597),
    (5394.196021424751, 687.1870074920579, 42.31333070160091, 1.0),
)
_TAIL = (
    (0.0007745450142783414, 0.022723844989269184, 0.2417807251774506, 1.2704582524523684),
    (3.6478483247632045, 5.769497221460691, 4.630337846156546, 1.4234371107496835),
    (1.0507500716444169e-09, 0.0005475938084995345, 0.015198666563616457, 0.14810397642748008),
    (0.6897673349851, 1.6763848301838038, 2.053191626637759, 1.0),
)
_FAR = (
    (2.0103343992922881e-07, 2.7115555687434876e-05, 0.0012426609473880784, 0.026532189526576124),
    (0.29656057182850487, 1.7848265399172913, 5.463784911164114, 6.657904643501103),
    (2.0442631033899397e-15, 1.421511758316446e-07, 1.8463183175100548e-05, 0.0007868691311456133),
    (0.014875361290850615, 0.1369298809227358, 0.599832206555888, 1.0),
)
_RATIONAL = np.array([_CENTRE, _TAIL, _FAR]).reshape(3, 2, 8)


def exp(x: ArrayLike) -> Floats:
    """Exponential of real numbers; (...) -> (...)."""
    return _each(_EXP, x)


def expm1(x: ArrayLike) -> Floats:
    """exp(x) - 1 without loss of digits near 0; (...) -> (...)."""
    return _each(_EXPM1, x)


def log(x: ArrayLike) -> Floats:
    """Natural logarithm, -inf of 0 and NaN below; (...) -> (...)."""
    return _each(_LOG, x)


def log10(x: ArrayLike) -> Floats:
    """Logarithm to base 10, -inf of 0 and NaN below; (...) -> (...)."""
    return _each(_LOG10, x)


def log1p(x: ArrayLike) -> Floats:
    """log(1 + x) without loss of digits near 0; (...) -> (...)."""
    return _each(_LOG1P, x)


def tan(x: ArrayLike) -> Floats:
    """Tangent; (...) -> (...)."""
    return _each(_TAN, x)


def arcsin(x: ArrayLike) -> Floats:
    """Arc sine, NaN outside of [-1, 1]; (...) -> (...)."""
    return _each(_ARCSIN, x)


def ndtr(x: ArrayLike) -> Floats:
    """Distribution function of the standard normal distribution; (...) -> (...)."""
    return _each(_NDTR, x)


def ndtri(p: ArrayLike) -> Floats:
    """Quantile of the standard normal distribution, NaN outside of [0, 1]; (...) -> (...)."""
    return _each(_NDTRI, p)


def i0e(x: ArrayLike) -> Floats:
    """exp(-x) I_0(x), modified Bessel function of order 0, of x >= 0; (...) -> (...)."""
    return _each(_I0E, x)


def i1e(x: ArrayLike) -> Floats:
    """exp(-x) I_1(x), modified Bessel function of order 1, of x >= 0; (...) -> (...)."""
    return _each(_I1E, x)


def power(base: ArrayLike, exponent: ArrayLike) -> Floats:
    """base^exponent of bases >= 0; broadcasts."""
    bases, exponents = np.broadcast_arrays(np.asarray(base, np.float64), np.asarray(exponent, np.float64))
    found = np.empty(bases.shape)
    _powers(bases.flatten(), exponents.flatten(), found.reshape(-1))  # copies: what is broadcast cannot be written to
    return found[()]


def times(a: ArrayLike, b: ArrayLike) -> Complexes:
    """Elementwise product of complex numbers, by their parts; broadcasts."""
    a, b = np.asarray(a, np.complex128), np.asarray(b, np.complex128)
    found = np.empty(np.broadcast_shapes(a.shape, b.shape), np.complex128)
    found.real = a.real * b.real - a.imag * b.imag
    found.imag = a.real * b.imag + a.imag * b.real
    return found


@kernel
def whole_power(z: complex, n: int) -> complex:
    """z^n, n >= 0, also in kernels: `**` asks the C library for the modulus, which differs between processors."""
    if n == 0:
        return 1.0 + 0.0j
    if n == 2:
        return z * z
    size, turn = math.pow(_exact_modulus(abs(z.real), abs(z.imag)), n), math.atan2(z.imag, z.real) * n
    return complex(size * math.cos(turn), size * math.sin(turn))


@kernel
def _exact_modulus(x: float, y: float) -> float:
    """sqrt(x^2 + y^2) of x, y >= 0, not both 0, to less than a unit in the last place (Borges 2019)."""
    large, small = max(x, y), min(x, y)
    found = math.sqrt(large * large + small * small)
    if found <= 2.0 * small:
        over = found - small
        error = large * (2.0 * over - large) + (over - 2.0 * (large - small)) * over
    else:
        over = found - large
        error = 2.0 * over * (large - 2.0 * small) + ((4.0 * over - small) * small + over * over)
    return found - error / (2.0 * found)


def log_sum_exp(x: Floats) -> Floats:
    """log sum exp(x) over the last axis, (..., n) -> (...); -inf of nothing but -inf."""
    top = x.max(axis=-1, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    return np.asarray(log(np.sum(exp(x - top), axis=-1)) + top[..., 0])


def interpolated(x: ArrayLike, nodes: Floats, values: Floats) -> Floats:
    """Values at x, (...), between those at ascending nodes, (n,) each; at the ends the first and the last value."""
    at = np.asarray(x, np.float64)
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    low, high = nodes[i], nodes[i + 1]
    share = np.clip(np.divide(at - low, high - low, out=np.zeros(at.shape), where=high > low), 0.0, 1.0)
    found = values[i] + share * (values[i + 1] - values[i])
    return np.where(at >= nodes[-1], values[-1], found)[()]


def _each(function: int, x: ArrayLike) -> Floats:
    """One of the functions, by number, of each element."""
    given = np.ascontiguousarray(x, dtype=np.float64)
    found = np.empty(np.shape(x))
    _fill(function, given.reshape(-1), found.reshape(-1))
    return found[()]


@kernel
def _fill(function: int, x: Floats, found: Floats) -> None:
    for i in range(x.size):
        if function == _EXP:
            found[i] = math.exp(x[i]) if not x[i] > _LARGEST else math.inf
        elif function == _EXPM1:
            found[i] = math.expm1(x[i]) if not x[i] > _LARGEST else math.inf
        elif function == _LOG:
            found[i] = math.log(x[i]) if x[i] > 0.0 else _log_of_none(x[i])
        elif function == _LOG10:
            found[i] = math.log10(x[i]) if x[i] > 0.0 else _log_of_none(x[i])
        elif function == _LOG1P:
            found[i] = math.log1p(x[i]) if x[i] > -1.0 else _log_of_none(1.0 + x[i])
        elif function == _TAN:
            found[i] = math.tan(x[i])
        elif function == _ARCSIN:
            found[i] = math.asin(x[i]) if -1.0 <= x[i] <= 1.0 else math.nan
        elif function == _NDTR:
            found[i] = 0.5 * erfc(-x[i] / math.sqrt(2.0))
        elif function == _NDTRI:
            found[i] = _normal_quantile(x[i])
        elif function == _I0E:
            found[i] = _scaled_bessel(0, x[i])
        else:
            found[i] = _scaled_bessel(1, x[i])


@kernel
def _powers(bases: Floats, exponents: Floats, found: Floats) -> None:
    for i in range(found.size):
        found[i] = math.pow(bases[i], exponents[i])


@kernel
def _log_of_none(x: float) -> float:
    """Logarithm of what is not above 0, or NaN."""
    return -math.inf if x == 0.0 else math.nan


@kernel
def _normal_quantile(p: float) -> float:
    """Quantile of N(0, 1), to 1e-15 (Wichura 1988)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        return q * _ratio(0, 0.180625 - q * q)
    rest = p if q < 0.0 else 1.0 - p
    if not rest > 0.0:
        return math.copysign(math.inf, q) if rest == 0.0 else math.nan
    r = math.sqrt(-math.log(rest))
    return math.copysign(_ratio(1, r - 1.6) if r <= 5.0 else _ratio(2, r - 5.0), q)


@kernel
def _ratio(interval: int, r: float) -> float:
    above, below = 0.0, 0.0
    for i in range(8):
        above = above * r + _RATIONAL[interval, 0, i]
        below = below * r + _RATIONAL[interval, 1, i]
    return above / below


@kernel
def _scaled_bessel(order: int, x: float) -> float:
    """exp(-x) I_n(x), order n of 0 or 1, x >= 0 (Abramowitz and Stegun 9.6.10 and 9.7.1); to 1e-15."""
    if not x >= 0.0:
        return math.nan
    if x <= _SERIES:
        quarter, term, k = 0.25 * x * x, 1.0 if order == 0 else 0.5 * x, 1
        total = term
        while term > _EPS * total:
            term *= quarter / (k * (k + order))
            total += term
            k += 1
        return total * math.exp(-x)
    total, term, k = 1.0, 1.0, 1
    while abs(term) > _EPS:
        term *= ((2 * k - 1) ** 2 - 4 * order * order) / (8.0 * k * x)
        total += term
        k += 1
    return total / math.sqrt(2.0 * math.pi * x)
