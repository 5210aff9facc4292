"""Re-acquisition: a track that is missed too often to be where its belief says begins again from its last detection.

Symbols: Z_k = P(o_k | B_k) probability of a miss under the belief; prod Z_k over the misses in a row, the probability
that the belief gives to all of them.
"""

from dataclasses import dataclass, field
from math import log

import numpy as np
from numpy.typing import NDArray

from shared.scenario.scenario import AcquisitionSection, BeliefSection
from shared.tracking.initiation import redraw_in_bin
from shared.tracking.motion import propagate_into
from shared.tracking.particle_filter import Motion, Observation, Sensor, Update, condition_on_miss, widen

_TINY = 1e-300  # of a probability
_MAX_MISSES = 100  # after so many the last detection says no more than the belief does


@dataclass
class Memory:
    """What a track keeps to begin again: its last detection, and the misses since."""

    particles: NDArray[np.float64]  # (n, 4) right after the detection
    hit: Observation | None  # None once it is too long ago to say where the target is now
    misses: list[Observation] = field(default_factory=list)
    log_evidence: float = 0.0  # log prod Z_k of the misses since the detection, or since the track began again
    attempts: int = 0  # times it began again without a detection


def reacquire(
    memory: Memory,
    updated: Update,
    observation: Observation,
    sensor: Sensor,
    motion: Motion,
    settings: BeliefSection,
    acquisition: AcquisitionSection,
    rng: np.random.Generator,
) -> Update:
    """The updated belief, or one that begins again if the misses in a row are less probable than `reacquire_below`.

    A detection explains itself and is remembered. Too many misses say that the model was wrong, most often about a
    velocity while the target was in one wide bin. Half of the particles then stay what the model makes of them. The
    others are the target's belief at its last detection with all that is doubted forgotten: velocities as at its
    acquisition; every second range drawn anew from that detection alone; and, from the second attempt on, positions
    widened once per attempt. They live through the misses since, so that the cells seen empty stay excluded. The
    weights of the dwells that follow decide between the halves; nothing is drawn while nothing is doubted.
    """
    if observation.hit_bin >= 0:
        memory.particles, memory.hit = updated.particles, observation
        memory.misses, memory.log_evidence, memory.attempts = [], 0.0, 0
        return updated
    if settings.reacquire_below == 0.0:
        return updated
    memory.misses.append(observation)
    memory.log_evidence += log(max(updated.evidence, _TINY))
    if memory.log_evidence < log(settings.reacquire_below):
        updated = _begin_again(memory, updated, sensor, motion, settings, acquisition, rng)
    if len(memory.misses) == _MAX_MISSES:
        memory.particles, memory.hit, memory.misses = updated.particles, None, []
    return updated


def _begin_again(
    memory: Memory,
    updated: Update,
    sensor: Sensor,
    motion: Motion,
    settings: BeliefSection,
    acquisition: AcquisitionSection,
    rng: np.random.Generator,
) -> Update:
    """Half the updated belief, half the one of the last detection without what is doubted."""
    particles = memory.particles[1::2].copy()
    if memory.hit is not None:
        particles[::2] = redraw_in_bin(particles[::2], memory.hit, sensor, acquisition, rng)
    for _ in range(memory.attempts):
        particles = widen(particles, sensor.n_bin, rng)
    particles[:, 1::2] = rng.uniform(-acquisition.v_max_km_s, acquisition.v_max_km_s, (particles.shape[0], 2))
    for miss in memory.misses:
        propagate_into(particles, motion, rng, particles)
        particles = condition_on_miss(particles, miss, sensor, settings, rng).particles
    memory.log_evidence, memory.attempts = 0.0, memory.attempts + 1
    both = updated.particles.copy()
    both[1::2] = particles
    return Update(both, depleted=True, evidence=updated.evidence)
