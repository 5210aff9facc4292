"""Re-acquisition: a track that is missed too often to be where its belief says begins again from its last detection.

Symbols: Z_k = P(o_k | B_k) probability of a miss under the belief; prod Z_k over the misses in a row, the probability
that the belief gives to all of them.
"""

from dataclasses import replace
from math import log

import numpy as np
from numpy.typing import NDArray

from shared.tracking.initiation import redraw_in_bin
from shared.tracking.model import NONE, TrackerModel, TrackState
from shared.tracking.particle_filter import Update, condition, predict, widen
from shared.tracking.sensor import Observation

_TINY = 1e-300  # of a probability
_MAX_MISSES = 100  # after so many the last detection says no more than the belief does


def reacquire(
    model: TrackerModel, state: TrackState, updated: Update, observation: Observation, rng: np.random.Generator
) -> TrackState:
    """The state with its updated belief, or with one that begins again: the misses in a row were too improbable.

    A detection explains itself and is remembered. Too many misses say that the model was wrong, most often about a
    velocity while the target was in one wide bin: their probability falls below `reacquire_below`. Half of the
    particles then stay what the model makes of them. The others are the target's belief at its last detection with all
    that is doubted forgotten: velocities as at its acquisition; every second range drawn anew from that detection
    alone; and, from the second attempt on, positions widened once per attempt. They live through the misses since, so
    that the cells seen empty stay excluded. The weights of the dwells that follow decide between the halves; nothing is
    drawn while nothing is doubted.
    """
    if observation.hit_bin >= 0:
        state = replace(
            state,
            remembered=NONE,
            hit_bin=observation.hit_bin,
            hit_amplitude=observation.amplitude,
            looked=np.empty((0, model.sensor.n_bin)),
            log_evidence=0.0,
            attempts=0,
        )
    elif model.belief.reacquire_below > 0.0:
        state = _remember_miss(state, observation.sigma, updated.evidence)
        if state.log_evidence < log(model.belief.reacquire_below):
            both = updated.particles.copy()
            both[1::2] = _begin_again(model, state, rng)
            updated = Update(both, depleted=True, evidence=updated.evidence)
            state = replace(state, log_evidence=0.0, attempts=state.attempts + 1)
        state = _bounded(state)
    return replace(state, particles=updated.particles, depleted=updated.depleted)


def coasted(model: TrackerModel, state: TrackState, predicted: NDArray[np.float64]) -> TrackState:
    """The state after a dwell of which nothing is known; who begins again lives through that dwell, too."""
    if model.belief.reacquire_below > 0.0:
        state = _bounded(_remember_miss(state, np.zeros(model.sensor.n_bin), evidence=1.0))
    return replace(state, particles=predicted)


def _remember_miss(state: TrackState, sigma: NDArray[np.float64], evidence: float) -> TrackState:
    """The state with one miss more, in cells with this sigma, (n_bin,); its belief is still the one before."""
    return replace(
        state,
        remembered=_remembered(state),
        looked=np.vstack((state.looked, sigma)),
        log_evidence=state.log_evidence + log(max(evidence, _TINY)),
    )


def _bounded(state: TrackState) -> TrackState:
    """Without its last detection once that is too long ago: the belief that follows takes its place."""
    if state.looked.shape[0] < _MAX_MISSES:
        return state
    return replace(state, remembered=NONE, hit_bin=-1, looked=state.looked[:0])


def _remembered(state: TrackState) -> NDArray[np.float64]:
    return state.remembered if state.remembered.size else state.particles


def _begin_again(model: TrackerModel, state: TrackState, rng: np.random.Generator) -> NDArray[np.float64]:
    """The belief of the last detection without what is doubted, every second particle of it; (n // 2, 4)."""
    particles = _remembered(state)[1::2].copy()
    if state.hit_bin >= 0:
        sigma = np.zeros(model.sensor.n_bin)
        sigma[state.hit_bin] = state.sigma_hat
        hit = Observation(state.hit_bin, state.hit_amplitude, sigma)
        particles[::2] = redraw_in_bin(model, particles[::2], hit, rng)
    for _ in range(state.attempts):
        particles = widen(particles, model.sensor.n_bin, rng)
    v_max = model.acquisition.v_max_km_s
    particles[:, 1::2] = rng.uniform(-v_max, v_max, (particles.shape[0], 2))
    for sigma in state.looked:
        particles = condition(model, predict(model.motion, particles, rng), Observation(-1, 0.0, sigma), rng).particles
    return particles
