"""From scans, or from one detection, to beliefs of targets in steered cells.

Symbols: nu_c direction of a cell; D_T D_R its loss off axis; R_0 the range that would explain an amplitude on axis, so
that R = R_0 sqrt(D_T D_R(nu - nu_c)) explains it in direction nu.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from shared.signal.array import bin_centres
from shared.tracking.initiation import initial_belief, redraw_in_bin
from shared.tracking.model import TrackerModel
from shared.tracking.resampling import DIM, resample
from shared.tracking.sensor import Detections, Floats, Observation
from shared.tracking.steered.association import detected_look, echoes, is_one_echo
from shared.tracking.steered.looks import FAR_KM, Aperture, Looks, anywhere, likelihood_of, off_axis_loss
from shared.tracking.steered.resampling import weigh_looks

Ints = NDArray[np.int64]

_LEAST_LOSS = 0.05  # of an amplitude off axis; a target still further off is not detected there


class _Found(NamedTuple):
    """Detections of the acquisition, the strongest of each echo of each scan; (n,)."""

    scan: Ints  # ascending
    row: Ints  # which is its bin
    statistic: Floats
    nus: Floats
    ranges_km: Floats


def initiate_looks(model: TrackerModel, aperture: Aperture, scans: Sequence[Detections]) -> Ints | None:
    """Bins of the tracks, ascending, once every target is detected; else None. `initiate` for steered cells.

    A target between two cells echoes in either or both, so that detections in neighbouring cells confirm each other.
    With range cells they must agree in range as well, as false alarms hardly ever do. A track is in the bin where its
    echo is strongest, and no two are in one bin.
    """
    found = _detections(aperture, scans)
    if len(_confirmed(model, aperture, found)) < model.n_track:
        return None  # nor were they earlier: each scan is asked about when it comes, some hundred with range cells
    for k in np.unique(found.scan).tolist():
        before = found.scan <= k
        picked = _confirmed(model, aperture, _Found(*(column[before] for column in found)))
        if len(picked) >= model.n_track:
            return np.sort(found.row[picked[: model.n_track]])
    return None


def begin_at(
    model: TrackerModel, aperture: Aperture, bin_: int, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[Floats, Looks, float]:
    """First belief of the target of this bin's track, (n_particle, 4); its newest detection, and ||v||^2 of that."""
    found = _detections(aperture, scans)
    own = [i for i in _confirmed(model, aperture, found) if found.row[i] == bin_]
    mates = _mates(aperture, found, [*own, *np.flatnonzero(found.row == bin_).tolist()][0])
    places = list(zip(found.scan[mates].tolist(), found.row[mates].tolist(), strict=True))
    k, row = places[-1]
    looks = detected_look(aperture, scans[k], row, (0.0, FAR_KM))
    return _belief_of(model, aperture, bin_, scans, places, rng), looks, float(scans[k].signature_power[row])


def _belief_of(
    model: TrackerModel,
    aperture: Aperture,
    bin_: int,
    scans: Sequence[Detections],
    places: Sequence[tuple[int, int]],
    rng: np.random.Generator,
) -> Floats:
    """Belief of a target that has been held still, (n_particle, 4), from its detections at these (scan, row).

    The range is measured, or its posterior from all amplitudes in the track's own cell; the direction is the mean of
    what was measured, else anywhere in half of the main lobe.
    """
    nu_hats, sigmas, ranges_km = (_read(scans, places, name) for name in ("nu_hats", "nu_sigmas", "ranges_km"))
    is_measured = sigmas > 0.0
    precision = float((sigmas[is_measured] ** -2.0).sum())
    nu_hat = float((nu_hats[is_measured] * sigmas[is_measured] ** -2.0).sum() / precision) if precision else 0.0
    direction = (nu_hat, precision**-0.5) if precision else (0.0, 0.0)
    alpha_hat = np.array([scan.alpha_hat[bin_] for scan in scans])
    belief = initial_belief(model, bin_, alpha_hat, np.array([scan.sigma_hat[bin_] for scan in scans]), rng)
    nu_c = float(bin_centres(model.sensor.n_bin)[bin_])
    return _aimed(aperture, belief, nu_c, direction, float(np.median(ranges_km)), rng)


