"""What a machine computes: equal digests of a fixed computation, equal runs.

All else that reaches a result is sums and products, which are the same wherever IEEE 754 holds (ADR 42). Kernels call
the C library that Python calls, so that nothing has to be compiled for this.
"""

import hashlib
import math
from functools import cache

import numpy as np

_POINTS = 5000  # enough to meet the points where two C libraries round apart, one in a thousand of `exp`
_FUNCTIONS = (math.exp, math.expm1, math.sin, math.cos, math.tan, math.atan)
_OF_POSITIVE = (math.log, math.log10, math.log1p, math.sqrt, math.lgamma)


@cache
def arithmetic() -> str:
    """Digest of what this machine's C library and NumPy say of fixed numbers, 8 characters; takes 10 ms."""
    x = np.arange(_POINTS) * (40.0 / _POINTS) - 19.9
    positive = np.abs(x) + 1e-9
    digest = hashlib.sha256()
    for functions, at in ((_FUNCTIONS, x), (_OF_POSITIVE, positive), ((math.asin,), np.sin(x))):
        values = at.tolist()
        for function in functions:
            digest.update(np.array([function(value) for value in values]).tobytes())
    pairs = list(zip(positive.tolist(), x.tolist(), strict=True))
    digest.update(np.array([(math.pow(a, 0.3 * b), math.atan2(b, a)) for a, b in pairs]).tobytes())
    rng = np.random.default_rng(1)
    drawn = (rng.standard_normal(_POINTS), rng.standard_gamma(2.0, _POINTS), rng.poisson(3.3, _POINTS))
    for array in (np.sin(x), np.cos(x), np.exp(1j * x), x / positive, np.sqrt(positive), np.cumsum(x), *drawn):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(np.array([np.sum(x * 1.1), np.mean(positive), np.sum(np.exp(1j * x))]).tobytes())
    return digest.hexdigest()[:8]
