"""The true targets: how they move and how strong their echoes are.

States are [x, vx, y, vy] in km and km/s. Random numbers are keyed by target and dwell, so that all strategies of a seed
see the same trajectories and the same phases.
"""

from collections.abc import Sequence
from math import cos, hypot, sin

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.scenario.world_config import TargetSection, TurnSection
from shared.signal.radar_equation import amplitude
from shared.tracking.motion import Motion, propagate_into

G_KM_S2 = 9.80665e-3  # standard gravity
# By `world.rcs`: what an echo's power is multiplied by is Gamma(shape, 1/shape), of mean 1. (Swerling 1954)
_SHAPES = {"swerling1": 1.0, "swerling3": 2.0}  # many scatterers alike; one among many small ones


def moved(
    states: NDArray[np.float64], motion: Motion, seed: int, t: int, targets: Sequence[TargetSection]
) -> NDArray[np.float64]:
    """States at clock t from those at t - 1, with the turns of these targets; (M, 4) -> (M, 4).

    A turn through the angle a in a dwell moves the target along the chord of its arc, whose velocity is that of the
    middle of the turn times sin(a/2) / (a/2). The process noise is added as without a turn.
    """
    out = np.empty_like(states)
    for m, target in enumerate(targets):
        before, angle = states[m], _turned_by(target.turns, states[m], motion.dt, t)
        chord = before.copy()
        chord[1::2] = _rotated(before[1::2], 0.5 * angle) * np.sinc(0.5 * angle / np.pi)
        propagate_into(chord[np.newaxis], motion, generator(seed, Purpose.MOTION, m, t), out[m : m + 1])
        if angle != 0.0:
            out[m, 1::2] += _rotated(before[1::2], angle) - chord[1::2]
    return out


def _turned_by(turns: Sequence[TurnSection], state: NDArray[np.float64], dt: float, t: int) -> float:
    """Angle in rad by which a target turns in the dwell that ends at clock t: acceleration / speed times its time."""
    speed = hypot(state[1], state[3])
    if speed == 0.0:
        return 0.0
    g_s = sum(max(min(turn.to_s, t * dt) - max(turn.from_s, (t - 1) * dt), 0.0) * turn.g for turn in turns)
    return g_s * G_KM_S2 / speed


def _rotated(velocity: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """A velocity, (2,), turned through an angle in rad, from +x towards +y; exactly itself if that is 0."""
    c, s = cos(angle), sin(angle)
    return np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]])


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
