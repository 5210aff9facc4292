"""What a scan tells one track: its detection, or in which looks it was missed.

The looks of an adaptive track are those that were made for it, in the ranges of its gate; two that share one share what
it finds. With wide looks a detection belongs to the track whose brightest beam is nearest, of the tracks that tested
its cell. A look that was widened over the cell of another target must not be captured by it. Of several echoes the one
that the belief makes most probable is the track's; the looks of all other detections tell it nothing. Where the scan
says where all tracks were expected, they share its detections (`assignment`).

The orthogonal strategy tests all cells for all tracks, and one detection belongs to one track:

1. Each detection goes to the track that asked for the nearest bin, the closest pairs first, and no more than one to
   each track (suboptimal nearest neighbour; Blackman 1986). Nothing but the scan is needed, which carries all requests:
   workers that own different tracks agree.
2. A track accepts it in the bins where it expects particles and `gate_bins` beyond, where an adaptive track would look.
   A detection there that no particle expected redraws the belief as it does for an adaptive track; anywhere else it is
   a false alarm.
3. The cells of all other detections tell the track nothing: they hold no miss. In the cells without one it was missed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.array import angle_bin, apart, mean_direction, spatial_frequency
from cogradar.shared.signal.looks import directions_everywhere, range_cells
from cogradar.shared.signal.response import FAR_KM, Response, strongest_of_each
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.assignment.shares import Share, share_of
from cogradar.shared.tracking.belief.likelihood import (
    Looks,
    found_look,
    likelihood_of,
    missed_looks,
    shares_looked_at,
)
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.existence import TrackLooks, p_fa_of
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import predicted_bins, predicted_states
from cogradar.shared.tracking.sensor import MAX_AMPLITUDE, Floats, heard

Ints = NDArray[np.int64]
Gate = tuple[float, float]  # ranges, km

MOST_COVERED = 0.9  # of a belief, in the looks of an older waveform: with less of it they are not aimed at the target
MOST_LOST = 0.01  # of a belief, in range cells that were not received: with more of it a track coasts
_BROAD = 1.0  # 1/variance of a direction that was not measured
_SIGMAS = 4.0  # of a belief, around which a detection in the looks of an older waveform may be its own
_AS_TOLD = 3.0  # standard deviations from where an older roster expects a track, within which it still is right
_ROUNDING = 1e-9  # of a direction: two tracks are as near


class Association(NamedTuple):
    """What a scan tells a track."""

    looks: Looks
    power: float  # ||v||^2 of its look: at its detection, or the mean over all its cells
    is_looked: bool = True  # it says something: a look was made, and no echo of another target hides the track's own
    in_doubt: bool = False  # which detection is the track's
    own: TrackLooks = TrackLooks()  # if the number of tracks is unknown


def associate(model: TrackerModel, state: TrackState, scan: Detections) -> Association:
    """What the scan tells a track."""
    at = scan.row_of(state.target)
    rows, gate = _own_rows(model, scan, at)
    if _is_lost(model, state, scan):
        looks = missed_looks(model.response, np.empty(0), np.empty(0), model.sensor.threshold, gate)
        return Association(looks, state.power, is_looked=False, own=TrackLooks(is_unmeasured=True))
    if scan.expected is None:
        share, missed = _alone(model, state, scan, rows, gate)
        own = TrackLooks()
    elif scan.age > 0 and not _is_as_told(model, state, scan, at):
        share, missed = _by_belief(model, state, scan, rows, gate)
        own = _track_looks(model, scan, at, share, rows, gate)
    else:
        share = share_of(model.response, scan, at)
        missed = _missed_beside(model.response, scan, rows, share)
        own = _track_looks(model, scan, at, share, rows, gate)
    nus, sigma = _missed_directions(model, state, scan, missed)
    if share.row >= 0:
        looks = detected_look(model.response, scan, share.row, gate)
        if looks.nu_sigma > 0.0 < share.drawn:
            looks = looks._replace(nu_sigma=hypot(looks.nu_sigma, share.drawn))
        if nus.size:
            looks = looks._replace(nus=np.append(looks.nus, nus), sigma=np.append(looks.sigma, sigma))
        return Association(looks, float(scan.signature_power[share.row]), in_doubt=share.in_doubt, own=own)
    limit = float(scan.limits[missed[0]]) if missed.size else model.sensor.threshold
    power = float(scan.signature_power[missed].mean()) if missed.size else state.power
    looks = missed_looks(model.response, nus, sigma, limit, gate)
    own = own._replace(is_stale=_is_stale(model, state, scan, looks))
    is_looked = nus.size > 0 or (scan.expected is None and rows.size > 0)
    return Association(looks, power, is_looked, share.in_doubt, own)


def _is_lost(model: TrackerModel, state: TrackState, scan: Detections) -> bool:
    """Whether a target may be in a range cell that was not received: whatever else was found, it is no miss."""
    if scan.lost_km is None:
        return False
    expected = predicted_states(state.belief.sample(), model.motion.dt)
    ranges_km = hypot(expected[:, 0], expected[:, 2])
    return bool(scan.is_lost(ranges_km, model.response.range_cell_km).mean() > MOST_LOST)


def _is_as_told(model: TrackerModel, state: TrackState, scan: Detections, at: int) -> bool:
    """Whether a track in this row of the roster is still expected about where the roster of an older waveform says."""
    nu, nu_sigma, range_km, range_sigma = (float(value) for value in np.asarray(scan.expected)[at, :4])
    expected, response = predicted_states(state.belief.sample(), model.motion.dt), model.response
    off_nu = float(apart(mean_direction(spatial_frequency(expected))[0], nu))
    off_km = abs(float(hypot(expected[:, 0], expected[:, 2]).mean()) - range_km)
    is_there = not response.measures_range or off_km < _AS_TOLD * range_sigma + response.range_cell_km
    return is_there and off_nu < _AS_TOLD * nu_sigma + 0.5 * response.lobe


def _is_stale(model: TrackerModel, state: TrackState, scan: Detections, looks: Looks) -> bool:
    """Whether looks are of an older waveform, and the target is expected elsewhere by now: a miss says no more than the
    belief does.
    """
    if scan.age == 0 or scan.expected is None:
        return False
    expected = predicted_states(state.belief.sample(), model.motion.dt)
    return bool(shares_looked_at(looks, expected).sum() < MOST_COVERED)


def is_beam(model: TrackerModel, scan: Detections) -> bool:
    """Whether a track that was lit in this dwell was lit by a beam, and not by the orthogonal waveform."""
    return not (model.tests_every_cell or scan.is_acquisition)


def detected_look(response: Response, scan: Detections, row: int, gate: Gate = (0.0, FAR_KM)) -> Looks:
    """The look of a detection in a row of the scan."""
    columns = (scan.nus, scan.sigma_hat, scan.limits, scan.nu_hats, scan.nu_sigmas, scan.ranges_km)
    nu, sigma_hat, limit, *measured = (float(column[row]) for column in columns)
    r = min(float(heard(scan.alpha_hat[row])) / sigma_hat, MAX_AMPLITUDE)
    nu_hat, nu_sigma, range_km = measured
    return found_look(response, nu, sigma_hat, limit, r, (nu_hat, nu_sigma, range_km), gate)


def echoes(response: Response, scan: Detections, rows: Ints) -> Ints:
    """Of the rows of detections, (n,), the strongest of each echo, in the order of the scan."""
    if rows.size < 2:
        return rows
    return np.sort(rows[strongest_of_each(response, scan.statistic[rows], scan.nus[rows], scan.ranges_km[rows])])


def expected_sigma(model: TrackerModel, state: TrackState, signature_power: ArrayLike) -> Floats:
    """Standard deviation of alpha_hat expected with waveforms of these ||v||^2; (...) -> (...)."""
    power = np.asarray(signature_power, dtype=np.float64)
    variance = np.full(power.shape, state.sigma_hat**2)
    if not _keeps_sigma_hat(model, state):
        np.divide(state.level, power, out=variance, where=power > 0.0)
    return np.asarray(np.sqrt(variance))


def sigma_of(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints) -> Floats:
    """Standard deviation of alpha_hat in cells without a detection, (n,) rows of the scan -> (n,).

    The receiver's own estimate, where it has one. It is made of what is left without an echo, so that it estimates the
    cell's noise whether there is a target or not. It is what the threshold was compared with. The paper keeps the
    sigma_hat of the last detection for the one cell that it looks at.
    """
    remembered = expected_sigma(model, state, scan.signature_power[rows])
    if _keeps_sigma_hat(model, state):
        return remembered
    return np.where(scan.sigma_hat[rows] > 0.0, scan.sigma_hat[rows], remembered)


def assigned_tracks(bins: NDArray[np.int32], beams: NDArray[np.int32]) -> Ints:
    """Track of each detection, the closest pairs first; of equally close ones the lower bin, then the lower track.

    bins    : (n,) of the detections, ascending
    beams   : (M,) bin that each track asked for, -1: none
    returns : (n,) tracks, -1: none
    """
    tracks = np.full(bins.size, -1)
    distance = np.abs(bins[:, np.newaxis] - beams)
    for pair in np.argsort(distance, axis=None, kind="stable"):
        detection, track = divmod(int(pair), beams.size)
        if beams[track] >= 0 and tracks[detection] < 0 and track not in tracks:
            tracks[detection] = track
    return tracks


class _OwnLooks(NamedTuple):
    """The looks that were made for each track of a scan."""

    gates: list[Gate]  # of M tracks
    ends: list[int]  # (M + 1,) where the rows of each track begin in `rows`
    rows: Ints  # of the scan, of all tracks one after the other


def _own_rows(model: TrackerModel, scan: Detections, at: int) -> tuple[Ints, Gate]:
    """The rows of the looks that were made for a track, in its gate; all while every cell is tested."""
    if not is_beam(model, scan):
        return np.arange(scan.nus.size), (0.0, FAR_KM)
    own = scan.once(_own_looks, (model.response, model.acquisition.ranges_km))
    return own.rows[own.ends[at] : own.ends[at + 1]], own.gates[at]


def _own_looks(scan: Detections, given: tuple[Response, Gate]) -> _OwnLooks:
    """The looks of all tracks, of a radar with this response that tests these ranges where nothing else is asked
    for."""
    gates = [_gate(*given, asked_km) for asked_km in scan.gates.tolist()]
    lit = np.where(scan.beams >= 0, scan.beam_nus, np.nan)
    ends, rows = _rows_in(scan.nus, scan.ranges_km, lit, np.array(gates).reshape(-1, 2))
    return _OwnLooks(gates, ends.tolist(), rows)


@kernel
def _rows_in(nus: Floats, ranges_km: Floats, lit: Floats, gates: Floats) -> tuple[Ints, Ints]:
    """The rows of looks in these directions, (M, L), NaN for none, and in gates, (M, 2); as of `_OwnLooks`."""
    ends, rows, n = np.zeros(lit.shape[0] + 1, np.int64), np.empty(nus.size + lit.size, np.int64), 0
    order = np.argsort(nus)
    ordered = nus[order]
    for m in range(lit.shape[0]):
        for nu in lit[m]:
            if np.isnan(nu):
                continue
            first, last = np.searchsorted(ordered, nu), np.searchsorted(ordered, nu, side="right")
            for i in order[first:last]:
                if ranges_km[i] == 0.0 or gates[m, 0] < ranges_km[i] < gates[m, 1]:
                    if n == rows.size:
                        rows = np.append(rows, rows)
                    rows[n], n = i, n + 1
        own = np.unique(rows[ends[m] : n])
        ends[m + 1] = n = ends[m] + own.size
        rows[ends[m] : n] = own
    return ends, rows[:n]


def _track_looks(model: TrackerModel, scan: Detections, at: int, share: Share, rows: Ints, gate: Gate) -> TrackLooks:
    """The looks of a track, which is this row of the roster and has this share of the scan's detections.

    Where power goes everywhere its look is that of the bin in which it is expected.

    rows : (n,) of the scan, in its beams and gate; all if power goes everywhere
    """
    cell_km = model.response.range_cell_km
    if is_beam(model, scan):
        n_direction = sum(bin_ >= 0 for bin_ in scan.beams[at].tolist())
        is_unmeasured = scan.is_unmeasured(at)
    else:
        n_bin, is_unmeasured = model.sensor.n_bin, scan.unmeasured is not None
        n_direction = directions_everywhere(n_bin, cell_km).size // n_bin
        gate = _gate(model.response, model.acquisition.ranges_km, (0.0, 0.0))
        rows = rows[scan.bins[rows] == angle_bin(np.asarray(scan.expected)[at, 0], n_bin)]
    hit = share.row
    if hit < 0:
        return TrackLooks(rows.size > 0, unresolved=share.unresolved, is_unmeasured=is_unmeasured)
    n_cell = max(round((gate[1] - gate[0]) / cell_km), 1)
    n = max(n_direction, 1) * n_cell
    p_fa, u = (p_fa_of(float(column[hit]), n) for column in (scan.limits, scan.statistic))
    return TrackLooks(is_looked=True, is_hit=True, p_fa=p_fa, u=u)


def _missed_directions(model: TrackerModel, state: TrackState, scan: Detections, missed: Ints) -> tuple[Floats, Floats]:
    """Directions of looks without a detection, of which these are the rows, and the standard deviations in them."""
    nus = scan.nus[missed]
    if nus.size == 0:
        return nus, nus
    is_first = np.ones(nus.size, dtype=np.bool_)  # of a look's rows
    is_first[1:] = nus[1:] > nus[:-1]
    nus, sigma = nus[is_first], sigma_of(model, state, scan, missed[is_first])
    is_known = sigma > 0.0  # else nothing is known of the noise there
    return nus[is_known], sigma[is_known]


def _alone(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints, gate: Gate) -> tuple[Share, Ints]:
    """A track's detection, without knowledge of the other tracks, and the rows of its own in which it was missed."""
    is_detected = scan.is_over(rows)
    if model.wide_looks and is_beam(model, scan):
        is_own = ~is_detected | _is_nearest(scan, scan.row_of(state.target), rows)
        rows, is_detected = rows[is_own], is_detected[is_own]
    hit = _own_echo(model, state, scan, echoes(model.response, scan, rows[is_detected]), gate)
    return Share(hit), _undetected(rows, scan.nus, scan.statistic, scan.limits)


