"""Whether a valid message makes sense in a scenario; what does not is refused."""

import numpy as np
from numpy.typing import NDArray

from shared.protocol.messages import Refused, Scan
from shared.protocol.recovery import Snapshot
from shared.scenario.limits import LOOKS_ROW
from shared.scenario.radar_config import RadarConfig
from shared.signal.array import angle_bin


def check_dwell(k: int, radar: RadarConfig, dwells: int) -> None:
    """Refuse a dwell that a run cannot have: a planner would block on the ones before it."""
    last = radar.acquisition.max_scans + dwells
    if k > last:
        raise Refused(f"dwell {k} of a run that ends by {last}")


def check_scan(scan: Scan, radar: RadarConfig) -> None:
    """Refuse a scan of other cells or of another number of tracks."""
    n_bin = radar.array.n_bin
    complete = scan.bins.size == n_bin and np.unique(scan.bins).size == n_bin
    if scan.bins.max() >= n_bin or scan.beams.shape[0] != radar.tracks or (scan.t == 0 and not complete):
        raise Refused(f"scan of {scan.bins.size} cells up to {scan.bins.max()} for {scan.beams.shape[0]} tracks")
    if scan.t > 0 and (scan.beams < 0).all():
        raise Refused("scan of a dwell after the acquisition without any beam")
    check_directions(scan.beams, scan.beam_nus, radar)
    if scan.nus is not None:
        _check_steered(scan, scan.nus, radar)


def _check_steered(scan: Scan, nus: NDArray[np.float64], radar: RadarConfig) -> None:
    """Refuse what steered cells of this radar cannot say."""
    if np.abs(nus).max() > 0.5 or (angle_bin(nus, radar.array.n_bin) != scan.bins).any():
        raise Refused("scan whose bins are not those of the directions tested")
    complete = nus.size == radar.array.n_bin
    if scan.beam_nus is not None and not complete and not np.isin(scan.beam_nus[scan.beams >= 0], nus).all():
        raise Refused("scan that lacks the direction of a beam")
    limits, ranges, sigmas = (np.asarray(column) for column in (scan.limits, scan.ranges_km, scan.nu_sigmas))
    if limits.min() <= 0.0 or ranges.min() < 0.0 or sigmas.min() < 0.0:
        raise Refused("limits must be > 0, ranges and standard deviations of directions >= 0")
    if (ranges.max() > 0.0) != (radar.receiver.range_cell_km > 0.0) or (sigmas.any() and not radar.receiver.monopulse):
        raise Refused("scan that measures ranges or directions other than radar.receiver says")


def check_directions(
    beams: NDArray[np.int32], nus: NDArray[np.float64] | None, radar: RadarConfig, *, is_asked: bool = True
) -> None:
    """Refuse beams with directions where the radar has bins, or without, or of other bins than they say.

    is_asked : whether there must be directions; a plan of the acquisition has none
    """
    if (nus is not None) != (radar.receiver.cells == "steered" and is_asked):
        raise Refused(f"beams {'with' if nus is not None else 'without'} directions: cells are {radar.receiver.cells}")
    if nus is not None and (angle_bin(nus, radar.array.n_bin) != beams)[beams >= 0].any():
        raise Refused("beams whose bins are not those of their directions")


def check_snapshot(snapshot: Snapshot, radar: RadarConfig) -> None:
    """Refuse a snapshot of a track that the radar cannot have."""
    n_particle, n_bin = radar.belief.n_particle, radar.array.n_bin
    is_steered = radar.receiver.cells == "steered"
    width = LOOKS_ROW if is_steered else n_bin
    if snapshot.target >= radar.tracks:
        raise Refused(f"snapshot of track {snapshot.target}, there are {radar.tracks}")
    if snapshot.particles.shape[0] != n_particle:
        raise Refused(f"snapshot of {snapshot.particles.shape[0]} particles, expected {n_particle}")
    if snapshot.looked.shape[1] != width or snapshot.hit_bin >= n_bin:
        shape = f"{snapshot.looked.shape[1]} numbers and bin {snapshot.hit_bin}"
        raise Refused(f"snapshot of looks of {shape}, expected {width} and one of {n_bin} bins")
    if not is_steered and (snapshot.looked < 0.0).any():
        raise Refused("snapshot of looks with a negative standard deviation")
