"""A filter of a user's own: what it is asked, what it is told of a dwell, and its belief as an array of numbers.

A belief of one's own is its numbers and nothing else. So a planner that takes a track over goes on from a snapshot,
whatever the filter is, and a filter that keeps something beside them is found by `cogradar check`.
"""

from collections.abc import Callable
from functools import cached_property
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.linear import cholesky, product
from cogradar.shared.scenario.limits import FAR, MIXTURE_STATES, MOST_NUMBERS, MOST_STATES
from cogradar.shared.scenario.plugins.names import PluginRefused
from cogradar.shared.scenario.plugins.resolver import Caller
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import around
from cogradar.shared.tracking.belief.gaussian_mixture import normal_points
from cogradar.shared.tracking.belief.likelihood import Looks, likelihood_of
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.motion import covariance_of_state, expected_states, mean_state

if TYPE_CHECKING:
    from cogradar.shared.tracking.model import TrackerModel

Floats = NDArray[np.float64]
_METHODS = ("begin", "predict", "update", "states")
_WIDTH = 4  # of a state


class Observation(NamedTuple):
    """What a dwell tells a track: a detection, or looks in which the target was missed."""

    is_hit: bool  # There is a detection.
    nu: float  # Its direction, sin(bearing) / 2: measured, or the axis of its look; 0 without one.
    nu_sigma: float  # Standard deviation of the direction.
    range_km: float  # Centre of its range cell; 0: ranges are not measured.
    range_sigma_km: float  # Standard deviation of a range that is uniform in the cell.
    amplitude: float  # |alpha_hat| / sigma_hat of the detection; 0 without one.
    looks: Looks  # All looks, with the one that has the detection.
    likelihood: Callable[[Floats], Floats]  # P(looks | state) of states (n, 4) -> (n,): direction, range, amplitude.


class BeliefFilter(Protocol):
    """A filter. A belief is an array (rows, columns) of your choice: finite numbers, at most 1e9 in size.

    Every method is a function of its arguments, which it leaves as they are; all that is random is of `rng`.
    States are [x, vx, y, vy] in km and km/s, x >= 0 on boresight; the radar is at (0, 0). `radar` is the table
    `[radar]`; a dwell lasts `radar.motion.dt_s`.
    """

    def begin(self, radar: RadarConfig, states: Floats, rng: np.random.Generator) -> Floats:
        """Belief of a target that was just found, and is in one of these equally probable states, (n, 4)."""

    def predict(self, radar: RadarConfig, belief: Floats, rng: np.random.Generator) -> Floats:
        """The belief one dwell later, before its looks. It may be called before they are there."""

    def update(
        self, radar: RadarConfig, belief: Floats, seen: Observation, rng: np.random.Generator
    ) -> tuple[Floats, float]:
        """A predicted belief after the looks of its dwell, and how probable they were.

        Of misses that is a probability: a track whose misses are improbable is looked for farther afield, and of an
        unknown number given up. Of a detection it has no effect.
        """

    def states(self, radar: RadarConfig, belief: Floats) -> Floats:
        """Equally probable states that stand for a belief, (n, 4), n from 5 to 50 000: what the planner looks by.

        Their mean and covariance are the estimate and its covariance.
        """


class OwnBelief:
    """The belief of a filter of a user's own."""

    def __init__(self, rows: Floats, states: Callable[[Floats], Floats]) -> None:
        self._rows, self._states = rows, states

    @property
    def rows(self) -> Floats:
        """The numbers."""
        return self._rows

    def sample(self) -> Floats:
        """The states that stand for them; not to be changed."""
        return self._sample

    @cached_property
    def _sample(self) -> Floats:
        return self._states(self._rows)

    def moments(self) -> tuple[Floats, Floats]:
        """Of these states."""
        mean = mean_state(self._sample)
        return mean, covariance_of_state(self._sample, mean)

    def expected(self, model: "TrackerModel", modes: Floats) -> Floats:
        """These states a dwell later, by the radar's own motion: a filter's own may draw random numbers."""
        return expected_states(self._sample, model.of_modes(modes).motion)


