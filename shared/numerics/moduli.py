"""Moduli that give the same bytes on every processor: products, sums and roots are rounded alike everywhere (ADR 42).

Apart from `elementwise`, which needs the compiler: what only reads messages has none. Kernels may call these, too.
"""

from typing import Any

import numpy as np


def hypot(x: Any, y: Any) -> Any:
    """sqrt(x^2 + y^2), of kilometres and not of numbers near the ends of the range; broadcasts."""
    return np.sqrt(x * x + y * y)


def squared_modulus(z: Any) -> Any:
    """|z|^2 of complex numbers or arrays; (...) -> (...)."""
    return z.real * z.real + z.imag * z.imag


def modulus(z: Any) -> Any:
    """|z| of complex numbers or arrays; (...) -> (...)."""
    return np.sqrt(z.real * z.real + z.imag * z.imag)
