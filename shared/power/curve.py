"""Probability of detection over zeta, the gain of a look times its power, and the inverse of its slope."""

from functools import lru_cache, partial
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import i1e, interpolated
from cogradar.shared.numerics.jit import inlined
from cogradar.shared.numerics.roots import root
from cogradar.shared.signal.receiver import detection_probability

Floats = NDArray[np.float64]

_STEPS = 128  # of a table per unit
_BEYOND = 9.0  # in sqrt zeta, above sqrt lambda: P_D is 1 there to double precision
_MOST = 500.0  # sqrt zeta at which it is taken as 1 if the target fluctuates: within 1e-4


class Curve(NamedTuple):
    """f(zeta) and the inverse of its slope above the bend. Both are tables over equal steps; s = sqrt zeta.

    s is a function of t = sqrt(ln f'(bend) - ln f'(zeta)), 0 at the bend and nearly a straight line.
    """

    f: Floats  # over s from 0
    s: Floats  # over t from 0
    steepest: float  # ln f'(bend)
    t_chord: float  # where the chord from f(0) is the tangent: from here on a look is worth its price
    s_chord: float


@lru_cache(maxsize=16)
def curve_of(limit: float, rcs: str = "constant") -> Curve:
    """The curve of a threshold lambda > 4: below, f is concave everywhere (P_FA above 0.135).

    rcs : what the targets do, "constant" or "swerling1", of which P_D is still rising where the other's is 1
    """
    from scipy.optimize import minimize_scalar  # 0.4 s of import, which other objectives need not spend

    is_constant = rcs == "constant"
    log_slope = partial(_log_slope if is_constant else _log_slope_swerling1, limit)

    def f(zeta: float) -> float:
        return float(detection_probability(zeta, limit, rcs))

    bend = float(minimize_scalar(lambda zeta: -log_slope(zeta), bounds=(1e-9, 2.0 * limit), method="bounded").x)
    chord = root(lambda zeta: f(zeta) - f(0.0) - zeta * exp(log_slope(zeta)), bend * (1.0 + 1e-6), 4.0 * limit + 40.0)
    s = np.arange(0.0, sqrt(limit) + _BEYOND if is_constant else _MOST, 1.0 / _STEPS)
    upper = np.concatenate(([sqrt(bend)], s[s > sqrt(bend)]))
    t = np.sqrt(np.maximum(log_slope(bend) - np.array([log_slope(one * one) for one in upper]), 0.0))
    steps = np.arange(0.0, t[-1], 1.0 / _STEPS)
    t_chord = sqrt(log_slope(bend) - log_slope(chord))
    return Curve(
        np.asarray(detection_probability(s * s, limit, rcs)),
        interpolated(steps, t, upper),
        log_slope(bend),
        t_chord,
        sqrt(chord),
    )


def _log_slope(limit: float, zeta: float) -> float:
    """Of f'(zeta) = 1/2 sqrt(lambda / zeta) exp(-(lambda + zeta) / 2) I_1(sqrt(lambda zeta))."""
    return log(0.5 * sqrt(limit / zeta) * float(i1e(sqrt(limit * zeta)))) - 0.5 * (sqrt(limit) - sqrt(zeta)) ** 2


def _log_slope_swerling1(limit: float, zeta: float) -> float:
    """Of f'(zeta) = 1/2 y / m^2 exp(-y / m), y = lambda / 2, m = 1 + zeta / 2."""
    y, m = 0.5 * limit, 1.0 + 0.5 * zeta
    return log(0.5 * y) - 2.0 * log(m) - y / m


@inlined
def detected(curve: Curve, zeta: float) -> float:
    """f(zeta)."""
    x = np.sqrt(zeta) * _STEPS
    i = int(min(x, 1e6))
    if i >= curve.f.size - 1:
        return 1.0
    return float(curve.f[i] + (x - i) * (curve.f[i + 1] - curve.f[i]))


@inlined
def wanted(curve: Curve, t: float) -> float:
    """zeta above the bend at t; beyond the table s goes on as a straight line."""
    x = t * _STEPS
    i = int(min(x, curve.s.size - 2))
    s = curve.s[i] + (x - i) * (curve.s[i + 1] - curve.s[i])
    return float(s * s)