def _by_belief(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints, gate: Gate) -> tuple[Share, Ints]:
    """As `_alone`, in looks of an older waveform: its roster expects the tracks where they are no longer.

    The detection is the one that the belief makes most probable, in the look of any track, of those near enough to
    where it expects the target.
    """
    expected, response = predicted_states(state.belief.sample(), model.motion.dt), model.response
    (nu, nu_sigma), ranges_km = mean_direction(spatial_frequency(expected)), hypot(expected[:, 0], expected[:, 2])
    off_nu, off_km = apart(scan.nu_hats, nu), np.abs(scan.ranges_km - ranges_km.mean())
    is_near = off_nu < _SIGMAS * hypot(nu_sigma, scan.nu_sigmas) + 0.5 * response.lobe
    if response.measures_range:
        is_near &= off_km < _SIGMAS * ranges_km.std() + response.range_cell_km
    found = echoes(response, scan, np.flatnonzero(scan.is_over() & is_near))
    share = Share(_likeliest(model, state, scan, found, gate)[0] if found.size else -1)
    return share, _missed_beside(response, scan, rows, share)


def _missed_beside(response: Response, scan: Detections, rows: Ints, share: Share) -> Ints:
    """The rows of a track's own, (n,), in which it was missed. These are none if it is hidden. They are of all looks if
    it has no detection and theirs are of other ranges, else of looks without a detection.
    """
    if share.is_hidden:
        return rows[:0]
    if share.row < 0 and response.measures_range:
        return rows
    return _undetected(rows, scan.nus, scan.statistic, scan.limits)


