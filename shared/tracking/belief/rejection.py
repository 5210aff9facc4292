"""The paper's belief update: rejection sampling by the generator of the POMDP.

Symbols: B_t belief; G(s, a) generator of the POMDP; o observation; Z = P(o | B_t) evidence.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.array import angle_bin
from cogradar.shared.signal.radar_equation import amplitude, strength
from cogradar.shared.tracking.belief.likelihood import Looks, likelihood_of
from cogradar.shared.tracking.motion import Motion, advance, draw_turn, has_turns, mode_quantile
from cogradar.shared.tracking.sensor import Sensor, interpolate, level_band, level_of


class Accepted(NamedTuple):
    """What a generated observation must be: a detection in a bin with |alpha_hat|/sigma in a band, or a miss below."""

    hit_bin: int  # -1: a miss
    gain: NDArray[np.float64]  # (n_bin,) |alpha|/sigma at 1 km; 0 in a cell that was not looked at
    low: float
    high: float
    start: float
    log_p: NDArray[np.float64]  # (n,) of what is not generated: table of its `Likelihood`; else empty
    is_log: bool
    by_range: bool


def accepted(sensor: Sensor, looks: Looks) -> Accepted:
    """What equals the real observation."""
    likelihood = likelihood_of(sensor, looks)
    gain, is_hit = np.zeros(sensor.n_bin), looks.is_hit
    gain[angle_bin(looks.nus, sensor.n_bin)] = likelihood.gains
    band = level_band(level_of(looks.amplitude), sensor.threshold) if is_hit else (0.0, sqrt(0.5 * sensor.threshold))
    log_p, start = likelihood.miss_log_p, likelihood.miss_start
    if is_hit:
        log_p, start = likelihood.hit_log_p, likelihood.hit_start
    if not (sensor.is_exact and is_hit) and not sensor.law.fluctuates:
        log_p = np.empty(0)
    return Accepted(looks.hit_bin, gain, *band, start, log_p, likelihood.is_log, likelihood.by_range)


@kernel
def sample_by_rejection(
    particles: NDArray[np.float64], real: Accepted, motion: Motion, max_tries: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], int, int]:
    """Draw s from B_t, run G(s, a_t), keep s' if its observation equals the real one; until n are kept.

    particles : (n, 4) of B_t
    max_tries : n max_tries draws at most
    returns   : (n, 4) of which the first n_kept rows are set; n_kept; draws made, so that Z is about n_kept / draws

    The phase of the echo is taken as 0: the law of |alpha_hat| does not depend on it. No generated amplitude equals
    one that is read itself: s' is then kept with the probability of the real one. So it is if the RCS fluctuates.
    """
    n, n_kept, n_try = particles.shape[0], 0, 0
    kept = np.empty_like(particles)
    hit_bin, gain = real.hit_bin, real.gain
    low_sq, high_sq = real.low * real.low, real.high * real.high
    for _ in range(n * max_tries):
        n_try += 1
        i = int(n * rng.random())
        x, vx, y, vy = particles[i, 0], particles[i, 1], particles[i, 2], particles[i, 3]
        w_x = motion.sigma_s * rng.standard_normal()
        w_y = motion.sigma_s * rng.standard_normal()
        if has_turns(motion):
            turn_x, turn_y = draw_turn(motion, vx, vy, mode_quantile(n_try), rng)
            w_x, w_y = w_x + turn_x, w_y + turn_y
        x, vx, y, vy = advance(x, vx, y, vy, motion.dt, w_x, w_y)
        b = bin_of(x, y, gain.size)
        if hit_bin >= 0 and b != hit_bin:
            continue
        if gain[b] > 0.0 and real.log_p.size > 0:
            u = strength(gain[b], x * x + y * y, real.by_range)
            if rng.random() >= interpolate(u, real.start, real.log_p, real.is_log):
                continue
        elif gain[b] > 0.0:
            re = amplitude(gain[b], x * x + y * y) + np.sqrt(0.5) * rng.standard_normal()
            im = np.sqrt(0.5) * rng.standard_normal()
            power = re * re + im * im
            if power < low_sq or power >= high_sq:
                continue
        kept[n_kept, 0], kept[n_kept, 1], kept[n_kept, 2], kept[n_kept, 3] = x, vx, y, vy
        n_kept += 1
        if n_kept == n:
            break
    return kept, n_kept, n_try
