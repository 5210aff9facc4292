"""Power rules, the strategies of a run: how the power is spread over the bins that the tracks ask for.

A rule is a function (radar, requests) -> Emission; `cogradar.shared.scenario.tables.POWER_RULES` has the built-in ones.
What it returns has all of radar.array.power, and no more.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import power
from cogradar.shared.power.equal_antennas import allocate_conventional, allocate_equal
from cogradar.shared.power.max_min import Allocation, allocate
from cogradar.shared.scenario.plugins.kinds import OBJECTIVE, STRATEGY
from cogradar.shared.scenario.plugins.names import PluginRefused
from cogradar.shared.scenario.plugins.resolver import Caller, resolve
from cogradar.shared.scenario.radar_config import AllocationSection, RadarConfig
from cogradar.shared.signal.waveform import beam_factor

if TYPE_CHECKING:
    from cogradar.shared.power.sdp_reference import ReducedProgram

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
STATUSES = ("fixed", "optimal", "inaccurate")
TOLERANCE = 1e-6  # of the power, relative


_NOWHERE, _NOBODY, _ALIKE, _FREE = np.zeros(0, np.int64), np.zeros(0, np.bool_), np.ones(1), np.zeros(1)


class Requests(NamedTuple):
    """What M tracks ask for in one dwell; C = 1 for one cell each."""

    nus: Floats  # (M, C) directions of each track's cells, the first by its action-selection policy
    chances: Floats  # (M, C) probability that its target is in the cell; 0: no further one
    ranges_km: Floats  # (M,) > 0, expected
    gains: Floats  # (M,) zeta / w of a target that is lit by a beam of power w: its P_D is Q_1(sqrt zeta, sqrt lambda)
    worths: Floats  # (M,) what finding the target in its cells, if it is there, adds to what is known some dwells later
    reaches: NDArray[np.int64] = _NOWHERE  # (M,) cells to either side in which it may be, too; (0,): none
    astray: NDArray[np.bool_] = _NOBODY  # (M,) its misses are improbable
    k: int = 0  # dwell of the plans
    priorities: Floats = _ALIKE  # (M,) > 0, how many times the signal-to-noise ratio is wanted; (1,): of all alike
    fixed: Floats = _FREE  # (M,) power of the first cell, if that was asked for; 0: what is best; (1,): so of all

    @classmethod
    def of_single(cls, nus: Floats, ranges_km: Floats, gains: Floats) -> Self:
        """Requests of tracks that know the directions of their targets, (M,)."""
        return cls(nus[:, np.newaxis], np.ones((nus.size, 1)), ranges_km, gains, np.ones(nus.size))

    @property
    def weights(self) -> Floats:
        """Expected echo power 1/R^4 of each track over what is wanted of it, (M,); only ratios matter."""
        return np.asarray(power(self.ranges_km, -4.0) / self.priorities)

    def with_fixed(self, weights: Floats, power: float) -> Floats:
        """Weights, (M,), with which max-min gives tracks their fixed power of all of it, or more.

        Beams that are orthogonal share the power as 1 / weight, and others add to one another's echoes.
        """
        is_fixed = np.broadcast_to(self.fixed > 0.0, weights.shape)
        if not is_fixed.any():
            return weights
        rest = 1.0 if is_fixed.all() else (power - self.fixed.sum()) / (1.0 / weights[~is_fixed]).sum()
        return np.where(is_fixed, rest / np.where(is_fixed, self.fixed, 1.0), weights)


class Emission(NamedTuple):
    """What is radiated, R = (isotropic / n_tx) I + F F^H."""

    isotropic: float  # power sent equally in all directions
    factor: NDArray[np.complex128]  # (n_tx, r), F
    nus: Floats  # (M, L) directions lit for each track, brightest first; NaN: none (further)
    shares: Floats  # (M, L) power attributed to each
    status: str = "fixed"  # fixed, optimal or inaccurate


class PowerRule(Protocol):
    """How the power is spread."""

    def __call__(self, radar: RadarConfig, requests: Requests) -> Emission:
        """The waveform that serves these requests."""


def power_rule(strategy: str) -> PowerRule:
    """The rule of a strategy."""
    rule: PowerRule = resolve(STRATEGY, strategy)
    return rule


def guarded(rule: Any, call: Caller) -> PowerRule:
    """A user's own rule, whose emissions can be radiated. Raises PluginRefused if it cannot be called."""
    if not callable(rule):
        raise PluginRefused(f"{call.short}: must be a function (radar, requests) -> Emission")

    def asked(radar: RadarConfig, requests: Requests) -> Emission:
        given = requests._asdict().items()
        copies: dict[str, Any] = {name: value.copy() for name, value in given if isinstance(value, np.ndarray)}
        answer = call(rule, radar, requests._replace(**copies))
        if not isinstance(answer, Emission):
            raise call.failed(f"returned {answer!r}: must be an Emission")
        try:
            isotropic, status = float(answer.isotropic), str(answer.status)
            factor = np.asarray(answer.factor, dtype=np.complex128)
            nus, shares = (np.asarray(values, dtype=np.float64) for values in (answer.nus, answer.shares))
        except (TypeError, ValueError) as error:
            raise call.failed(f"returned an Emission that is none: {error}") from error
        sent = Emission(isotropic, factor, nus, shares, status)
        if fault := next(_faults_of(sent, radar.array.n_tx, radar.array.power, requests.nus.shape[0]), ""):
            raise call.failed(f"returned {fault}")
        return sent

    return asked