@kernel
def _undetected(rows: Ints, nus: Floats, statistic: Floats, limits: Floats) -> Ints:
    """Rows of the scan, (n,), of looks without a detection."""
    is_left = np.ones(rows.size, np.bool_)
    for j in rows:
        if statistic[j] >= limits[j]:
            is_left &= nus[rows] != nus[j]
    return rows[is_left]


def _gate(response: Response, ranges_km: Gate, asked_km: Sequence[float]) -> Gate:
    """Ranges that were tested, km: the radar's where all were asked for."""
    width, (low_km, high_km) = response.range_cell_km, asked_km
    if not response.measures_range:
        return 0.0, FAR_KM
    cells = range_cells(*(ranges_km if low_km == high_km == 0.0 else (low_km, high_km)), width)
    return cells[0] * width, (cells[-1] + 1) * width


def _is_nearest(scan: Detections, own: int, rows: Ints) -> NDArray[np.bool_]:
    """Whether of the tracks that tested a row's cell none has its brightest beam nearer than the own; (n,) -> (n,)."""
    nus, ranges_km = scan.nus[rows], scan.ranges_km[rows]
    is_lit = ((scan.beam_nus[:, np.newaxis] == nus[:, np.newaxis]) & (scan.beams >= 0)[:, np.newaxis]).any(axis=2)
    low_km, high_km = scan.gates[:, :1], scan.gates[:, 1:]
    is_tested = (high_km == 0.0) | (ranges_km == 0.0) | ((ranges_km > low_km) & (ranges_km < high_km))
    distances = np.where(is_lit & is_tested, apart(scan.beam_nus[:, :1], nus), np.inf)
    return np.asarray(distances[own] <= distances.min(axis=0) + _ROUNDING)


