"""Slow and obvious versions of `cogradar.shared.power.joint`."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.receiver import detection_probability

Floats = NDArray[np.float64]


def expected_detections(
    chances: Floats, gains: Floats, powers: Floats, threshold: float, rcs: str = "constant"
) -> float:
    """Detections that these looks are expected to make, from the closed form."""
    return float(chances @ detection_probability(gains * powers, threshold, rcs))


def best_on_a_grid(
    chances: Floats, gains: Floats, power: float, threshold: float, n: int = 1200, rcs: str = "constant"
) -> float:
    """Most expected detections if each cell's power is a multiple of power / n: dynamic programming, cell by cell."""
    grid = power / n * np.arange(n + 1)
    best = np.zeros(n + 1)  # with so many parts of the power for the cells so far
    for chance, gain in zip(chances, gains, strict=True):
        value = chance * detection_probability(gain * grid, threshold, rcs)
        best = np.array([np.max(best[: k + 1][::-1] + value[: k + 1]) for k in range(n + 1)])
    return float(best[n])