def observation_of(model: "TrackerModel", looks: Looks) -> Observation:
    """What looks tell a filter of a user's own."""
    lobe, cell_km = looks.response.lobe, looks.response.range_cell_km
    nu, nu_sigma = (looks.hit_nu, lobe / sqrt(12.0)) if looks.is_hit else (0.0, 0.0)
    if looks.nu_sigma > 0.0:
        # On the look's side: a filter that knows no circle would take the other end for a direction far away.
        beside = looks.hit_nu + float(around(looks.nu_hat - looks.hit_nu))
        nu, nu_sigma = min(max(beside, -0.5), 0.5), looks.nu_sigma

    def likelihood(states: Floats) -> Floats:
        given = np.array(states, dtype=np.float64, order="C")
        if given.ndim != 2 or given.shape[1] != _WIDTH:
            raise ValueError(f"likelihood of states of shape {given.shape}: must be (n, 4)")
        return weigh(given, likelihood_of(model.sensor, looks)).weights

    range_sigma_km = cell_km / sqrt(12.0) if looks.range_km > 0.0 else 0.0
    return Observation(looks.is_hit, nu, nu_sigma, looks.range_km, range_sigma_km, looks.amplitude, looks, likelihood)


def normal_states(mean: Floats, covariance: Floats, n: int = MIXTURE_STATES) -> Floats:
    """States (n, 4) that stand for a Gaussian: with exactly this mean, (4,), and covariance, (4, 4).

    States behind the array, x < 0, are put at its edge. Raises ValueError if the covariance is not positive definite.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        lower = cholesky(np.asarray(covariance, dtype=np.float64))
    if not np.isfinite(lower).all():
        raise ValueError("normal_states: the covariance must be positive definite")
    states = np.asarray(mean + product(normal_points(n), lower.T))
    np.maximum(states[:, 0], 0.0, out=states[:, 0])
    return states


class Guarded:
    """A filter of a user's own whose answers make sense. It gets copies: what it does to them has no effect.

    Copies and no read-only arrays, for which kernels would be compiled once more.
    """

    def __init__(self, filter_: Any, call: Caller) -> None:
        self._filter, self._call = filter_, call

    def begin(self, radar: RadarConfig, states: Floats, rng: np.random.Generator) -> Floats:
        return self._numbers("begin", self._call(self._filter.begin, radar, states.copy(), rng))

    def predict(self, radar: RadarConfig, belief: Floats, rng: np.random.Generator) -> Floats:
        return self._numbers("predict", self._call(self._filter.predict, radar, belief.copy(), rng))

    def update(
        self, radar: RadarConfig, belief: Floats, seen: Observation, rng: np.random.Generator
    ) -> tuple[Floats, float]:
        answer = self._call(self._filter.update, radar, belief.copy(), seen, rng)
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise self._call.failed(f"returned {type(answer).__name__} of update: must be (belief, evidence)")
        rows, evidence = answer
        if not isinstance(evidence, int | float | np.integer | np.floating) or not 0.0 <= evidence < np.inf:
            raise self._call.failed(f"returned evidence {evidence!r} of update: must be a finite number from 0")
        return self._numbers("update", rows), float(evidence)

    def states(self, radar: RadarConfig, belief: Floats) -> Floats:
        found = self._numbers("states", self._call(self._filter.states, radar, belief.copy()))
        if found.shape[1] != _WIDTH or not _WIDTH < found.shape[0] <= MOST_STATES or (found[:, 0] < 0.0).any():
            raise self._call.failed(
                f"returned states of shape {found.shape}, x from {found[:, 0].min():.3g}: must be (n, 4), n from"
                f" {_WIDTH + 1} to {MOST_STATES}, x from 0"
            )
        return found

    def _numbers(self, method: str, answer: Any) -> Floats:
        try:
            given = np.asarray(answer)
        except ValueError as error:  # rows of different lengths
            raise self._call.failed(f"returned no array of {method}: {error}") from error
        if given.ndim != 2 or 0 in given.shape or given.dtype.kind not in "iuf":
            raise self._call.failed(
                f"returned {given.dtype} of shape {given.shape} of {method}: must be (n, m) numbers"
            )
        if given.size > MOST_NUMBERS or max(given.shape) > MOST_STATES:
            raise self._call.failed(
                f"returned shape {given.shape} of {method}: must have at most {MOST_NUMBERS} numbers, {MOST_STATES} on"
                " an axis"
            )
        numbers = np.array(given, dtype=np.float64, order="C")  # a copy: what the filter keeps it may change
        if not (np.abs(numbers) <= FAR).all():
            raise self._call.failed(f"returned numbers of {method} that are not finite, or beyond {FAR:g}")
        return numbers


def guarded(filter_: Any, call: Caller) -> Guarded:
    """A user's own filter, or a class that makes one. Raises PluginRefused if it lacks a method."""
    made = call(filter_) if isinstance(filter_, type) else filter_
    for method in _METHODS:
        if not callable(getattr(made, method, None)):
            raise PluginRefused(f"{call.short}: a belief needs the method {method}, which it has not")
    return Guarded(made, call)
