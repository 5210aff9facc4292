"""From scans, or from one detection, to beliefs: which bins hold the targets, and where each one may be.

Symbols: k scan; alpha_hat_k, sigma_hat_k amplitude of a cell and its standard deviation; R range in km; nu = 0.5 sin
theta spatial frequency of the bearing theta; nu_c direction of a look, D_T D_R its loss off axis.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import arcsin, exp, interpolated, log, log_sum_exp
from cogradar.shared.signal.array import at_own_end, bin_centres, mean_direction, spatial_frequency
from cogradar.shared.signal.radar_equation import amplitude
from cogradar.shared.signal.response import draw_positions, placed
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.acquisition import detections_of
from cogradar.shared.tracking.association import detected_look
from cogradar.shared.tracking.belief.likelihood import Looks, anywhere, likelihood_of
from cogradar.shared.tracking.belief.resampling import DIM, resample, weigh
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import Floats, heard, log_hit_probability

Ints = NDArray[np.int64]
LogLikelihood = Callable[[Floats], Floats]  # of ranges in km, (n,) -> (n,)

_GRID = 256  # cells of a grid over range that looks for the posterior
_ZOOMS = 3  # 200 km / (256/2)^3 is 0.1 m: finer than any posterior of range
_FINE = 1024  # cells of the grid over the posterior
_NEGLIGIBLE = 40.0  # log ratio to the mode: exp(-40) of it, some 9 standard deviations away
_AMPLITUDES, _STRONGER = 1024, 1.5  # nodes of a table over the amplitude; its end, over the strongest that was seen
_DIRECTIONS, _REACH = 96, 0.75  # cells over the directions of a first belief; how far they reach, in bins
_TINY = 1e-300


def begin_at(
    model: TrackerModel, bin_: int, range_km: float, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[Floats, Looks, float]:
    """First belief of the target of this bin's track, (n_particle, 4); its newest detection, and ||v||^2 of that."""
    places = detections_of(model, scans, bin_, range_km)
    k, row = places[-1]
    looks = detected_look(model.response, scans[k], row)
    looks = looks._replace(limit=min(looks.limit, 2.0 * looks.amplitude**2))  # one that stands for a detection
    return _belief_of(model, bin_, scans, places, rng), looks, float(scans[k].signature_power[row])


def _belief_of(
    model: TrackerModel,
    bin_: int,
    scans: Sequence[Detections],
    places: Sequence[tuple[int, int]],
    rng: np.random.Generator,
) -> Floats:
    """Belief of a target that has been held still, (n_particle, 4), from its detections at these (scan, row).

    The range is measured, or follows with the direction from the amplitudes of all scans. Directions as measured in
    the detections are not used: a weak target is detected when noise has made the sum channel too strong, which puts
    its direction too near to the axis. At the border of two bins it is too near by half, and the range is a seventh too
    far.
    """
    response = model.response
    alpha_hat = np.array([scan.alpha_hat[bin_] for scan in scans])
    belief = initial_belief(model, bin_, alpha_hat, np.array([scan.sigma_hat[bin_] for scan in scans]), rng)
    if response.is_box or response.measures_range or not model.sensor.law.tells_range:
        range_km = float(np.median([scans[k].ranges_km[row] for k, row in places]))
        nu_c = float(np.mean([scans[k].nus[row] for k, row in places]))
        return response.aimed(belief, nu_c, (0.0, 0.0), range_km, rng)
    nus, ranges_km = draw_places(model, bin_, scans, rng)
    return placed(belief, ranges_km, nus)


def initial_belief(
    model: TrackerModel,
    bin_: int,
    alpha_hat: NDArray[np.complexfloating],
    sigma_hat: Floats,
    rng: np.random.Generator,
) -> Floats:
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
    r = heard(alpha_hat[used]).astype(np.float64) / sigma
    gain = model.sensor.amplitude / sigma

    def log_likelihood(range_km: Floats) -> Floats:
        likelihoods = law.log_likelihood(r[:, None], amplitude(gain[:, None], range_km**2))
        return np.asarray(likelihoods.sum(axis=0))

    belief, v_max = np.empty((model.belief.n_particle, 4)), model.acquisition.v_max_km_s
    range_km = _draw_ranges(model, log_likelihood, belief.shape[0], rng)
    belief[:, 0::2] = draw_positions(bin_, model.sensor.n_bin, range_km, rng)
    belief[:, 1::2] = rng.uniform(-v_max, v_max, (belief.shape[0], 2))
    return belief


