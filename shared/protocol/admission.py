"""Whether a valid message makes sense in a scenario; what does not is refused."""

from shared.protocol.messages import Refused, Scan
from shared.protocol.recovery import Snapshot
from shared.scenario.limits import LOOKS_ROW
from shared.scenario.radar_config import RadarConfig


def check_dwell(k: int, radar: RadarConfig, dwells: int) -> None:
    """Refuse a dwell that a run cannot have: a planner would block on the ones before it."""
    last = radar.acquisition.max_scans + dwells
    if k > last:
        raise Refused(f"dwell {k} of a run that ends by {last}")


def check_scan(scan: Scan, radar: RadarConfig) -> None:
    """Refuse a scan of other cells or of another number of tracks."""
    n_bin = radar.array.n_bin
    complete = scan.bins.size == n_bin
    if scan.bins[-1] >= n_bin or scan.beams.shape[0] != radar.tracks or (scan.t == 0 and not complete):
        raise Refused(f"scan of {scan.bins.size} cells up to {scan.bins[-1]} for {scan.beams.shape[0]} tracks")
    if scan.t > 0 and (scan.beams < 0).all():
        raise Refused("scan of a dwell after the acquisition without any beam")
    if (scan.nus is None) == (radar.receiver.cells == "steered"):
        raise Refused(f'scan of other cells than radar.receiver.cells = "{radar.receiver.cells}"')


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
