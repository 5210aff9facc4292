"""The true targets: how they move and how strong their echoes are.

States are [x, vx, y, vy] in km and km/s. Random numbers are keyed by target and dwell, so that all strategies of a seed
see the same trajectories and the same phases.
"""

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.signal.radar_equation import amplitude
from shared.tracking.motion import Motion, propagate_into

# By `world.rcs`: what an echo's power is multiplied by is Gamma(shape, 1/shape), of mean 1. (Swerling 1954)
_SHAPES = {"swerling1": 1.0, "swerling3": 2.0}  # many scatterers alike; one among many small ones


def moved(states: NDArray[np.float64], motion: Motion, seed: int, t: int) -> NDArray[np.float64]:
    """States at clock t from those at t - 1; (M, 4) -> (M, 4)."""
    out = np.empty_like(states)
    for m in range(states.shape[0]):
        propagate_into(states[m : m + 1], motion, generator(seed, Purpose.MOTION, m, t), out[m : m + 1])
    return out


def echo_amplitudes(states: NDArray[np.float64], at_1_km: float, rcs: str, seed: int, k: int) -> NDArray[np.complex128]:
    """Complex echo amplitude alpha of each target in dwell k, (M, 4) -> (M,).

    |alpha|^2 by the radar equation, with |alpha| = at_1_km at 1 km, times a factor by a law of `world.rcs`; the phase
    is uniform. Both are drawn anew in each dwell.
    """
    turns = [generator(seed, Purpose.PHASE, m, k).random() for m in range(states.shape[0])]
    magnitudes = amplitude(at_1_km, states[:, 0] ** 2 + states[:, 2] ** 2)
    if rcs in _SHAPES:
        shape = _SHAPES[rcs]
        factors = [generator(seed, Purpose.RCS, m, k).standard_gamma(shape) / shape for m in range(states.shape[0])]
        magnitudes = magnitudes * np.sqrt(factors)
    return np.asarray(magnitudes * np.exp(2j * np.pi * np.array(turns)), dtype=np.complex128)
