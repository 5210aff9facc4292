"""What a scan of steered cells tells one track: its detection, or in which looks it was missed.

The looks of an adaptive track are those that were made for it, in the ranges of its gate; while every cell is tested
they are all cells. With wide looks a detection belongs to the track whose brightest beam is nearest, of those that
tested its cell. Of several echoes the one that the belief makes most probable is the track's; the looks of all other
detections tell it nothing. Where the scan says where all tracks were expected, they share its detections (`joint`).
"""

from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.signal.array import angle_bin
from shared.signal.looks import directions_everywhere, range_cells
from shared.tracking.association import is_acquisition, is_beam, own_detection, row_of, sigma_of
from shared.tracking.existence import p_fa_of
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_states
from shared.tracking.sensor import Detections, Floats
from shared.tracking.steered.echoes import Columns, Ints, detected_look, echoes, is_over
from shared.tracking.steered.joint import Share, share_of
from shared.tracking.steered.looks import FAR_KM, Aperture, Looks, likelihood_of, missed_looks
from shared.tracking.steered.resampling import weigh_looks

_BROAD = 1.0  # 1/variance of a direction that was not measured


class Own(NamedTuple):
    """The looks that were made for a track of an unknown number: what says whether there is a target at all."""

    is_looked: bool = False  # there was one,
    is_found: bool = False  # ... with a detection, and the track has one
    p_fa: float = 1.0  # that they have a false one, by the limit of the track's detection; 1 without one


class Told(NamedTuple):
    """What a scan tells a track."""

    looks: Looks
    power: float  # ||v||^2 of its look: that of its detection, or the mean over all its cells
    in_doubt: bool = False  # which detection is the track's
    own: Own = Own()  # if the number of tracks is unknown


def associate_looks(model: TrackerModel, aperture: Aperture, state: TrackState, scan: Detections) -> Told:
    """What the scan tells a track."""
    columns, gate = Columns.of(scan), (0.0, FAR_KM)
    rows = np.arange(columns.nus.size)
    if is_beam(model, scan):
        row = row_of(scan, state.target)
        gate = _gate(model, aperture, columns.gates[row])
        own = columns.beam_nus[row][scan.beams[row] >= 0]
        in_gate = (columns.ranges_km == 0.0) | ((columns.ranges_km > gate[0]) & (columns.ranges_km < gate[1]))
        rows = rows[np.isin(columns.nus, own) & in_gate]
    own_looks = Own()
    if scan.expected is None:
        share, missed = _alone(model, aperture, state, scan, rows, gate)
    else:
        share = share_of(aperture, scan, row_of(scan, state.target))
        missed = _missed_beside(aperture, scan, rows, share)
        own_looks = _own_looks(model, aperture, scan, (row_of(scan, state.target), share.row), rows)
    nus, first = np.unique(columns.nus[missed], return_index=True)
    sigma = sigma_of(model, state, scan, missed[first])
    if share.row >= 0:
        found = detected_look(aperture, scan, share.row, gate)
        nu_sigma = hypot(found.nu_sigma, share.drawn) if found.nu_sigma > 0.0 < share.drawn else found.nu_sigma
        looks = found._replace(nus=np.append(found.nus, nus), sigma=np.append(found.sigma, sigma), nu_sigma=nu_sigma)
        return Told(looks, float(scan.signature_power[share.row]), share.in_doubt, own_looks)
    limit = float(columns.limits[missed[0]]) if missed.size else model.sensor.threshold
    power = float(scan.signature_power[missed].mean()) if missed.size else state.power
    return Told(missed_looks(aperture, nus, sigma, limit, gate), power, share.in_doubt, own_looks)


def _own_looks(model: TrackerModel, aperture: Aperture, scan: Detections, track: tuple[int, int], rows: Ints) -> Own:
    """The looks of a track, which is this row of the roster and has the detection in this row of the scan; -1: none.

    Where power goes everywhere its look is that of the bin in which it is expected.

    rows : (n,) of the scan, those of its beams and gate; all if power goes everywhere
    """
    columns, (at, hit) = Columns.of(scan), track
    if is_beam(model, scan):
        n_direction, gate = int((scan.beams[at] >= 0).sum()), columns.gates[at]
    else:
        n_bin = model.sensor.n_bin
        n_direction, gate = directions_everywhere(n_bin, aperture.range_cell_km).size // n_bin, np.zeros(2)
        rows = rows[scan.bins[rows] == angle_bin(np.asarray(scan.expected)[at, 0], n_bin)]
    if hit < 0:
        return Own(rows.size > 0)
    low_km, high_km = _gate(model, aperture, gate)
    n_cell = round((high_km - low_km) / aperture.range_cell_km) if aperture.range_cell_km > 0.0 else 1
    p_fa = p_fa_of(float(columns.limits[hit]), max(n_direction, 1) * n_cell)
    return Own(rows.size > 0, bool(is_over(scan, rows).any()), p_fa)


def _alone(
    model: TrackerModel,
    aperture: Aperture,
    state: TrackState,
    scan: Detections,
    rows: Ints,
    gate: tuple[float, float],
) -> tuple[Share, Ints]:
    """A track's detection, where nobody knows where the others are, and the rows of its own in which it was missed."""
    columns, is_detected = Columns.of(scan), is_over(scan, rows)
    if model.wide_looks and is_beam(model, scan):
        is_own = ~is_detected | _is_nearest(scan, columns, row_of(scan, state.target), rows)
        rows, is_detected = rows[is_own], is_detected[is_own]
    hit = _own_echo(model, aperture, state, scan, echoes(aperture, scan, rows[is_detected]), gate)
    missed = rows[~np.isin(columns.nus[rows], columns.nus[rows[is_detected]])]
    return Share(hit), missed


def _missed_beside(aperture: Aperture, scan: Detections, rows: Ints, share: Share) -> Ints:
    """The rows of a track's own, (n,), in which it was missed: none if it is hidden, those of all looks if it has no
    detection and theirs are of other ranges, else those of looks without one.
    """
    if share.is_hidden:
        return rows[:0]
    if share.row < 0 and aperture.range_cell_km > 0.0:
        return rows
    nus = Columns.of(scan).nus[rows]
    return rows[~np.isin(nus, nus[is_over(scan, rows)])]


def _gate(model: TrackerModel, aperture: Aperture, asked_km: Floats) -> tuple[float, float]:
    """Ranges that were tested, km."""
    if aperture.range_cell_km == 0.0:
        return 0.0, FAR_KM
    if not asked_km.any():
        asked_km = np.array(model.acquisition.ranges_km)
    cells = range_cells(float(asked_km[0]), float(asked_km[1]), aperture.range_cell_km)
    return cells[0] * aperture.range_cell_km, (cells[-1] + 1) * aperture.range_cell_km


def _is_nearest(scan: Detections, columns: Columns, own: int, rows: Ints) -> NDArray[np.bool_]:
    """Whether of the tracks that tested a row's cell none has its brightest beam nearer than the own; (n,) -> (n,)."""
    nus, ranges_km = columns.nus[rows], columns.ranges_km[rows]
    is_lit = ((columns.beam_nus[:, np.newaxis] == nus[:, np.newaxis]) & (scan.beams >= 0)[:, np.newaxis]).any(axis=2)
    low_km, high_km = columns.gates[:, :1], columns.gates[:, 1:]
    is_tested = (high_km == 0.0) | (ranges_km == 0.0) | ((ranges_km > low_km) & (ranges_km < high_km))
    distances = np.where(is_lit & is_tested, np.abs(columns.beam_nus[:, :1] - nus), np.inf)
    return np.asarray(distances[own] == distances.min(axis=0))


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
