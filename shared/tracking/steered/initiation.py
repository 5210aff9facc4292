"""From scans, or from one detection, to beliefs of targets in steered cells.

Symbols: nu_c direction of a cell; D_T D_R its loss off axis; R_0 the range that would explain an amplitude on axis, so
that R = R_0 sqrt(D_T D_R(nu - nu_c)) explains it in direction nu.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from shared.signal.array import bin_centres
from shared.signal.radar_equation import amplitude
from shared.tracking.initiation import initial_belief, is_detected_in_sum, likely_ranges, redraw_in_bin
from shared.tracking.model import TrackerModel
from shared.tracking.resampling import DIM, resample
from shared.tracking.sensor import Detections, Floats, Observation
from shared.tracking.steered.echoes import Columns, detected_look, echoes, is_one_echo
from shared.tracking.steered.looks import FAR_KM, Aperture, Looks, anywhere, likelihood_of, off_axis_loss
from shared.tracking.steered.resampling import weigh_looks

Ints = NDArray[np.int64]

_AMPLITUDES, _STRONGER = 1024, 1.5  # nodes of a table over the amplitude; its end, over the strongest that was seen
_DIRECTIONS, _REACH = 96, 0.75  # cells over the directions of a first belief; how far they reach, in bins
_TINY = 1e-300
_LEAST_LOSS = 0.05  # of an amplitude off axis; a target still further off is not detected there


@dataclass
class _Cell:
    """Detections in one direction and range, the strongest of each echo of each scan."""

    row: int  # which is its bin
    places: list[tuple[int, int]] = field(default_factory=list)  # (scan, row)
    total: float = 0.0  # sum of the statistics,
    most: float = 0.0  # ... and the largest of them


class Candidates:
    """Where targets were detected in an acquisition, scan by scan.

    A target between two cells echoes in either or both, so that detections in neighbouring cells confirm each other.
    With range cells they must agree in range as well, as false alarms hardly ever do; of the largest statistic of many
    the sum over scans proves nothing. A track is in the bin where its echo is strongest, and no two are in one bin.
    """

    def __init__(self, model: TrackerModel, aperture: Aperture, scans: Sequence[Detections] = ()) -> None:
        self._model, self._aperture = model, aperture
        self._cells: dict[tuple[float, float], _Cell] = {}  # by direction and range
        self._n_scan, self._sums = 0, np.zeros(model.sensor.n_bin)
        for scan in scans:
            self.add(scan)

    def add(self, scan: Detections) -> None:
        """Take the next scan, of every cell."""
        columns = Columns.of(scan)
        for row in echoes(self._aperture, scan, np.flatnonzero(scan.statistic >= columns.limits)).tolist():
            where = float(columns.nus[row]), float(columns.ranges_km[row])
            cell, statistic = self._cells.setdefault(where, _Cell(row)), float(scan.statistic[row])
            cell.places.append((self._n_scan, row))
            cell.total, cell.most = cell.total + statistic, max(cell.most, statistic)
        self._n_scan, self._sums = self._n_scan + 1, self._sums + scan.statistic

    def bins(self) -> Ints | None:
        """Bins of the tracks, ascending, if every target is confirmed; else None."""
        picked, n_track = self._confirmed(), self._model.n_track
        return np.sort([cell.row for cell in picked[:n_track]]) if len(picked) >= n_track else None

    def detections_of(self, bin_: int) -> list[tuple[int, int]]:
        """The detections, (scan, row) in their order, of the target of this bin's track."""
        cells = list(self._cells.values())
        own = next(cell for cell in [*self._confirmed(), *cells] if cell.row == bin_)
        mates = self._mates()[cells.index(own)]
        return sorted(place for i in np.flatnonzero(mates) for place in cells[i].places)

    def _confirmed(self) -> list[_Cell]:
        """The cells of confirmed targets, in which each is strongest; the strongest targets first."""
        cells, mates, least = list(self._cells.values()), self._mates(), self._model.acquisition.confirmations
        in_sum = is_detected_in_sum(self._model, self._sums, self._n_scan)
        strength = mates @ np.array([cell.total for cell in cells])
        picked = list[int]()
        for i in np.lexsort((-np.array([cell.most for cell in cells]), -strength)).tolist():
            own = [cells[j].places for j in np.flatnonzero(mates[i])]
            is_often = max(map(len, own)) >= least or len({k for places in own for k, _ in places}) >= least
            is_new = not mates[i, picked].any() and cells[i].row not in {cells[j].row for j in picked}
            if is_often and in_sum[cells[i].row] and is_new:
                picked.append(i)
        return [cells[i] for i in picked]

    def _mates(self) -> NDArray[np.bool_]:
        """Whether detections in two cells may be of one target, (n, n)."""
        where = np.array(list(self._cells)).reshape(-1, 2)
        return is_one_echo(self._aperture, where[:, 0], where[:, 1], (where[:, :1], where[:, 1:]))


