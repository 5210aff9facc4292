"""Portable functions of arrays against NumPy's and SciPy's."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import special

from cogradar.shared.numerics import elementwise, error_function
from cogradar.shared.numerics.quadrature import gauss_legendre
from cogradar.shared.numerics.roots import root

ALL = np.concatenate(
    (np.linspace(-40.0, 40.0, 2001), [-1e-9, 0.0, 1e-9, 700.0, 800.0, -800.0, np.inf, -np.inf, np.nan])
)
NOT_NEGATIVE = np.concatenate((np.geomspace(1e-12, 1e9, 2001), [0.0, 1.0, 8.0, 20.0, 20.0000001]))
PROBABLE = np.concatenate((np.geomspace(1e-300, 0.5, 1001), np.linspace(0.001, 1.0, 1000), [0.0, -0.1, 1.1, np.nan]))


@pytest.mark.parametrize(
    ("portable", "oracle", "x", "rtol"),
    [
        (elementwise.exp, np.exp, ALL, 1e-15),
        (elementwise.expm1, np.expm1, ALL, 1e-15),
        (elementwise.log, np.log, ALL, 1e-15),
        (elementwise.log10, np.log10, ALL, 1e-15),
        (elementwise.log1p, np.log1p, ALL, 1e-15),
        (elementwise.tan, np.tan, ALL[:2001], 1e-15),
        (elementwise.arcsin, np.arcsin, ALL, 1e-15),
        (elementwise.ndtr, special.ndtr, ALL[:2001], 1e-12),
        (elementwise.ndtri, special.ndtri, PROBABLE, 1e-14),
        (elementwise.i0e, special.i0e, NOT_NEGATIVE, 4e-15),
        (elementwise.i1e, special.i1e, NOT_NEGATIVE, 4e-15),
    ],
)
def test_function_equals_the_library(
    portable: Callable[[Any], Any], oracle: Callable[[Any], Any], x: np.ndarray, rtol: float
) -> None:
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(portable(x), oracle(x), rtol=rtol, atol=1e-16)
    assert isinstance(portable(0.5), float)
    assert portable(np.full((2, 3), 0.5)).shape == (2, 3)


@pytest.mark.parametrize("name", ["erf", "erfc"])
def test_error_functions_are_those_of_the_c_library(name: str) -> None:
    """To 2 ulp, at both sides of the bounds of the intervals, too."""
    rng = np.random.default_rng(5)
    bounds = np.array([0.0, 0.25, 0.84375, 1.25, 1.0 / 0.35, 2.0, 4.0, 6.0, 8.0, 16.0, 27.0])
    near = np.concatenate((bounds, np.nextafter(bounds, 99.0), np.nextafter(bounds, -99.0)))
    x = np.concatenate((near, -near, rng.uniform(-6.5, 26.0, 2000), rng.normal(size=2000), [1e-300, -1e-9]))
    function, oracle = getattr(error_function, name), getattr(math, name)
    for one in x.tolist():
        expected = oracle(one)
        assert abs(function(one) - expected) <= 2.0 * np.spacing(abs(expected)), one
    assert [function(one) for one in (np.inf, -np.inf)] == [oracle(np.inf), oracle(-np.inf)]
    assert np.isnan(function(np.nan))


def test_powers_and_products_broadcast() -> None:
    base, exponent = np.geomspace(1e-3, 1e3, 7), np.array([[-4.0], [0.3], [7.0]])
    np.testing.assert_allclose(elementwise.power(base, exponent), base**exponent, rtol=1e-15)
    assert elementwise.power(10.0, 0.5) == pytest.approx(10.0**0.5)
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 5, 2)).view(np.complex128)
    np.testing.assert_allclose(elementwise.times(a, b[:, 0]), a * b[:, 0], rtol=1e-14)
    np.testing.assert_allclose(elementwise.modulus(a), np.abs(a), rtol=1e-15)
    np.testing.assert_allclose(elementwise.squared_modulus(a), np.abs(a) ** 2, rtol=1e-15)


@pytest.mark.parametrize("n", [0, 1, 2, 5, 31])
def test_whole_powers_of_complex_numbers_are_those_of_python(n: int) -> None:
    for z in np.random.default_rng(n).normal(size=(20, 2)).view(np.complex128)[:, 0].tolist():
        assert elementwise.whole_power(z, n) == pytest.approx(z**n, rel=1e-14)


def test_sum_of_exponentials_and_interpolation_equal_the_library() -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate((rng.normal(0.0, 300.0, (4, 6)), np.full((1, 6), -np.inf)))
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(elementwise.log_sum_exp(x), special.logsumexp(x, axis=1), rtol=1e-14)
    nodes, values = np.sort(rng.normal(size=30)), rng.normal(size=30)
    at = np.concatenate((rng.normal(size=(50, 4)), nodes[:4][np.newaxis]))
    np.testing.assert_allclose(elementwise.interpolated(at, nodes, values), np.interp(at, nodes, values), rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 8, 24])
def test_quadrature_is_gauss_legendre(n: int) -> None:
    for ours, oracle in zip(gauss_legendre(n), np.polynomial.legendre.leggauss(n), strict=True):
        np.testing.assert_allclose(ours, oracle, rtol=0, atol=1e-14)


def test_root_is_found_to_the_last_bit_and_refused_without_a_change_of_sign() -> None:
    found = root(lambda x: x * x - 2.0, 0.0, 5.0)
    assert np.nextafter(found, 0.0) ** 2 < 2.0 <= found * found
    with pytest.raises(ValueError, match="no change of sign"):
        root(lambda x: x * x + 1.0, 0.0, 5.0)