def draw_places(
    model: TrackerModel, bin_: int, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Directions and ranges of a target near the centre of a bin, (n_particle,) each, from the scans of all cells.

        p(R, nu | scans) ~ prod_c L_c(|alpha(R)| D_T D_R(nu - nu_c)),
        L_c(A) = prod_k f(|alpha_hat_kc| / sigma_hat_kc | A / sigma_hat_kc)

    R and the bearing uniform, c the bin and those beside it, which together tell how far off its axis the target is.
    """
    n_bin, law = model.sensor.n_bin, model.sensor.law
    bins = np.arange(max(bin_ - 1, 0), min(bin_ + 2, n_bin))
    centres = bin_centres(n_bin)
    strongest = max(float(heard(scan.alpha_hat[bins]).max()) for scan in scans)
    grid = np.linspace(0.0, _STRONGER * strongest, _AMPLITUDES + 1)
    tables = [_log_likelihood(law.log_likelihood, scans, int(bin_), grid) for bin_ in bins]
    reach = _REACH / (n_bin - 1)
    edges = np.clip(centres[bin_] + np.linspace(-reach, reach, _DIRECTIONS + 1), -0.5, 0.5)
    nus, log_prior = 0.5 * (edges[1:] + edges[:-1]), log(np.diff(arcsin(2.0 * edges)) + _TINY)
    losses = model.response.loss(nus - centres[bins][:, np.newaxis])

    def log_p(range_km: Floats) -> Floats:
        at_range = amplitude(model.sensor.amplitude, range_km**2)[:, np.newaxis]
        looked_up = (interpolated(at_range * loss, grid, table) for loss, table in zip(losses, tables, strict=True))
        return np.asarray(sum(looked_up) + log_prior)

    ranges_km = likely_ranges(model, lambda range_km: log_sum_exp(log_p(range_km)))
    middles = 0.5 * (ranges_km[1:] + ranges_km[:-1])
    likelihood = log_p(middles)
    cdf = np.cumsum(exp(likelihood - likelihood.max()))
    drawn = np.searchsorted(cdf, rng.random(model.belief.n_particle) * cdf[-1], side="right")
    i, j = np.divmod(np.minimum(drawn, cdf.size - 1), nus.size)
    return rng.uniform(edges[j], edges[j + 1]), rng.uniform(ranges_km[i], ranges_km[i + 1])


def _log_likelihood(
    law: Callable[[Floats, Floats], Floats], scans: Sequence[Detections], bin_: int, amplitudes: Floats
) -> Floats:
    """Of each amplitude of the echo in a cell, from all scans that have a noise estimate; (n,) -> (n,)."""
    seen = [
        (float(heard(scan.alpha_hat[bin_])), float(scan.sigma_hat[bin_]))
        for scan in scans
        if scan.sigma_hat[bin_] > 0.0
    ]
    return np.asarray(sum((law(np.array(a / s), amplitudes / s) for a, s in seen), np.zeros(amplitudes.size)))


def begin_about(model: TrackerModel, hit: Looks, rng: np.random.Generator) -> Floats:
    """Belief of a target after its first detection, (n_particle, 4): of its velocity nothing is known."""
    v_max = model.acquisition.v_max_km_s
    belief = np.zeros((model.belief.n_particle, DIM))
    belief[:, 1::2] = rng.uniform(-v_max, v_max, (model.belief.n_particle, 2))
    if hit.range_km == 0.0:
        return redraw(model, belief, hit, rng)
    return hit.response.aimed(belief, hit.hit_nu, (hit.nu_hat, hit.nu_sigma), hit.range_km, rng)


def redraw(model: TrackerModel, particles: Floats, hit: Looks, rng: np.random.Generator) -> Floats:
    """Belief after a detection that no particle explains, (n, 4): the target is there all the same.

        p(R | r) ~ P(r | R),  R uniform in [range_min, range_max]

    particles : (n, 4) propagated, which keep their velocities; positions are about what was measured
    """
    sensor, gain = model.sensor._replace(threshold=hit.limit), model.sensor.amplitude / hit.hit_sigma

    def log_likelihood(range_km: Floats) -> Floats:
        return log_hit_probability(sensor, hit.amplitude, amplitude(gain, range_km**2))

    belief, bin_ = particles.copy(), hit.response.bin_for_ranges(hit.hit_nu)
    range_km = _draw_ranges(model, log_likelihood, particles.shape[0], rng)
    belief[:, 0::2] = draw_positions(bin_, sensor.n_bin, range_km, rng)
    return hit.response.aimed(belief, hit.hit_nu, _measured_by(particles, hit), hit.range_km, rng)


def turn(model: TrackerModel, particles: Floats, hit: Looks, rng: np.random.Generator) -> Floats | None:
    """Belief after a detection where only a few particles were expected; None if no range explains it.

        p(s | r) ~ P(r | R(s)) over all particles, wherever they are; bearings as the detection has them

    particles : (n, 4) propagated; returns (n, 4)

    Range and bearing of a particle have little to do with each other. A target at the edge of its expected bearings is
    no reason to forget its range, or to believe the range of those few alone.
    """
    weighted = weigh(particles, anywhere(likelihood_of(model.sensor, hit)))
    if weighted.total**2 < (DIM + 1) * weighted.total_sq or weighted.total == 0.0:
        return None
    turned: Floats = particles[resample(weighted, rng.random())]
    return hit.response.turned(turned, hit.hit_nu, _measured_by(turned, hit), rng)


def _measured_by(particles: Floats, hit: Looks) -> tuple[float, float]:
    """Measured direction and its standard deviation, of a track that is here."""
    nu = hit.nu_hat
    if abs(nu) > 0.5 - hit.response.lobe:
        nu = at_own_end(nu, hit.nu_sigma, mean_direction(spatial_frequency(particles))[0])
    return min(max(nu, -0.5), 0.5), hit.nu_sigma


def doubted(model: TrackerModel, predicted: Floats, rng: np.random.Generator) -> Floats:
    """Particles, (n, 4), every second of which has flown the last dwell at a velocity drawn anew, as at acquisition.

    For a target that has turned. The motion model is nearly constant velocity, so that a belief that is left by its
    target is wrong about the velocity first, and about the position as a consequence.
    """
    v_max, particles = model.acquisition.v_max_km_s, predicted.copy()
    turned = particles[::2]
    velocities = rng.uniform(-v_max, v_max, (turned.shape[0], 2))
    turned[:, 0::2] += model.motion.dt * (velocities - turned[:, 1::2])
    turned[:, 1::2] = velocities
    np.maximum(turned[:, 0], 0.0, out=turned[:, 0])
    return particles


def _draw_ranges(model: TrackerModel, log_likelihood: LogLikelihood, n: int, rng: np.random.Generator) -> Floats:
    """Ranges (n,) from prior times likelihood, by the inverse of its distribution function on a grid."""
    log_likelihood = model.sensor.law.of_range(log_likelihood)
    grid = likely_ranges(model, log_likelihood)
    log_p = log_likelihood(grid)
    density = exp(log_p - log_p.max())
    cdf = np.concatenate(([0.0], np.cumsum(density[1:] + density[:-1])))
    return interpolated(rng.random(n), cdf / cdf[-1], grid)


def likely_ranges(model: TrackerModel, log_likelihood: LogLikelihood) -> Floats:
    """Grid over the ranges that are not out of the question, ascending.

    The likelihood of R has a single mode, as either law has in u, for one scan as for a product. It may be metres wide
    in 200 km: the grid closes in on it.
    """
    low, high = model.acquisition.ranges_km
    for _ in range(_ZOOMS):
        grid = np.linspace(low, high, _GRID + 1)
        log_p = log_likelihood(grid)
        likely = np.flatnonzero(log_p >= log_p.max() - _NEGLIGIBLE)
        low, high = grid[max(likely[0] - 1, 0)], grid[min(likely[-1] + 1, _GRID)]
    return np.linspace(low, high, _FINE + 1)
