"""What a scan tells one track: a detection or a miss, and in which cells it was looked for.

An adaptive track is told of the cells that were lit for it; two that share one share its beam and what it finds. With
wide looks a detection in such a cell belongs to the track whose brightest cell is nearest, and tells the other nothing:
a look that was widened over the cell of another target must not be captured by it. Of two detections in its cells the
one that its belief makes more probable, by bin and amplitude, is the track's, and the other one's cell tells it
nothing. The orthogonal strategy tests all cells for all tracks, and one detection belongs to one track:

1. Each detection goes to the track that asked for the nearest bin, the closest pairs first, and no more than one to
   each track (suboptimal nearest neighbour; Blackman 1986). Nothing but the scan is needed, which carries all requests:
   workers that own different tracks agree.
2. A track accepts it in the bins where it expects particles and `gate_bins` beyond, where an adaptive track would look.
   A detection there that no particle expected redraws the belief as it does for an adaptive track; anywhere else it is
   a false alarm.
3. The cells of all other detections tell the track nothing: they hold no miss. In the cells without one it was missed.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_bins, predicted_states
from shared.tracking.resampling import weigh
from shared.tracking.sensor import MAX_AMPLITUDE, Detections, Observation, likelihood_table


def associate(model: TrackerModel, state: TrackState, scan: Detections) -> tuple[Observation, float]:
    """What the scan tells a track, and ||v||^2 of its look: that of its detection, or the mean over all its cells."""
    sigma, is_detected = np.zeros(model.sensor.n_bin), scan.statistic >= model.sensor.threshold
    if not is_beam(model, scan):
        rows, hit = np.flatnonzero(~is_detected), own_detection(model, state, scan, np.flatnonzero(is_detected))
    else:
        own = np.searchsorted(scan.bins, lit_cells(scan, state.target))
        if model.wide_looks:
            own = own[is_detected[own] <= _is_nearest(scan, state.target, scan.bins[own])]
        rows, hit = own[~is_detected[own]], _more_probable(model, state, scan, own[is_detected[own]])
    sigma[scan.bins[rows]] = sigma_of(model, state, scan, rows)
    if hit >= 0:
        return hit_of(scan, hit, sigma), float(scan.signature_power[hit])
    return Observation(-1, 0.0, sigma), float(scan.signature_power[rows].mean()) if rows.size else state.power


def is_acquisition(scan: Detections) -> bool:
    """Whether nobody had asked for a cell yet."""
    return scan.ids is None and bool((scan.beams < 0).all())


def is_beam(model: TrackerModel, scan: Detections) -> bool:
    """Whether a track that was lit in this dwell was lit by a beam, and not by the orthogonal waveform."""
    return not (model.tests_every_cell or is_acquisition(scan))


def row_of(scan: Detections, target: int) -> int:
    """Row of a track in beams, gates and what else there is of each."""
    return target if scan.ids is None else int(np.searchsorted(scan.ids, target))


def lit_cells(scan: Detections, target: int) -> NDArray[np.int32]:
    """Bins that were lit for a track, (c,); none if it had no beam in this dwell."""
    cells = scan.beams[row_of(scan, target)]
    return np.asarray(cells[cells >= 0])


def hit_of(scan: Detections, row: int, sigma: NDArray[np.float64]) -> Observation:
    """Observation of a detection in a row of the scan; `sigma` is that of the cells looked at, (n_bin,)."""
    hit_bin = int(scan.bins[row])
    sigma[hit_bin] = float(scan.sigma_hat[row])
    return Observation(hit_bin, amplitude_of(scan, row), sigma)


def amplitude_of(scan: Detections, row: int) -> float:
    """Amplitude r of a detection in a row of the scan."""
    return min(float(abs(scan.alpha_hat[row])) / float(scan.sigma_hat[row]), MAX_AMPLITUDE)


def expected_sigma(model: TrackerModel, state: TrackState, signature_power: ArrayLike) -> NDArray[np.float64]:
    """Standard deviation of alpha_hat expected with waveforms of these ||v||^2; (...) -> (...)."""
    power = np.asarray(signature_power, dtype=np.float64)
    variance = np.full(power.shape, state.sigma_hat**2)
    if not _keeps_sigma_hat(model, state):
        np.divide(state.level, power, out=variance, where=power > 0.0)
    return np.asarray(np.sqrt(variance))


def assigned_tracks(bins: NDArray[np.int32], beams: NDArray[np.int32]) -> NDArray[np.int64]:
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


def sigma_of(model: TrackerModel, state: TrackState, scan: Detections, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Standard deviation of alpha_hat in cells without a detection, (n,) rows of the scan -> (n,).

    The receiver's own estimate, where it has one: it is made of what is left without an echo, so that it estimates the
    cell's noise whether there is a target or not, and it is what the threshold was compared with. The paper keeps the
    sigma_hat of the last detection for the one cell that it looks at.
    """
    remembered = expected_sigma(model, state, scan.signature_power[rows])
    if _keeps_sigma_hat(model, state):
        return remembered
    return np.where(scan.sigma_hat[rows] > 0.0, scan.sigma_hat[rows], remembered)


