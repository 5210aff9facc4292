"""The belief of one target: an unweighted particle filter (Bouhou et al. 2025, "The unweighted particle filter").

Symbols: B_t belief, n particles [x, vx, y, vy]; o observation; G(s, a) generator of the POMDP; Z = P(o | B_t) evidence;
n_eff = (sum w)^2 / sum w^2 effective sample size of weights w; h bandwidth of the regularising kernel, in units of the
belief's own standard deviation.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.jit import kernel
from shared.scenario.scenario import AcquisitionSection, BeliefSection
from shared.signal.angle import bin_of
from shared.signal.radar_equation import amplitude
from shared.tracking.initiation import redraw_in_bin
from shared.tracking.motion import Motion, advance, draw_acceleration, propagate_into
from shared.tracking.resampling import DIM, moments, optimal_bandwidth, regularise, systematic_resample
from shared.tracking.sensor import Observation, Sensor, gain_of, interpolate, observed_band, table_of

__all__ = [
    "Motion",
    "Observation",
    "Sensor",
    "Update",
    "condition_on_miss",
    "update",
    "update_predicted",
    "update_rejection",
    "update_resample",
    "widen",
]

_WIDENINGS = 4  # tries to explain a miss


class Update(NamedTuple):
    """Belief after a dwell, and whether its observation had to be explained by a recovery."""

    particles: NDArray[np.float64]  # (n, 4)
    depleted: bool
    evidence: float  # Z, how probable the observation was before any recovery


def update(
    particles: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    motion: Motion,
    settings: BeliefSection,
    acquisition: AcquisitionSection,
    rng: np.random.Generator,
) -> Update:
    """Belief after one dwell, B_{t+1} from B_t and o_{t+1}; never fails.

    When no particle explains the observation the belief was wrong, not the receiver. After a hit the target is in
    that bin, wherever the particles are: positions are redrawn there, velocities kept. After a miss it has left the
    cells looked at: the belief is widened until enough of it lies where the target may have gone.
    """
    if settings.update == "rejection":
        result = update_rejection(particles, observation, sensor, motion, settings.max_tries, rng)
        return _recover(result, observation, sensor, settings, acquisition, rng)
    predicted = np.empty_like(particles)
    propagate_into(particles, motion, rng, predicted)
    return update_predicted(predicted, observation, sensor, settings, acquisition, rng)


def update_predicted(
    predicted: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    settings: BeliefSection,
    acquisition: AcquisitionSection,
    rng: np.random.Generator,
) -> Update:
    """The rest of `update` by resampling, for particles that have been propagated with the same generator before."""
    result = _condition(predicted, observation, sensor, settings.kernel_bandwidth, settings.max_tries, rng)
    return _recover(result, observation, sensor, settings, acquisition, rng)


def _recover(
    result: Update,
    observation: Observation,
    sensor: Sensor,
    settings: BeliefSection,
    acquisition: AcquisitionSection,
    rng: np.random.Generator,
) -> Update:
    """The update, or a belief that can explain the observation if it could not."""
    if not result.depleted:
        return result
    if observation.hit_bin >= 0:
        redrawn = redraw_in_bin(result.particles, observation, sensor, acquisition, rng)
        return Update(redrawn, depleted=True, evidence=result.evidence)
    predicted, evidence = result.particles, result.evidence
    for _ in range(_WIDENINGS):
        predicted = widen(predicted, sensor.n_bin, rng)
        result = condition_on_miss(predicted, observation, sensor, settings, rng)
        if not result.depleted:
            break
    return Update(result.particles, depleted=True, evidence=evidence)


def condition_on_miss(
    predicted: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    settings: BeliefSection,
    rng: np.random.Generator,
) -> Update:
    """Particles that have been propagated, conditioned on a miss; as they are if they do not explain it."""
    return _condition(predicted, observation, sensor, settings.kernel_bandwidth, settings.max_tries, rng)


def update_rejection(
    particles: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    motion: Motion,
    max_tries: int,
    rng: np.random.Generator,
) -> Update:
    """The paper's update: draw s from B_t, run G(s, a_t), keep s' if its observation equals the real one.

    Until n are kept, or n max_tries drawn: the kept ones are then repeated; if there are none, the belief is only
    propagated and `depleted`.
    """
    kept = np.empty_like(particles)
    low, high = observed_band(observation, sensor.threshold)
    gain = gain_of(observation, sensor)
    n, n_try = _reject(particles, gain, observation.hit_bin, low, high, motion, max_tries, rng, kept)
    if n == 0:
        propagate_into(particles, motion, rng, kept)
        return Update(kept, depleted=True, evidence=0.0)
    kept[n:] = kept[np.arange(kept.shape[0] - n) % n]
    return Update(kept, depleted=False, evidence=n / n_try)


def update_resample(
    particles: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    motion: Motion,
    kernel_bandwidth: float,
    rng: np.random.Generator,
    max_tries: int = 100,
) -> Update:
    """The same posterior at a fixed cost: propagate all, weight with P(o | s'), resample, regularise.

    kernel_bandwidth : share of the optimal bandwidth; 0 leaves the resampled particles as they are
    max_tries        : sets the limit of depletion, see `_condition`

    A depleted belief is only propagated.
    """
    predicted = np.empty_like(particles)
    propagate_into(particles, motion, rng, predicted)
    return _condition(predicted, observation, sensor, kernel_bandwidth, max_tries, rng)


def _condition(
    predicted: NDArray[np.float64],
    observation: Observation,
    sensor: Sensor,
    kernel_bandwidth: float,
    max_tries: int,
    rng: np.random.Generator,
) -> Update:
    """Weight with the observation, resample and regularise particles that have been propagated.

    Nothing explains the observation if rejection would be expected to keep less than one particle in all its n
    max_tries draws, n max_tries Z < 1: both updates then give up on the same evidence. With a kernel, also if n_eff
    is below 5: fewer than d + 1 points span no volume, and their covariance says nothing about the belief's.
    """
    n = predicted.shape[0]
    weights = np.empty(n)
    start, log_p = table_of(observation, sensor)
    total, total_sq, uniform = weigh(
        predicted, gain_of(observation, sensor), observation.hit_bin, start, log_p, weights
    )
    evidence = total / n
    if total * max_tries < 1.0:
        return Update(predicted, depleted=True, evidence=evidence)
    if uniform:  # the observation says nothing; resampling and jitter would only add noise
        return Update(predicted, depleted=False, evidence=evidence)
    n_eff = total * total / total_sq
    if kernel_bandwidth > 0.0 and n_eff < DIM + 1:
        return Update(predicted, depleted=True, evidence=evidence)
    ancestors = np.empty(n, dtype=np.int64)
    systematic_resample(weights, total, rng.random(), ancestors)
    if kernel_bandwidth == 0.0:
        return Update(predicted[ancestors], depleted=False, evidence=evidence)
    out = np.empty_like(predicted)
    h = kernel_bandwidth * optimal_bandwidth(n_eff)
    regularise(predicted, weights, total, ancestors, h, observation.hit_bin, observation.sigma > 0.0, rng, out)
    return Update(out, depleted=False, evidence=evidence)


def widen(particles: NDArray[np.float64], n_bin: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Particles spread out to twice their covariance and by the width of an angle bin at their range.

    The bin's width, 2 R/(n_bin - 1) at boresight, is what separates a cell that was missed from the next one; without
    it a belief that has collapsed onto one ancestor would stay where it is.
    """
    n = particles.shape[0]
    _, factor = moments(particles, np.ones(n), float(n))
    widened = particles + rng.standard_normal((n, DIM)) @ factor.T
    width = 2.0 / (n_bin - 1) * np.hypot(particles[:, 0], particles[:, 2])
    widened[:, 0::2] += width[:, None] * rng.standard_normal((n, 2))
    np.maximum(widened[:, 0], 0.0, out=widened[:, 0])
    return widened


@kernel
def weigh(
    states: NDArray[np.float64],
    gain: NDArray[np.float64],
    hit_bin: int,
    start: float,
    log_p: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[float, float, bool]:
    """Likelihood of the observation for each state; their sum, sum of squares, and whether all are the same.

    hit:  1{bin(s) = hit_bin} P(level | u);  miss: 1 - P_D(u) in a cell looked at, 1 elsewhere
    """
    total, total_sq, uniform = 0.0, 0.0, True
    for i in range(states.shape[0]):
        x, y = states[i, 0], states[i, 2]
        b = bin_of(x, y, gain.size)
        if hit_bin >= 0 and b != hit_bin:
            weight = 0.0
        elif gain[b] > 0.0:
            weight = interpolate(amplitude(gain[b], x * x + y * y), start, log_p)
        else:
            weight = 1.0
        weights[i] = weight
        total += weight
        total_sq += weight * weight
        uniform = uniform and weight == weights[0]
    return total, total_sq, uniform


@kernel
def _reject(
    particles: NDArray[np.float64],
    gain: NDArray[np.float64],
    hit_bin: int,
    low: float,
    high: float,
    motion: Motion,
    max_tries: int,
    rng: np.random.Generator,
    kept: NDArray[np.float64],
) -> tuple[int, int]:
    """Run the generator until `kept` is full; returns how many were kept, of how many tries.

    Its observation equals the real one if low <= |alpha_hat|/sigma < high in the cell looked at. The phase of the
    echo is taken as 0: the law of |alpha_hat| does not depend on it.
    """
    n, count, n_try = particles.shape[0], 0, 0
    low_sq, high_sq = low * low, high * high
    for _ in range(n * max_tries):
        n_try += 1
        i = int(n * rng.random())
        w_x, w_y = draw_acceleration(motion, rng)
        s = particles[i]
        x, vx, y, vy = advance(s[0], s[1], s[2], s[3], motion.dt, w_x, w_y)
        b = bin_of(x, y, gain.size)
        if hit_bin >= 0 and b != hit_bin:
            continue
        if gain[b] > 0.0:
            real = amplitude(gain[b], x * x + y * y) + np.sqrt(0.5) * rng.standard_normal()
            imag = np.sqrt(0.5) * rng.standard_normal()
            power = real * real + imag * imag
            if power < low_sq or power >= high_sq:
                continue
        kept[count, 0], kept[count, 1], kept[count, 2], kept[count, 3] = x, vx, y, vy
        count += 1
        if count == n:
            break
    return count, n_try
