"""From the first scans to the first beliefs: which bins hold the targets, and where in its bin each one may be.

Symbols: k scan; alpha_hat_k, sigma_hat_k amplitude of a cell and its standard deviation; R range in km; nu = 0.5 sin
theta spatial frequency of the bearing theta.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from shared.signal.array import bin_centres
from shared.signal.radar_equation import amplitude
from shared.tracking.model import TrackerModel
from shared.tracking.resampling import DIM, resample, weigh
from shared.tracking.sensor import (
    Detections,
    Observation,
    likelihood_table,
    log_hit_probability,
)

LogLikelihood = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # of ranges in km, (n,) -> (n,)

_GRID = 256  # cells of a grid over range that looks for the posterior
_ZOOMS = 3  # 200 km / (256/2)^3 is 0.1 m: finer than any posterior of range
_FINE = 1024  # cells of the grid over the posterior
_NEGLIGIBLE = 40.0  # log ratio to the mode: exp(-40) of it, some 9 standard deviations away


def initiate(model: TrackerModel, scans: Sequence[Detections]) -> NDArray[np.int64] | None:
    """Bins of the tracks, in the order of the track numbers, once every target is detected; else None.

    scans   : those of the acquisition so far; each tests every cell
    returns : (n_track,) ascending bins

    A bin is confirmed by `confirmations` detections over all scans, as long as the statistics of all scans are one in
    sum, too. The scans that follow the first after which enough bins are confirmed are not read: every process finds
    the same tracks, however many scans it has by the time it looks.
    If that scan confirms more bins than there are targets, those with the largest sum of statistics are kept: a
    target's statistic is large in each scan, a false alarm's barely above the threshold and small in all other scans.
    """
    statistic = np.array([scan.statistic for scan in scans])
    detected, least = statistic >= model.sensor.threshold, model.acquisition.confirmations
    often = np.flatnonzero(detected.sum(axis=0) >= least)
    if often.size < model.n_track:
        return None
    sums = np.cumsum(statistic[:, often], axis=0)
    confirmed = np.cumsum(detected[:, often], axis=0) >= least
    confirmed &= is_detected_in_sum(model, sums, np.arange(1, len(scans) + 1)[:, np.newaxis])
    complete = np.flatnonzero(confirmed.sum(axis=1) >= model.n_track)
    if complete.size == 0:
        return None
    candidates = np.flatnonzero(confirmed[complete[0]])
    strongest = np.argsort(-sums[complete[0], candidates], kind="stable")[: model.n_track]
    return np.sort(often[candidates[strongest]])


def is_detected_in_sum(
    model: TrackerModel, sums: NDArray[np.float64], n_scan: NDArray[np.int64] | int
) -> NDArray[np.bool_]:
    """Whether a cell's statistics, summed over n_scan scans, are a detection too.

        sum_k Lambda_k ~ chi-square with 2 n_scan degrees of freedom under H0           (non-coherent integration)

    A weak target may take hundreds of scans until it has been detected twice, and in a hundred scans one cell in 20 000
    has two false alarms. The scans in which nothing was detected know the difference: of a target that is detected in
    one scan of fifty the mean statistic is 6, of disturbance 2. (In arrays of few channels it is up to a fifth more, so
    that sums over long acquisitions prove less there.) The first detections of a strong target always suffice.
    """
    return np.asarray(sums >= chdtri(2 * n_scan, model.p_fa))


def initial_belief(
    model: TrackerModel,
    bin_: int,
    alpha_hat: NDArray[np.complexfloating],
    sigma_hat: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Belief of a target that has been held still in a bin while the scans were made.

        p(R | scans) ~ prod_k f(|alpha_hat_k| / sigma_hat_k | |alpha(R)| / sigma_hat_k),  R uniform in
                       [range_min, range_max], f by the law of the echoes: Rice's, if the RCS is known

    alpha_hat : (n_scan,) complex, every scan of the bin
    sigma_hat : (n_scan,) > 0; a scan with 0 (no noise estimate) is left out
    returns   : (n_particle, 4), bearings uniform within the bin, velocities uniform within +-v_max

    Scans below the threshold count as well: a weak target is detected on upward fluctuations only, so that detections
    alone put it too near. For the same reason range is a posterior and not the inversion of one amplitude. Nothing is
    learned of the range if nothing is known of the RCS.
    """
    law = model.sensor.law
    used = sigma_hat > 0.0
    sigma = sigma_hat[used].astype(np.float64)
    r = np.abs(alpha_hat[used]).astype(np.float64) / sigma
    gain = model.sensor.amplitude / sigma

    def log_likelihood(range_km: NDArray[np.float64]) -> NDArray[np.float64]:
        if not law.tells_range:
            return np.zeros(range_km.size)
        likelihoods = law.log_likelihood(r[:, None], amplitude(gain[:, None], range_km**2))
        return np.asarray(likelihoods.sum(axis=0))

    belief, v_max = np.empty((model.belief.n_particle, 4)), model.acquisition.v_max_km_s
    belief[:, 0::2] = _draw_positions(model, bin_, log_likelihood, belief.shape[0], rng)
    belief[:, 1::2] = rng.uniform(-v_max, v_max, (belief.shape[0], 2))
    return belief


