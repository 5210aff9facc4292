"""How a track keeps its belief, by `radar.belief.filter`: what is asked of any filter, and those that there are.

A particle filter explains what it cannot explain by recoveries, and begins again after misses in a row. A Gaussian
mixture has no rule of its own for either: turns and a belief that was wrong are in its model.
"""

from collections.abc import Callable
from functools import partial
from math import log
from typing import Any, NamedTuple, Protocol

import numpy as np

from cogradar.shared.scenario.plugins.kinds import BELIEF
from cogradar.shared.scenario.plugins.resolver import Caller, resolve
from cogradar.shared.tracking.belief.gaussian_mixture import GaussianMixture, begin_at_detection, condition
from cogradar.shared.tracking.belief.interface import Belief, Particles
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.belief.own import BeliefFilter, OwnBelief, observation_of
from cogradar.shared.tracking.belief.own import guarded as guarded_filter
from cogradar.shared.tracking.belief.particle_filter import STEPS, predict, update
from cogradar.shared.tracking.belief.recovery import coasted, reacquire, remembered_hit
from cogradar.shared.tracking.initiation import begin_about
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import covariance_of_state, mean_state
from cogradar.shared.tracking.sensor import Floats

_TINY = 1e-300  # of a probability
_MOST_MISSES = 100  # counted; after so many the last detection is long ago
Random = Callable[[], np.random.Generator]  # a filter that draws nothing needs no generator, which takes 10 us


class Dwell(NamedTuple):
    """What a filter gets of a dwell."""

    looks: Looks
    rng: Random  # of this track and dwell
    predicted: Floats | None  # what `Filter.ahead` computed with it; None: nothing


class Observed(NamedTuple):
    """A state whose belief has taken a dwell's looks in."""

    state: TrackState
    updated: Belief  # before any recovery
    evidence: float  # how probable they were before any recovery
    modes: Floats  # (3,) probabilities of the modes of motion


class Filter(Protocol):
    """What a track asks of its filter."""

    def restored(self, model: TrackerModel, rows: Floats) -> Belief:
        """The belief that has these `rows`."""

    def born(self, model: TrackerModel, hit: Looks, rng: np.random.Generator) -> Belief:
        """Belief of a target after its first detection."""

    def begun(self, model: TrackerModel, states: Floats, rng: np.random.Generator) -> Belief:
        """Belief of a target that is in one of these equally probable states, (n, 4)."""

    def ahead(self, model: TrackerModel, state: TrackState, rng: Random) -> Floats | None:
        """The part of the next dwell that needs no scan, computed in advance; None: there is none."""

    def observed(self, model: TrackerModel, state: TrackState, dwell: Dwell) -> Observed:
        """The state one dwell later."""

    def coasted(self, model: TrackerModel, state: TrackState, rng: Random) -> TrackState:
        """The state after a dwell without an observation."""


class ParticleFilter:
    """Particles; weighed by the likelihood of the looks, or kept and rejected as the paper does."""

    def restored(self, _model: TrackerModel, rows: Floats) -> Belief:
        return Particles(rows)

    def born(self, model: TrackerModel, hit: Looks, rng: np.random.Generator) -> Belief:
        return Particles(begin_about(model, hit, rng))

    def begun(self, _model: TrackerModel, states: Floats, _rng: np.random.Generator) -> Belief:
        return Particles(states)

    def ahead(self, model: TrackerModel, state: TrackState, rng: Random) -> Floats | None:
        return STEPS[model.belief.filter].ahead(model.of_modes(state.modes).motion, state.belief.rows, rng())

    def observed(self, model: TrackerModel, state: TrackState, dwell: Dwell) -> Observed:
        looks, rng, model = dwell.looks, dwell.rng(), model.of_modes(state.modes)
        updated = update(model, state.belief.rows, looks, rng, dwell.predicted)
        after = reacquire(model, state, updated, looks, rng)
        return Observed(after, Particles(updated.particles), updated.evidence, updated.modes)

    def coasted(self, model: TrackerModel, state: TrackState, rng: Random) -> TrackState:
        now = model.of_modes(state.modes)
        return coasted(now, state, predict(now.motion, state.belief.rows, rng()))._replace(modes=now.modes)


