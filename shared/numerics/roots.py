"""Roots of functions of one variable."""

from collections.abc import Callable

_HALVINGS = 200  # at most: no double is left between the ends before that


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function changes its sign between two ends, by bisection to the last bit.

    Raises ValueError if the ends have the same sign.
    """
    is_negative = function(low) < 0.0
    if is_negative == (function(high) < 0.0):
        raise ValueError(f"no change of sign between {low:g} and {high:g}")
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if middle in {low, high}:
            break
        low, high = (middle, high) if (function(middle) < 0.0) == is_negative else (low, middle)
    return high
