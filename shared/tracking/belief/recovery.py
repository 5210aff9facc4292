"""Re-acquisition: a track that is missed too often to be where its belief says begins again from its last detection.

Symbols: Z_k = P(o_k | B_k) probability of a miss under the belief; prod Z_k over the misses in a row, the probability
that the belief gives to all of them.
"""

from math import exp, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.likelihood import Looks, found_look, missed_looks
from cogradar.shared.tracking.belief.particle_filter import Update, condition, predict, widen
from cogradar.shared.tracking.initiation import redraw
from cogradar.shared.tracking.model import NONE, TrackerModel, TrackState

_TINY = 1e-300  # of a probability
_MAX_MISSES = 100  # after so many the last detection says no more than the belief does


def reacquire(
    model: TrackerModel, state: TrackState, updated: Update, looks: Looks, rng: np.random.Generator
) -> TrackState:
    """The state with its updated belief, or with one that begins again: the misses in a row were too improbable.

    A detection explains itself and is remembered. Too many misses say that the model was wrong, most often about a
    velocity while the target was in one wide bin: their probability falls below `reacquire_below`. Half of the
    particles then stay what the model makes of them. The others are the target's belief at its last detection with all
    that is doubted forgotten. Velocities are as at its acquisition, and every second range is drawn anew from that
    detection alone. From the second attempt on positions are widened once per attempt. They live through the misses
    since, so that the cells seen empty stay excluded. The weights of the dwells that follow decide between the halves;
    nothing is drawn while nothing is doubted.
    """
    if looks.is_hit:
        return state._replace(belief=Particles(updated.particles), depleted=updated.depleted, **remembered_hit(looks))
    state = _remember_miss(model, state, _as_row(looks, state), updated.evidence)
    if exp(state.log_evidence) < model.belief.reacquire_below:
        both = updated.particles.copy()
        both[1::2] = _begin_again(model, state, rng)
        updated = updated._replace(particles=both, depleted=True)
        state = state._replace(log_evidence=0.0, attempts=state.attempts + 1)
    return _bounded(state)._replace(belief=Particles(updated.particles), depleted=updated.depleted)


def coasted(model: TrackerModel, state: TrackState, predicted: NDArray[np.float64]) -> TrackState:
    """The state after a dwell without information; particles that begin again live through that dwell, too."""
    missed = _remember_miss(model, state, np.zeros(model.response.memory_width), evidence=1.0)
    return _bounded(missed)._replace(belief=Particles(predicted))


def remembered_hit(hit: Looks) -> dict[str, Any]:
    """What a state remembers from its detection on, its belief apart from that."""
    return {
        "remembered": NONE,
        "hit_bin": hit.hit_bin,
        "hit_amplitude": hit.amplitude,
        "measured": np.array([hit.hit_nu, hit.nu_hat, hit.nu_sigma, hit.range_km]),
        "looked": np.empty((0, hit.response.memory_width)),
        "log_evidence": 0.0,
        "attempts": 0,
    }


def _last_hit(model: TrackerModel, state: TrackState) -> Looks:
    """The detection that a state remembers."""
    nu, nu_hat, nu_sigma, range_km = state.measured.tolist()
    limit, r = model.sensor.threshold, state.hit_amplitude
    return found_look(model.response, nu, state.sigma_hat, limit, r, (nu_hat, nu_sigma, range_km))


def _as_row(miss: Looks, state: TrackState) -> NDArray[np.float64]:
    """A dwell's miss as a state remembers it, (`Response.memory_width`,)."""
    limits = miss.limit, miss.low_km, miss.high_km
    return miss.response.row_of(miss.nus, miss.sigma, limits, float(spatial_frequency(state.belief.rows.mean(axis=0))))


def _as_miss(model: TrackerModel, row: NDArray[np.float64]) -> Looks:
    nus, sigma, (limit, *gate_km) = model.response.looks_of(row, model.sensor.threshold)
    return missed_looks(model.response, nus, sigma, limit, (gate_km[0], gate_km[1]))


def _remember_miss(model: TrackerModel, state: TrackState, row: NDArray[np.float64], evidence: float) -> TrackState:
    """The state with one miss more, of the cells in this row; its belief is still the one before."""
    if model.belief.reacquire_below == 0.0:
        return state
    return state._replace(
        remembered=_remembered(state),
        looked=np.vstack((state.looked, row)),
        log_evidence=state.log_evidence + log(max(evidence, _TINY)),
    )


def _bounded(state: TrackState) -> TrackState:
    """Without its last detection once that is too long ago: the belief that follows takes its place."""
    if state.looked.shape[0] < _MAX_MISSES:
        return state
    return state._replace(remembered=NONE, hit_bin=-1, looked=state.looked[:0])


def _remembered(state: TrackState) -> NDArray[np.float64]:
    return state.remembered if state.remembered.size else state.belief.rows


def _begin_again(model: TrackerModel, state: TrackState, rng: np.random.Generator) -> NDArray[np.float64]:
    """The belief of the last detection without what is doubted, every second particle of it; (n // 2, 4)."""
    particles = _remembered(state)[1::2].copy()
    if state.hit_bin >= 0:
        particles[::2] = redraw(model, particles[::2], _last_hit(model, state), rng)
    for _ in range(state.attempts):
        particles = widen(particles, model.sensor.n_bin, rng)
    v_max = model.acquisition.v_max_km_s
    particles[:, 1::2] = rng.uniform(-v_max, v_max, (particles.shape[0], 2))
    for row in state.looked:
        particles = condition(model, predict(model.motion, particles, rng), _as_miss(model, row), rng).particles
    return particles