def _keeps_sigma_hat(model: TrackerModel, state: TrackState) -> bool:
    """Whether a cell is read with the sigma_hat of the last detection, as the paper does.

    That of the acquisition, whose waveform is orthogonal, is up to sqrt(n_tx) times too large for a beam: every miss
    would be explained by too weak an echo. Like the authors, who scan once more with a beam before they track, a track
    keeps it from the first detection in a beam on; in a look before that the receiver's own is taken.
    """
    return model.belief.noise_memory == "sigma_hat" and state.in_beam


def own_detection(model: TrackerModel, state: TrackState, scan: Detections, rows: NDArray[np.int64]) -> int:
    """Row of this track's detection, of those with one; -1: none of them.

    Before the first waveform of the tracking nobody has asked for a bin: it is where most particles are expected.
    """
    expected, gate = predicted_bins(state.particles, model.sensor.n_bin, model.motion.dt), model.gate_bins
    bins = scan.bins[rows]
    if is_acquisition(scan):
        best = int(np.argmax(expected[bins])) if rows.size else 0
        return int(rows[best]) if rows.size and expected[bins[best]] > 0 else -1
    for i in np.flatnonzero(assigned_tracks(bins, scan.beams[:, 0]) == row_of(scan, state.target)):
        if expected[max(bins[i] - gate, 0) : bins[i] + gate + 1].any():
            return int(rows[i])
    return -1


def _is_nearest(scan: Detections, target: int, bins: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether of the tracks that a cell was lit for none has its brightest cell nearer than this one; (n,) -> (n,)."""
    first = scan.beams[:, :1]
    is_lit = (scan.beams[:, np.newaxis] == bins[:, np.newaxis]).any(axis=2)  # (M, n)
    distances = np.where(is_lit, np.abs(first - bins), scan.beams.max() + 1)
    return np.asarray(distances[row_of(scan, target)] == distances.min(axis=0))


def _more_probable(model: TrackerModel, state: TrackState, scan: Detections, rows: NDArray[np.int64]) -> int:
    """Of the rows of detections in a track's own cells the one that its belief makes most probable; -1: there are none.

    Of amplitudes that it cannot explain at all, the one in the bin with most particles.
    """
    if rows.size < 2:
        return int(rows[0]) if rows.size else -1
    n_bin = model.sensor.n_bin
    expected, nothing = predicted_states(state.particles, model.motion.dt), np.zeros(n_bin)
    hits = [likelihood_table(model.sensor, hit_of(scan, row, nothing.copy())) for row in rows.tolist()]
    totals = [weigh(expected, hit).total for hit in hits]
    there = predicted_bins(state.particles, n_bin, model.motion.dt)[scan.bins[rows]]
    return int(rows[np.lexsort((-there, -np.array(totals)))[0]])
