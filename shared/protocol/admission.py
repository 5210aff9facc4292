"""Whether a valid message makes sense in a scenario; what does not is refused."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.fields import MIXTURE, are_among, is_all, is_any
from cogradar.shared.protocol.messages import Message, Plan, Refused, Scan
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.scenario.plugins.names import is_own
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import LOOKS_ROW, angle_bin

MODES, SUM = 3, 1e-6  # of motion, and how nearly their probabilities sum to 1
ROUNDING = 1e-9  # of a power
# Whether the messages of a radar have a part (`Message.PARTS`).
IS_NEEDED: dict[str, Callable[[RadarConfig], bool]] = {
    "directions": lambda radar: radar.receiver.cells == "steered",
    "roster": lambda radar: radar.is_unknown,
    "existence": lambda radar: radar.is_unknown,
    "modes": lambda radar: radar.is_unknown and radar.motion.modes == "mixture",
    "plane": lambda radar: radar.assumes.height_max_km > 0.0,
}
IF_TRACKING = frozenset({"directions", "plane"})  # parts of a plan that asks for cells


def check_parts(message: Message, radar: RadarConfig, *, asks: bool = True) -> None:
    """Refuse a message with a part that its radar has no use for, or without one that it needs.

    asks : whether cells are asked for; a plan of the acquisition asks for none
    """
    values = vars(message)
    for part, names in message.PARTS.items():
        is_needed = IS_NEEDED[part](radar) and (asks or part not in IF_TRACKING)
        if {values[name] is not None for name in names} != {is_needed}:
            settings = f"cells are {radar.receiver.cells}, tracks = {radar.tracks}"
            raise Refused(f"{type(message).__name__} {'without' if is_needed else 'with'} {part}: {settings}")


def check_dwell(k: int, radar: RadarConfig, dwells: int, t: int = 0) -> None:
    """Refuse a dwell that a run cannot have, or its clock: a planner would block on the ones before it."""
    # Of an acquisition, as many scans again may say why nothing was measured.
    last = dwells - 1 if radar.is_unknown else 2 * radar.acquisition.max_scans + dwells
    if k > last:
        raise Refused(f"dwell {k} of a run that ends by {last}")
    if t > min(k + 1, dwells):
        raise Refused(f"dwell {k} of {dwells} at t = {t}")


def check_track(track: int, k: int, radar: RadarConfig) -> None:
    """Refuse a track that there cannot be in dwell k: of an unknown number, `max_tracks` may begin with each before."""
    most = radar.most_tracks * k if radar.is_unknown else radar.announced
    if track >= most:
        raise Refused(f"track {track} in dwell {k}, there can be {most}")


def check_plan(plan: Plan, radar: RadarConfig) -> None:
    """Refuse a plan of a track that there cannot be, for bins that there are not, or without what its sky asks for."""
    check_track(plan.target, plan.k, radar)
    if max(plan.bins.tolist(), default=0) >= radar.array.n_bin:
        raise Refused(f"plan of track {plan.target} for bins {plan.bins.tolist()}: {radar.array.n_bin} bins exist")
    if plan.status == ("searching" if radar.is_unknown else "ended"):
        raise Refused(f"plan of track {plan.target} that is {plan.status}: tracks = {radar.tracks}")
    check_parts(plan, radar, asks=plan.status == "tracking")
    check_directions(plan.bins, plan.nus, radar)
    p = None if plan.modes is None else plan.modes.tolist()
    if p is not None and (len(p) != MODES or min(p) < 0.0 or max(p) > 1.0 or abs(sum(p) - 1.0) > SUM):
        raise Refused(f"modes {p} of motion: {MODES} probabilities that sum to 1")


def check_scan(scan: Scan, radar: RadarConfig) -> None:
    """Refuse a scan of other cells or of another number of tracks."""
    n_bin, bins = radar.array.n_bin, _asked_bins(scan, radar.array.n_bin)
    complete = bins.size == n_bin and np.unique(bins).size == n_bin
    check_parts(scan, radar)
    check_roster(scan.roster, scan.beams, radar, scan.k)
    if scan.lost_km is not None and not radar.receiver.range_cell_km > 0.0:
        raise Refused("scan with lost range cells, there are none")
    if bins.max() >= n_bin or (scan.t == 0 and not complete):
        raise Refused(f"scan of {bins.size} cells up to {bins.max()}")
    if scan.unmeasured is not None and not are_among(scan.beams, np.append(bins, -1)):
        raise Refused("scan in which a beam is neither measured nor unmeasured")
    check_directions(scan.beams, scan.beam_nus, radar)
    if scan.nus is not None:
        _check_looks(scan, scan.nus, radar)
    if scan.roster is not None:
        _check_searching(scan, scan.roster, bins, n_bin)
    elif scan.t > 0 and is_all(scan.beams < 0):
        raise Refused("scan of a dwell after the acquisition without any beam")


def _asked_bins(scan: Scan, n_bin: int) -> NDArray[np.int32]:
    """Bins of a scan's rows, and of the looks that were not measured."""
    return scan.bins if scan.unmeasured is None else np.append(scan.bins, angle_bin(scan.unmeasured, n_bin))


def _asked_nus(scan: Scan) -> NDArray[np.float64]:
    nus = np.asarray(scan.nus)
    return nus if scan.unmeasured is None else np.append(nus, scan.unmeasured)