def redraw_looks(model: TrackerModel, particles: Floats, looks: Looks, rng: np.random.Generator) -> Floats:
    """Belief after a detection that no particle explains, (n, 4): about what was measured; velocities are kept."""
    n_bin, nu = model.sensor.n_bin, float(looks.nus[looks.hit])
    hit = Observation(n_bin // 2, looks.amplitude, np.full(n_bin, looks.hit_sigma))
    limited = replace(model, sensor=model.sensor._replace(threshold=looks.limit))
    belief = redraw_in_bin(limited, particles, hit, rng)
    return _aimed(looks.aperture, belief, nu, (looks.nu_hat, looks.nu_sigma), looks.range_km, rng)


def turn_to_look(model: TrackerModel, particles: Floats, looks: Looks, rng: np.random.Generator) -> Floats | None:
    """Belief after a detection in a direction in which few particles were expected; None if no range explains it.

    `turn_into_bin` for steered cells: over all particles, wherever they are, ranges as the detection leaves them.
    """
    weighted = weigh_looks(particles, anywhere(likelihood_of(model.sensor, looks)))
    if weighted.total**2 < (DIM + 1) * weighted.total_sq or weighted.total == 0.0:
        return None
    turned: Floats = particles[resample(weighted, rng.random())]
    direction = looks.nu_hat, looks.nu_sigma
    nu = _draw_directions(looks.aperture, float(looks.nus[looks.hit]), direction, turned.shape[0], rng)
    return _placed(turned, np.hypot(turned[:, 0], turned[:, 2]), nu)


def _aimed(
    aperture: Aperture,
    belief: Floats,
    nu_c: float,
    direction: tuple[float, float],
    range_km: float,
    rng: np.random.Generator,
) -> Floats:
    """Particles with ranges R_0 of a cell in nu_c, (n, 4), put where direction and range were measured, if so."""
    nu = _draw_directions(aperture, nu_c, direction, belief.shape[0], rng)
    if range_km > 0.0:
        half = 0.5 * aperture.range_cell_km
        return _placed(belief, np.maximum(rng.uniform(range_km - half, range_km + half, nu.size), 0.0), nu)
    loss = np.maximum(off_axis_loss(aperture, nu - nu_c), _LEAST_LOSS)
    return _placed(belief, np.hypot(belief[:, 0], belief[:, 2]) * np.sqrt(loss), nu)


def _draw_directions(
    aperture: Aperture, nu_c: float, direction: tuple[float, float], n: int, rng: np.random.Generator
) -> Floats:
    """Directions (n,) in front of the array: N(nu_hat, nu_sigma^2); anywhere in half of the main lobe if sigma is 0."""
    nu_hat, nu_sigma = direction
    if nu_sigma == 0.0:
        low, high = np.clip(nu_c + 0.5 * aperture.lobe * np.array([-1.0, 1.0]), -0.5, 0.5)
        return rng.uniform(low, high, n)
    low, high = ndtr((np.array([-0.5, 0.5]) - nu_hat) / nu_sigma)
    return np.clip(nu_hat + nu_sigma * ndtri(rng.uniform(low, high, n)), -0.5, 0.5)


def _placed(belief: Floats, range_km: Floats, nu: Floats) -> Floats:
    """The same velocities at these ranges and directions."""
    placed = belief.copy()
    placed[:, 0], placed[:, 2] = range_km * np.sqrt(1.0 - 4.0 * nu**2), range_km * 2.0 * nu
    return placed


def _detections(aperture: Aperture, scans: Sequence[Detections]) -> _Found:
    limits, places = np.array([scan.limits for scan in scans]), list[tuple[int, int]]()
    is_detected = np.array([scan.statistic for scan in scans]) >= limits
    for k in np.flatnonzero(is_detected.any(axis=1)).tolist():
        places += [(k, row) for row in echoes(aperture, scans[k], np.flatnonzero(is_detected[k])).tolist()]
    at = np.array(places, dtype=np.int64).reshape(-1, 2)
    read = (_read(scans, places, name) for name in ("statistic", "nus", "ranges_km"))
    return _Found(at[:, 0], at[:, 1], *read)


def _read(scans: Sequence[Detections], places: Sequence[tuple[int, int]], name: str) -> Floats:
    """One column of a scan's rows, at these places (scan, row), (n,)."""
    return np.array([getattr(scans[k], name)[row] for k, row in places], dtype=np.float64)


def _mates(aperture: Aperture, found: _Found, i: int) -> Ints:
    """Detections that may be of the same target, (n,) ascending, itself among them."""
    near = is_one_echo(aperture, found.nus, found.ranges_km, (float(found.nus[i]), float(found.ranges_km[i])))
    return np.flatnonzero(near)


def _confirmed(model: TrackerModel, aperture: Aperture, found: _Found) -> list[int]:
    """One detection of each confirmed target, in the cell where it is strongest; the strongest targets first."""
    mates = [_mates(aperture, found, i) for i in range(found.row.size)]
    strength = np.array([found.statistic[own].sum() for own in mates])
    picked, rows, is_taken = list[int](), set[int](), np.zeros(found.row.size, dtype=np.bool_)
    for i in np.lexsort((-found.statistic, -strength)).tolist():
        if is_taken[i] or int(found.row[i]) in rows:
            continue
        if np.unique(found.scan[mates[i]]).size >= model.acquisition.confirmations:
            picked.append(i)
            rows.add(int(found.row[i]))
            is_taken[mates[i]] = True
    return picked