def _own_echo(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints, gate: Gate) -> int:
    """Row of the track's detection, of rows of different echoes, (n,); -1: none of them."""
    if rows.size == 0:
        return -1
    if scan.is_acquisition:
        row, total = _likeliest(model, state, scan, rows, gate)
        return row if total > 0.0 else -1
    if model.tests_every_cell:
        return _asked_for(model, state, scan, rows)
    return int(rows[0]) if rows.size == 1 else _likeliest(model, state, scan, rows, gate)[0]


def _likeliest(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints, gate: Gate) -> tuple[int, float]:
    """The one of some rows with detections that the belief makes most probable, and how probable it makes that.

    Of echoes that the belief cannot explain at all, the one where more of it was expected, then the stronger one.
    """
    expected = predicted_states(state.belief.sample(), model.motion.dt)
    each = [likelihood_of(model.sensor, detected_look(model.response, scan, row, gate)) for row in rows.tolist()]
    # Densities of what was measured: a broad measurement must not win by its breadth.
    totals = np.array([weigh(expected, one).total * max(one.nu_precision, _BROAD) ** 0.5 for one in each])
    everywhere = np.ones(expected.shape[0], dtype=np.bool_)
    there = model.response.shares(scan.nus[rows], spatial_frequency(expected), everywhere)
    first = np.lexsort((-scan.statistic[rows], -there, -totals))[0]
    return int(rows[first]), float(totals[first])


def _asked_for(model: TrackerModel, state: TrackState, scan: Detections, rows: Ints) -> int:
    """Row of this track's detection while every cell is tested, of those with one; -1: none of them."""
    expected, gate = predicted_bins(state.belief.sample(), model.sensor.n_bin, model.motion.dt), model.gate_bins
    bins = scan.bins[rows]
    for i in np.flatnonzero(assigned_tracks(bins, scan.beams[:, 0]) == scan.row_of(state.target)):
        if expected[max(bins[i] - gate, 0) : bins[i] + gate + 1].any():
            return int(rows[i])
    return -1


def _keeps_sigma_hat(model: TrackerModel, state: TrackState) -> bool:
    """Whether a cell is read with the sigma_hat of the last detection, as the paper does.

    The acquisition's, whose waveform is orthogonal, is up to sqrt(n_tx) times too large for a beam: every miss
    would be explained by too weak an echo. Like the authors, who scan once more with a beam before they track, a track
    keeps it from the first detection in a beam on; in a look before that the receiver's own is taken.
    """
    return model.belief.filter == "published" and state.in_beam