def _check_searching(scan: Scan, roster: Roster, bins: NDArray[np.int32], n_bin: int) -> None:
    """Refuse a clock that stood still, and cells without a request, unless all bins are tested: so it begins.

    bins : of the rows, and of what was not measured
    """
    if scan.t != scan.k + 1:
        raise Refused(f"scan of dwell {scan.k} at t = {scan.t}: the acquisition is over")
    lit = np.asarray(scan.beam_nus)[scan.beams >= 0]
    is_asked = scan.k > 0 and are_among(_asked_nus(scan), np.concatenate((lit, roster.searched)))
    if not is_asked and np.unique(bins).size < n_bin:
        raise Refused(f"scan of dwell {scan.k} with cells other than its beams, the search's, or all")


def check_roster(roster: Roster | None, beams: NDArray[np.int32], radar: RadarConfig, dwells: int) -> None:
    """Refuse more tracks than the radar can have, and those that cannot have begun.

    roster : None: tracks are announced
    dwells : whose scans the tracks may have begun with: k of a scan, k + 1 of a waveform
    """
    n, most = beams.shape[0], radar.most_tracks
    if not radar.announced <= n <= most:
        raise Refused(f"beams of {n} tracks, {'at most ' if radar.is_unknown else ''}{most} exist")
    if roster is None:
        return
    if roster.next_id > most * dwells or roster.born_k.max(initial=-1) >= dwells:
        born_k = roster.born_k.max(initial=-1)
        raise Refused(f"{roster.next_id} tracks, the last one of dwell {born_k}, after {dwells} dwells of {most}")
    if roster.search_share > radar.array.power * (1.0 + ROUNDING):
        raise Refused(f"search with power {roster.search_share:g}, at most {radar.array.power:g} is allowed")


def _check_looks(scan: Scan, nus: NDArray[np.float64], radar: RadarConfig) -> None:
    """Refuse what looks of this radar cannot say."""
    receiver, n_bin = radar.receiver, radar.array.n_bin
    columns = (scan.limits, scan.ranges_km, scan.nu_hats, scan.nu_sigmas, scan.beam_nus)
    limits, ranges, nu_hats, sigmas, beam_nus = (np.asarray(column) for column in columns)
    asked = _asked_nus(scan)
    if is_any(np.abs(nus) > 0.5) or is_any(angle_bin(nus, n_bin) != scan.bins):
        raise Refused("scan whose bins do not match the directions tested")
    if asked.size != n_bin and not are_among(beam_nus[scan.beams >= 0], asked):
        raise Refused("scan that lacks the direction of a beam")
    if nus.size == 0:
        return
    if is_any(np.abs(nu_hats) > 0.5):
        raise Refused(f"scan with a direction of {np.abs(nu_hats).max():g}")
    if is_any(limits <= 0.0) or is_any(ranges < 0.0) or is_any(sigmas < 0.0):
        raise Refused("limits must be > 0, ranges and standard deviations of directions >= 0")
    if is_any(ranges > 0.0) != (receiver.range_cell_km > 0.0) or (is_any(sigmas > 0.0) and not receiver.monopulse):
        raise Refused("scan that measures ranges or directions other than radar.receiver says")


def check_directions(beams: NDArray[np.int32], nus: NDArray[np.float64] | None, radar: RadarConfig) -> None:
    """Refuse beams of other bins than their directions say."""
    if nus is not None and is_any((angle_bin(nus, radar.array.n_bin) != beams) & (beams >= 0)):
        raise Refused("beams whose bins do not match their directions")


def check_snapshot(snapshot: Snapshot, radar: RadarConfig) -> None:
    """Refuse a snapshot of a track that the radar cannot have."""
    n_particle, n_bin = radar.belief.n_particle, radar.array.n_bin
    is_steered = IS_NEEDED["directions"](radar)
    filter_, looked = radar.belief.filter, LOOKS_ROW if is_steered else n_bin
    expected = {"gaussian": MIXTURE}.get(filter_, snapshot.belief.shape if is_own(filter_) else (n_particle, 4))
    widths = {looked, 0} if filter_ == "gaussian" or is_own(filter_) else {looked}
    check_track(snapshot.target, snapshot.k, radar)
    if snapshot.belief.shape != expected:
        raise Refused(f"snapshot of a belief of {snapshot.belief.shape} numbers, expected {expected}")
    if filter_ == "gaussian" and not _is_mixture(snapshot.belief):
        raise Refused("weights of a belief must be 0 or more and sum to 1, its covariances be symmetric")
    if snapshot.looked.shape[1] not in widths or snapshot.hit_bin >= n_bin:
        shape = f"{snapshot.looked.shape[1]} numbers and bin {snapshot.hit_bin}"
        raise Refused(f"snapshot of looks of {shape}, expected {max(widths)} and one of {n_bin} bins")
    if not is_steered and (snapshot.looked < 0.0).any():
        raise Refused("snapshot of looks with a negative standard deviation")


def _is_mixture(rows: NDArray[np.float64]) -> bool:
    """Whether rows are weights, means and covariances of Gaussians."""
    weights, covariances = rows[:, 0], rows[:, 6:].reshape(3, 5, 5)
    is_symmetric = (covariances == covariances.transpose(0, 2, 1)).all()
    variances = np.einsum("jaa->ja", covariances)
    return bool(
        is_symmetric and (variances >= 0.0).all() and (weights >= 0.0).all() and abs(weights.sum() - 1.0) < 1e-6
    )
