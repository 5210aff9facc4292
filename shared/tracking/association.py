"""What a scan tells one track: its own cell, or, when every cell was tested, all of them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_bins
from shared.tracking.sensor import Detections, Observation, level_of

_MISS = -1


def associate(model: TrackerModel, state: TrackState, scan: Detections) -> tuple[Observation, float]:
    """What the scan tells a track, and ||v||^2 of its look: that of its detection, or the mean over all its cells."""
    sigma, cells = np.zeros(model.sensor.n_bin), cells_of(model, state, scan)
    sigma[scan.bins[cells]] = expected_sigma(model, state, scan.signature_power[cells])
    if cells.size == 1:
        hit = int(cells[0]) if scan.statistic[cells[0]] >= model.sensor.threshold else _MISS
    else:
        hit = _claimed(model, state, scan)
    if hit == _MISS:
        return Observation(-1, 0, sigma), float(scan.signature_power[cells].mean())
    return hit_of(scan, hit, sigma), float(scan.signature_power[hit])


def cells_of(model: TrackerModel, state: TrackState, scan: Detections) -> NDArray[np.int64]:
    """Rows of the scan that were looked at for this track: that of its beam, or all without one."""
    beam = scan.beams[state.target]
    if model.tests_every_cell or beam < 0:
        return np.arange(scan.bins.size)
    return np.searchsorted(scan.bins, [beam])


def hit_of(scan: Detections, cell: int, sigma: NDArray[np.float64]) -> Observation:
    """Observation of a detection in a cell of the scan; `sigma` is that of the cells looked at, (n_bin,)."""
    hit_bin, sigma_hit = int(scan.bins[cell]), float(scan.sigma_hat[cell])
    sigma[hit_bin] = sigma_hit
    return Observation(hit_bin, level_of(abs(scan.alpha_hat[cell]) / sigma_hit), sigma)


def expected_sigma(model: TrackerModel, state: TrackState, signature_power: ArrayLike) -> NDArray[np.float64]:
    """Standard deviation of alpha_hat expected with waveforms of these ||v||^2; (...) -> (...)."""
    power = np.asarray(signature_power, dtype=np.float64)
    variance = np.full(power.shape, state.sigma_hat**2)
    if model.belief.noise_memory == "level":
        np.divide(state.level, power, out=variance, where=power > 0.0)
    return np.asarray(np.sqrt(variance))


def _claimed(model: TrackerModel, state: TrackState, scan: Detections) -> int:
    """Detected cell where most particles are expected, -1 if none is expected in any."""
    predicted = predicted_bins(state.particles, model.sensor.n_bin, model.motion.dt)
    expected = np.where(scan.statistic >= model.sensor.threshold, predicted, 0)
    best = int(np.argmax(expected))
    return best if expected[best] > 0 else _MISS
