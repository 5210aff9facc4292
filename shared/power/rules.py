"""Power rules, the strategies of a run: how the power is spread over the bins that the tracks ask for.

A rule is a function (radar, nus, weights) -> Emission; `shared.scenario.tables.POWER_RULES` has its name.

    nus     : (M,) spatial frequencies of the tracks' bins
    weights : (M,) > 0, expected echo power 1/R^4 of each track; only ratios matter
    returns : all of radar.array.power, and no more
"""

from functools import cache
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from shared.power.max_min import allocate
from shared.scenario.radar_config import RadarConfig
from shared.scenario.tables import POWER_RULES, implementation
from shared.signal.waveform import beam_factor

if TYPE_CHECKING:
    from shared.power.sdp_reference import ReducedProgram

Floats = NDArray[np.float64]


class Emission(NamedTuple):
    """What is radiated, R = (isotropic / n_tx) I + F F^H."""

    isotropic: float  # power sent equally in all directions
    factor: NDArray[np.complex128]  # (n_tx, r), F
    shares: Floats  # (M,) power attributed to each track
    status: str = "fixed"  # fixed, optimal or inaccurate


class PowerRule(Protocol):
    """How the power is spread."""

    def __call__(self, radar: RadarConfig, nus: Floats, weights: Floats) -> Emission:
        """The waveform that serves tracks in these directions."""


def power_rule(strategy: str) -> PowerRule:
    """The rule of a strategy."""
    rule: PowerRule = implementation(POWER_RULES[strategy])
    return rule


def orthogonal(radar: RadarConfig, nus: Floats, weights: Floats) -> Emission:  # noqa: ARG001 - a rule like the others
    """All of it in all directions."""
    return Emission(radar.array.power, np.empty((radar.array.n_tx, 0), np.complex128), np.zeros(nus.size))


def uniform(radar: RadarConfig, nus: Floats, weights: Floats) -> Emission:  # noqa: ARG001 - a rule like the others
    """A conventional beam for each track, of equal power."""
    shares = np.full(nus.size, radar.array.power / nus.size)
    return Emission(0.0, beam_factor(nus, shares, radar.array.n_tx), shares)


def power_aware(radar: RadarConfig, nus: Floats, weights: Floats) -> Emission:
    """The max-min optimum: the weakest track gets the power it needs."""
    array = radar.array
    if radar.allocation.solver == "sdp":
        found = _program(nus.size).allocate(nus, weights, array.power, array.n_tx)
    else:
        found = allocate(nus, weights, array.power, array.n_tx)
    return Emission(0.0, found.factor, found.shares, found.status)


@cache
def _program(n_beam: int) -> "ReducedProgram":
    """The semidefinite program for so many beams, compiled once."""
    from shared.power.sdp_reference import ReducedProgram  # cvxpy: a second of import, for those who ask for it

    return ReducedProgram(n_beam)
