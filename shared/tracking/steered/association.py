"""What a scan of steered cells tells one track: its detection, or in which looks it was missed.

The looks of an adaptive track are those that were made for it, in the ranges of its gate; while every cell is tested
they are all cells. With wide looks a detection belongs to the track whose brightest beam is nearest, of those that
tested its cell. A target between two cells is over the limit in both: of detections that may be one echo the strongest
counts. Of several echoes the one that the belief makes most probable is the track's; the looks of all other
detections tell it nothing.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from shared.signal.looks import range_cells
from shared.tracking.association import amplitude_of, is_acquisition, is_beam, own_detection, sigma_of
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_states
from shared.tracking.sensor import Detections, Floats
from shared.tracking.steered.looks import FAR_KM, Aperture, Looks, likelihood_of, missed_looks
from shared.tracking.steered.resampling import weigh_looks

Ints = NDArray[np.int64]

_BROAD = 1.0  # 1/variance of a direction that was not measured
NEIGHBOURS = 1.5  # lobes, or range cells, between two cells that may both have the echo of one target


class Columns(NamedTuple):
    """What a scan of steered cells has beside that of bins; shapes and units as there."""

    nus: Floats
    limits: Floats
    ranges_km: Floats
    nu_hats: Floats
    nu_sigmas: Floats
    beam_nus: Floats
    gates: Floats

    @classmethod
    def of(cls, scan: Detections) -> Self:
        """Those of a scan that has them, as every scan of a radar with steered cells."""
        return cls(*(getattr(scan, name) for name in cls._fields))


def associate_looks(
    model: TrackerModel, aperture: Aperture, state: TrackState, scan: Detections
) -> tuple[Looks, float]:
    """What the scan tells a track, and ||v||^2 of its look: that of its detection, or the mean over all its cells."""
    columns, gate = Columns.of(scan), (0.0, FAR_KM)
    rows = np.arange(columns.nus.size)
    if is_beam(model, scan):
        gate = _gate(model, aperture, columns.gates[state.target])
        own = columns.beam_nus[state.target][scan.beams[state.target] >= 0]
        in_gate = (columns.ranges_km == 0.0) | ((columns.ranges_km > gate[0]) & (columns.ranges_km < gate[1]))
        rows = rows[np.isin(columns.nus, own) & in_gate]
    is_detected = scan.statistic[rows] >= columns.limits[rows]
    if model.wide_looks and is_beam(model, scan):
        is_own = ~is_detected | _is_nearest(scan, columns, state.target, rows)
        rows, is_detected = rows[is_own], is_detected[is_own]
    hit = _own_echo(model, aperture, state, scan, echoes(aperture, scan, rows[is_detected]), gate)
    missed = rows[~np.isin(columns.nus[rows], columns.nus[rows[is_detected]])]
    nus, first = np.unique(columns.nus[missed], return_index=True)
    sigma = sigma_of(model, state, scan, missed[first])
    if hit >= 0:
        found = detected_look(aperture, scan, hit, gate)
        looks = found._replace(nus=np.append(found.nus, nus), sigma=np.append(found.sigma, sigma))
        return looks, float(scan.signature_power[hit])
    limit = float(columns.limits[missed[0]]) if missed.size else model.sensor.threshold
    power = float(scan.signature_power[missed].mean()) if missed.size else state.power
    return missed_looks(aperture, nus, sigma, limit, gate), power


def detected_look(aperture: Aperture, scan: Detections, row: int, gate: tuple[float, float]) -> Looks:
    """The look of a detection in a row of the scan."""
    columns = Columns.of(scan)
    nu_hat, nu_sigma, range_km, limit = (
        float(column[row]) for column in (columns.nu_hats, columns.nu_sigmas, columns.ranges_km, columns.limits)
    )
    own = slice(row, row + 1)
    amplitude, sigma = amplitude_of(scan, row), scan.sigma_hat[own].astype(np.float64)
    return Looks(aperture, 0, amplitude, nu_hat, nu_sigma, range_km, columns.nus[own], sigma, limit, *gate)


def echoes(aperture: Aperture, scan: Detections, rows: Ints) -> Ints:
    """Of the rows of detections, (n,), the strongest of each echo, in the order of the scan."""
    columns, found = Columns.of(scan), list[int]()
    if rows.size < 2:
        return rows
    for row in rows[np.argsort(-scan.statistic[rows], kind="stable")].tolist():
        own = float(columns.nus[row]), float(columns.ranges_km[row])
        if not is_one_echo(aperture, columns.nus[found], columns.ranges_km[found], own).any():
            found.append(row)
    return np.sort(np.array(found, dtype=np.int64))


def is_one_echo(
    aperture: Aperture, nus: Floats, ranges_km: Floats, other: tuple[float | Floats, float | Floats]
) -> NDArray[np.bool_]:
    """Whether detections in these directions and range cells, (n,), may be of the target of others, (nu, R)."""
    near = np.abs(nus - other[0]) < NEIGHBOURS * aperture.lobe
    if aperture.range_cell_km > 0.0:
        near &= np.abs(ranges_km - other[1]) < NEIGHBOURS * aperture.range_cell_km
    return np.asarray(near)


def _gate(model: TrackerModel, aperture: Aperture, asked_km: Floats) -> tuple[float, float]:
    """Ranges that were tested, km."""
    if aperture.range_cell_km == 0.0:
        return 0.0, FAR_KM
    if not asked_km.any():
        asked_km = np.array(model.acquisition.ranges_km)
    cells = range_cells(float(asked_km[0]), float(asked_km[1]), aperture.range_cell_km)
    return cells[0] * aperture.range_cell_km, (cells[-1] + 1) * aperture.range_cell_km


def _is_nearest(scan: Detections, columns: Columns, target: int, rows: Ints) -> NDArray[np.bool_]:
    """Whether of the tracks that tested a row's cell none has its brightest beam nearer than this one; (n,) -> (n,)."""
    nus, ranges_km = columns.nus[rows], columns.ranges_km[rows]
    is_lit = ((columns.beam_nus[:, np.newaxis] == nus[:, np.newaxis]) & (scan.beams >= 0)[:, np.newaxis]).any(axis=2)
    low_km, high_km = columns.gates[:, :1], columns.gates[:, 1:]
    is_tested = (high_km == 0.0) | (ranges_km == 0.0) | ((ranges_km > low_km) & (ranges_km < high_km))
    distances = np.where(is_lit & is_tested, np.abs(columns.beam_nus[:, :1] - nus), np.inf)
    return np.asarray(distances[target] == distances.min(axis=0))


def _own_echo(
    model: TrackerModel,
    aperture: Aperture,
    state: TrackState,
    scan: Detections,
    rows: Ints,
    gate: tuple[float, float],
) -> int:
    """Row of the track's detection, of those of different echoes, (n,); -1: none of them."""
    if rows.size == 0:
        return -1
    if model.tests_every_cell and not is_acquisition(scan):
        return own_detection(model, state, scan, rows)
    if rows.size == 1 and not is_acquisition(scan):
        return int(rows[0])
    expected = predicted_states(state.particles, model.motion.dt)
    each = [likelihood_of(model.sensor, detected_look(aperture, scan, row, gate)) for row in rows.tolist()]
    # Densities of what was measured: a broad measurement must not win by its breadth.
    totals = np.array([weigh_looks(expected, one).total * max(one.nu_precision, _BROAD) ** 0.5 for one in each])
    if is_acquisition(scan) and totals.max() == 0.0:
        return -1
    return int(rows[np.lexsort((-scan.statistic[rows], -totals))[0]])
