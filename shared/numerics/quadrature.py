"""Gauss-Legendre quadrature that gives the same bytes on every processor (ADR 42)."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

_STEPS = 10  # of Newton's method, which needs 4 to 6


@cache
def gauss_legendre(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes in (-1, 1), ascending, and weights of the rule that is exact to degree 2 n - 1, (n,) each.

    Roots of P_n by Newton's method; w = 2 / ((1 - x^2) P_n'(x)^2). Not to be changed.
    """
    nodes, weights = np.empty(n), np.empty(n)
    for i in range(n):
        x = -math.cos(math.pi * (i + 0.75) / (n + 0.5))
        for _ in range(_STEPS):
            value, slope = _legendre(n, x)
            x -= value / slope
        _, slope = _legendre(n, x)
        nodes[i], weights[i] = x, 2.0 / ((1.0 - x * x) * slope * slope)
    return nodes, weights


def _legendre(n: int, x: float) -> tuple[float, float]:
    """P_n(x) and its derivative, |x| < 1."""
    before, value = 0.0, 1.0
    for k in range(1, n + 1):
        before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
    return value, n * (x * value - before) / (x * x - 1.0)