class MixtureFilter:
    """Gaussians, one for each mode of motion. Nothing in it is drawn."""

    def restored(self, _model: TrackerModel, rows: Floats) -> Belief:
        return GaussianMixture.of_rows(rows)

    def born(self, model: TrackerModel, hit: Looks, _rng: np.random.Generator) -> Belief:
        return begin_at_detection(model, hit)

    def begun(self, model: TrackerModel, states: Floats, _rng: np.random.Generator) -> Belief:
        mean = mean_state(states)
        return GaussianMixture.of_moments(mean, covariance_of_state(states, mean), model.is_mixture)

    def ahead(self, _model: TrackerModel, _state: TrackState, _rng: Random) -> Floats | None:
        return None  # it takes as long as sending it would

    def observed(self, model: TrackerModel, state: TrackState, dwell: Dwell) -> Observed:
        looks = dwell.looks
        belief, evidence = condition(model, _mixture(state.belief).ahead(model), looks)
        memory = remembered_hit(looks) if looks.is_hit else _one_more_miss(state, evidence)
        return Observed(state._replace(belief=belief, depleted=False, **memory), belief, evidence, belief.weights)

    def coasted(self, model: TrackerModel, state: TrackState, _rng: Random) -> TrackState:
        belief = _mixture(state.belief).ahead(model)
        return state._replace(belief=belief, modes=belief.weights, **_one_more_miss(state, 1.0))


def _mixture(belief: Belief) -> GaussianMixture:
    return belief if isinstance(belief, GaussianMixture) else GaussianMixture.of_rows(belief.rows)


def _one_more_miss(state: TrackState, evidence: float) -> dict[str, Any]:
    """Number of misses in a row and their log probability, for a state that stores no looks."""
    n = min(state.n_missed + 1, _MOST_MISSES)
    return {"looked": np.empty((n, 0)), "log_evidence": state.log_evidence + log(max(evidence, _TINY))}


class OwnFilter:
    """A user's own: it begins where particles would, and has no recovery but its own."""

    def __init__(self, own: BeliefFilter) -> None:
        self._own = own

    def restored(self, model: TrackerModel, rows: Floats) -> Belief:
        return OwnBelief(rows, partial(self._own.states, model.radar))

    def born(self, model: TrackerModel, hit: Looks, rng: np.random.Generator) -> Belief:
        return self.begun(model, begin_about(model, hit, rng), rng)

    def begun(self, model: TrackerModel, states: Floats, rng: np.random.Generator) -> Belief:
        return self.restored(model, self._own.begin(model.radar, states, rng))

    def ahead(self, model: TrackerModel, state: TrackState, rng: Random) -> Floats | None:
        return self._own.predict(model.radar, state.belief.rows, rng())

    def observed(self, model: TrackerModel, state: TrackState, dwell: Dwell) -> Observed:
        looks, rng, predicted = dwell.looks, dwell.rng(), dwell.predicted
        if predicted is None:
            predicted = self._own.predict(model.radar, state.belief.rows, rng)
        rows, evidence = self._own.update(model.radar, predicted, observation_of(model, looks), rng)
        belief = self.restored(model, rows)
        memory = remembered_hit(looks) if looks.is_hit else _one_more_miss(state, min(evidence, 1.0))
        after = state._replace(belief=belief, depleted=False, **memory)
        return Observed(after, belief, evidence, model.of_modes(state.modes).modes)

    def coasted(self, model: TrackerModel, state: TrackState, rng: Random) -> TrackState:
        belief = self.restored(model, self._own.predict(model.radar, state.belief.rows, rng()))
        modes = model.of_modes(state.modes).modes
        return state._replace(belief=belief, modes=modes, **_one_more_miss(state, 1.0))


PARTICLES, MIXTURE = ParticleFilter(), MixtureFilter()


def guarded(filter_: Any, call: Caller) -> OwnFilter:
    """A user's own filter. Raises PluginRefused if it lacks a method."""
    return OwnFilter(guarded_filter(filter_, call))


def filter_of(model: TrackerModel) -> Filter:
    """The filter of a radar. Raises PluginRefused if it is a user's own and cannot be had in this process."""
    found: Filter = resolve(BELIEF, model.belief.filter)
    return found