def redraw_in_bin(
    model: TrackerModel, particles: NDArray[np.float64], hit: Observation, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Belief after a detection that no particle explains: the target is in that bin all the same.

        p(R | r) ~ P(r | R),  R uniform in [range_min, range_max]

    particles : (n, 4) propagated; returns (n, 4) with their velocities and new positions in `hit.hit_bin`
    """
    gain = model.sensor.amplitude / hit.sigma[hit.hit_bin]

    def log_likelihood(range_km: NDArray[np.float64]) -> NDArray[np.float64]:
        return log_hit_probability(model.sensor, hit.amplitude, amplitude(gain, range_km**2))

    belief = particles.copy()
    belief[:, 0::2] = _draw_positions(model, hit.hit_bin, log_likelihood, particles.shape[0], rng)
    return belief


def turn_into_bin(
    model: TrackerModel, particles: NDArray[np.float64], hit: Observation, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Belief after a detection in a bin where only a few particles were expected; None if no range explains it.

        p(s | r) ~ P(r | R(s)) over all particles, whatever their bin; bearings uniform within the bin

    particles : (n, 4) propagated; returns (n, 4)

    Range and bearing of a particle have little to do with each other: that the target is at the edge of what was
    expected of its bearing is no reason to forget its range, or to believe the range of those few alone.
    """
    n_bin = model.sensor.n_bin
    anywhere = np.full(n_bin, hit.sigma[hit.hit_bin])
    weighted = weigh(particles, likelihood_table(model.sensor, hit._replace(sigma=anywhere))._replace(hit_bin=-1))
    if weighted.total**2 < (DIM + 1) * weighted.total_sq or weighted.total == 0.0:
        return None
    turned: NDArray[np.float64] = particles[resample(weighted, rng.random())]
    theta = _draw_bearings(hit.hit_bin, n_bin, particles.shape[0], rng)
    range_km = np.hypot(turned[:, 0], turned[:, 2])
    turned[:, 0::2] = range_km[:, None] * np.column_stack((np.cos(theta), np.sin(theta)))
    return turned


def doubted(model: TrackerModel, predicted: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Particles, (n, 4), every second of which has flown the last dwell at a velocity drawn anew, as at acquisition.

    For a target that has turned: nearly constant velocity is the motion model, so that a belief that is left by its
    target is wrong about the velocity first, and about the position by what follows from that.
    """
    v_max, particles = model.acquisition.v_max_km_s, predicted.copy()
    turned = particles[::2]
    velocities = rng.uniform(-v_max, v_max, (turned.shape[0], 2))
    turned[:, 0::2] += model.motion.dt * (velocities - turned[:, 1::2])
    turned[:, 1::2] = velocities
    np.maximum(turned[:, 0], 0.0, out=turned[:, 0])
    return particles


def _draw_positions(
    model: TrackerModel, bin_: int, log_likelihood: LogLikelihood, n: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Positions (n, 2) in a bin: ranges from their posterior, bearings uniform in angle (no direction preferred)."""
    range_km = _draw_ranges(model, log_likelihood, n, rng)
    theta = _draw_bearings(bin_, model.sensor.n_bin, n, rng)
    return np.asarray(range_km[:, None] * np.column_stack((np.cos(theta), np.sin(theta))))


def _draw_bearings(bin_: int, n_bin: int, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Bearings (n,) in rad, uniform within a bin."""
    # A hair inside the bin, for rounding; bins 0 and n_bin-1 reach beyond end-fire, where there is nothing.
    half = 0.5 / (n_bin - 1) * (1.0 - 1e-9)
    low, high = np.arcsin(2.0 * np.clip(bin_centres(n_bin)[bin_] + np.array([-half, half]), -0.5, 0.5))
    return rng.uniform(low, high, n)


def _draw_ranges(
    model: TrackerModel, log_likelihood: LogLikelihood, n: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Ranges (n,) from prior times likelihood, by the inverse of its distribution function on a grid."""
    grid = likely_ranges(model, log_likelihood)
    log_p = log_likelihood(grid)
    density = np.exp(log_p - log_p.max())
    cdf = np.concatenate(([0.0], np.cumsum(density[1:] + density[:-1])))
    return np.asarray(np.interp(rng.random(n), cdf / cdf[-1], grid))


def likely_ranges(model: TrackerModel, log_likelihood: LogLikelihood) -> NDArray[np.float64]:
    """Grid over the ranges that are not out of the question, ascending.

    The likelihood of R has a single mode (that of either law has in u, for one scan as for a product), which may be
    metres wide in 200 km: the grid closes in on it.
    """
    low, high = model.acquisition.ranges_km
    for _ in range(_ZOOMS):
        grid = np.linspace(low, high, _GRID + 1)
        log_p = log_likelihood(grid)
        likely = np.flatnonzero(log_p >= log_p.max() - _NEGLIGIBLE)
        low, high = grid[max(likely[0] - 1, 0)], grid[min(likely[-1] + 1, _GRID)]
    return np.linspace(low, high, _FINE + 1)