def _faults_of(sent: Emission, n_tx: int, power: float, n_track: int) -> Iterator[str]:
    """What keeps an emission from being radiated; only the first is sure, as each takes what is before for good."""
    nus, shares = sent.nus, sent.shares
    if sent.factor.ndim != 2 or sent.factor.shape[0] != n_tx:
        yield f"a factor of shape {sent.factor.shape}: must be ({n_tx}, r)"
    if nus.ndim != 2 or nus.shape[0] != n_track or nus.shape[1] == 0:
        yield f"nus of shape {nus.shape}: must be ({n_track}, L), a row of each track"
    if shares.shape != nus.shape:
        yield f"shares of shape {shares.shape}: must be {nus.shape}, as nus"
    if not (np.isfinite(sent.isotropic) and np.isfinite(sent.factor).all() and np.isfinite(shares).all()):
        yield "an isotropic power, a factor or shares that are not finite"
    if not (np.isnan(nus) | (np.abs(nus) <= 0.5)).all():
        yield "nus beyond -0.5 .. 0.5"
    if sent.isotropic < 0.0 or (shares < 0.0).any():
        yield "an isotropic power or shares below 0"
    if sent.status not in STATUSES:
        yield f"status {sent.status!r}: must be one of {', '.join(STATUSES)}"
    if (radiated := sent.isotropic + float(np.sum(np.abs(sent.factor) ** 2))) > power * (1.0 + TOLERANCE):
        yield f"a power of {radiated:.6g}: must be at most {power:.6g}"


def orthogonal(radar: RadarConfig, requests: Requests) -> Emission:
    """All of it in all directions."""
    first = requests.nus[:, :1]
    return Emission(radar.array.power, np.empty((radar.array.n_tx, 0), np.complex128), first, np.zeros(first.shape))


def uniform(radar: RadarConfig, requests: Requests) -> Emission:
    """A conventional beam for the first cell of each track, of equal power."""
    first = requests.nus[:, :1]
    shares = np.full(first.shape, radar.array.power / first.size)
    return Emission(0.0, beam_factor(first[:, 0], shares[:, 0], radar.array.n_tx), first, shares)


def power_aware(radar: RadarConfig, requests: Requests) -> Emission:
    """What the objective asks for: by default the max-min optimum, the weakest track gets the power it needs."""
    rule: PowerRule = resolve(OBJECTIVE, radar.allocation.objective)
    return rule(radar, requests)


def max_min(radar: RadarConfig, requests: Requests) -> Emission:
    """The max-min optimum over the tracks' first cells; of gains, where no range tells how strong an echo is."""
    array, nus = radar.array, requests.nus[:, 0]
    weights = requests.gains / requests.priorities if radar.assumes.rcs == "unknown" else requests.weights
    weights = requests.with_fixed(weights, array.power)
    found = _solver(radar.allocation, nus.size)(nus, weights, array.power, array.n_tx)
    return Emission(0.0, found.factor, requests.nus[:, :1], found.shares[:, np.newaxis], found.status)


def _solver(section: AllocationSection, n_beam: int) -> Callable[[Floats, Floats, float, int], Allocation]:
    """What solves max-min for so many beams."""
    if section.solver == "sdp":
        return _program(n_beam).allocate
    if section.beams == "conventional":
        return allocate_conventional
    return allocate_equal if section.antennas == "equal" else allocate


@cache
def _program(n_beam: int) -> "ReducedProgram":
    """The semidefinite program for so many beams, compiled once."""
    from cogradar.shared.power.sdp_reference import (
        ReducedProgram,  # cvxpy: a second of import, for those who ask for it
    )

    return ReducedProgram(n_beam)