def begin_at(
    model: TrackerModel, aperture: Aperture, bin_: int, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[Floats, Looks, float]:
    """First belief of the target of this bin's track, (n_particle, 4); its newest detection, and ||v||^2 of that."""
    places = Candidates(model, aperture, scans).detections_of(bin_)
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

    The range is measured, or follows with the direction from the amplitudes of all scans. Directions as measured in
    the detections are not used: a weak target is detected when noise has made the sum channel too strong, which puts
    its direction too near to the axis; at the border of two bins by half, and the range by a seventh too far.
    """
    alpha_hat = np.array([scan.alpha_hat[bin_] for scan in scans])
    belief = initial_belief(model, bin_, alpha_hat, np.array([scan.sigma_hat[bin_] for scan in scans]), rng)
    if aperture.range_cell_km > 0.0 or not model.sensor.law.tells_range:
        range_km = float(np.median([_column(scans[k].ranges_km)[row] for k, row in places]))
        nu_c = float(np.mean([_column(scans[k].nus)[row] for k, row in places]))
        return _aimed(aperture, belief, nu_c, (0.0, 0.0), range_km, rng)
    nus, ranges_km = draw_places(model, aperture, bin_, scans, rng)
    return _placed(belief, ranges_km, nus)


def draw_places(
    model: TrackerModel, aperture: Aperture, bin_: int, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Directions and ranges of a target near the centre of a bin, (n_particle,) each, from the scans of all cells.

        p(R, nu | scans) ~ prod_c L_c(|alpha(R)| D_T D_R(nu - nu_c)),
        L_c(A) = prod_k f(|alpha_hat_kc| / sigma_hat_kc | A / sigma_hat_kc)

    R and the bearing uniform, c the bin and those beside it, which together tell how far off its axis the target is.
    """
    n_bin, law = model.sensor.n_bin, model.sensor.law
    bins = np.arange(max(bin_ - 1, 0), min(bin_ + 2, n_bin))
    centres = bin_centres(n_bin)
    strongest = max(float(np.abs(scan.alpha_hat[bins]).max()) for scan in scans)
    grid = np.linspace(0.0, _STRONGER * strongest, _AMPLITUDES + 1)
    tables = [_log_likelihood(law.log_likelihood, scans, int(bin_), grid) for bin_ in bins]
    reach = _REACH / (n_bin - 1)
    edges = np.clip(centres[bin_] + np.linspace(-reach, reach, _DIRECTIONS + 1), -0.5, 0.5)
    nus, log_prior = 0.5 * (edges[1:] + edges[:-1]), np.log(np.diff(np.arcsin(2.0 * edges)) + _TINY)
    losses = off_axis_loss(aperture, nus - centres[bins][:, np.newaxis])

    def log_p(range_km: Floats) -> Floats:
        at_range = amplitude(model.sensor.amplitude, range_km**2)[:, np.newaxis]
        looked_up = (np.interp(at_range * loss, grid, table) for loss, table in zip(losses, tables, strict=True))
        return np.asarray(sum(looked_up) + log_prior)

    ranges_km = likely_ranges(model, lambda range_km: np.logaddexp.reduce(log_p(range_km), axis=1))
    middles = 0.5 * (ranges_km[1:] + ranges_km[:-1])
    likelihood = log_p(middles)
    cdf = np.cumsum(np.exp(likelihood - likelihood.max()))
    drawn = np.searchsorted(cdf, rng.random(model.belief.n_particle) * cdf[-1], side="right")
    i, j = np.divmod(np.minimum(drawn, cdf.size - 1), nus.size)
    return rng.uniform(edges[j], edges[j + 1]), rng.uniform(ranges_km[i], ranges_km[i + 1])


def _log_likelihood(
    law: Callable[[Floats, Floats], Floats], scans: Sequence[Detections], bin_: int, amplitudes: Floats
) -> Floats:
    """Of each amplitude of the echo in a cell, from all scans that have a noise estimate; (n,) -> (n,)."""
    seen = [(abs(scan.alpha_hat[bin_]), float(scan.sigma_hat[bin_])) for scan in scans if scan.sigma_hat[bin_] > 0.0]
    return np.asarray(sum((law(np.array(a / s), amplitudes / s) for a, s in seen), np.zeros(amplitudes.size)))


def begin_about(model: TrackerModel, hit: Looks, rng: np.random.Generator) -> Floats:
    """Belief of a target after its first detection, (n_particle, 4): of its velocity nothing is known."""
    v_max = model.acquisition.v_max_km_s
    belief = np.zeros((model.belief.n_particle, DIM))
    belief[:, 1::2] = rng.uniform(-v_max, v_max, (model.belief.n_particle, 2))
    if hit.range_km == 0.0:
        return redraw_looks(model, belief, hit, rng)
    return _aimed(hit.aperture, belief, float(hit.nus[hit.hit]), (hit.nu_hat, hit.nu_sigma), hit.range_km, rng)


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


def _column(values: Floats | None) -> Floats:
    """A column that every scan of steered cells has."""
    return np.asarray(values)
