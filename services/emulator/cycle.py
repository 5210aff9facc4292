"""One transmit-receive cycle in messages: a waveform becomes a transmission, what was measured a scan."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cogradar.services.emulator.front_end import (
    GroundTruth,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    fault_line,
)
from cogradar.shared.numerics.linear import energy
from cogradar.shared.protocol.admission import (
    IS_NEEDED,
    check_directions,
    check_dwell,
    check_parts,
    check_roster,
    check_scan,
)
from cogradar.shared.protocol.messages import Refused, Scan, Truth, Waveform, roster_of
from cogradar.shared.protocol.roster import Roster, announced_roster, no_tracks
from cogradar.shared.scenario.faults import plain
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.looks import Look, directions_everywhere, range_cells
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.existence import alert_p_fa

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire
Gate = tuple[float, float]  # ranges, km
ALL_RANGES = (0.0, 0.0)  # as a gate
_TYPES: dict[str, type[np.generic]] = {"bins": np.int32, "beams": np.int32, "alpha_hat": np.complex64}  # else float64


class _Place(NamedTuple):
    """Where a look is made, in the order of directions."""

    nu: float
    gate: Gate
    p_fa: float
    alike: int = 0  # looks of a bin of which one is reported; 0: each is


def transmission(radar: RadarConfig, waveform: Waveform | None) -> Transmission:
    """What to transmit. None: there is no waveform yet, so power goes in all directions.

    Power in all directions lets every bin be tested; beams only their own cells. Where tracks are searched for while
    others go on, there may be both.
    """
    array = radar.array
    isotropic, factor = array.power, np.empty((array.n_tx, 0), dtype=np.complex128)
    beams, roster = np.full((radar.announced, 1), -1, dtype=np.int32), announced_roster(radar.announced)
    nus = gates = None
    if waveform is not None:
        isotropic, factor, beams = waveform.isotropic, waveform.factor.astype(np.complex128), waveform.beams
        nus, gates, roster = waveform.nus, waveform.gates, roster_of(waveform)
    if nus is None or gates is None:
        nus, gates = np.where(beams >= 0, bin_centres(array.n_bin)[beams], 0.0), np.zeros((beams.shape[0], 2))
    # Where the number of targets is announced, nothing is searched for.
    n_look = array.n_bin if isotropic > 0.0 else roster.searched.size
    p_fa = alert_p_fa(n_look) if radar.is_unknown else radar.detector.p_fa
    places: set[_Place] = set()
    if isotropic == 0.0 or (radar.is_unknown and factor.shape[1] > 0):
        places = _of_beams(radar, (beams, nus, gates), roster, p_fa)
    if isotropic > 0.0 or not places:  # none: in a pause of a radar without beams
        directions = directions_everywhere(array.n_bin, radar.receiver.range_cell_km)
        places |= {_Place(nu, ALL_RANGES, p_fa, directions.size // array.n_bin) for nu in directions.tolist()}
    looks = _looks(radar, sorted(places))
    bins = np.array(sorted({look.bin for look in looks}), dtype=np.int32)
    return Transmission(isotropic, factor, beams, bins, looks, nus, gates)


def limited(asked: Transmission, most: float) -> Transmission:
    """A transmission with at most this power: all of it is scaled."""
    power = asked.power
    if power <= most * (1.0 + POWER_TOLERANCE):
        return asked
    share = most / power
    return replace(asked, isotropic=share * asked.isotropic, factor=np.sqrt(share) * asked.factor)


def _of_beams(
    radar: RadarConfig,
    lit: tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
    roster: Roster,
    alert: float,
) -> set[_Place]:
    """Where beams are: beams of tracks, each with its gate, and of the search.

    What confirms a tentative track has the P_FA of the search, all its looks of a dwell together.

    lit   : beams, their directions, and gates
    alert : P_FA of each look of the search
    """
    beams, nus, gates = lit
    n_look = np.maximum((beams >= 0).sum(axis=1), 1)
    p_fa = np.where(roster.confirmed == 1, radar.detector.p_fa, alert / n_look)
    return {_Place(nu, ALL_RANGES, alert) for nu in roster.searched.tolist()} | {
        _Place(float(nus[m, i]), (float(gates[m, 0]), float(gates[m, 1])), float(p_fa[m]))
        for m, i in np.argwhere(beams >= 0).tolist()
    }


def _looks(radar: RadarConfig, places: Sequence[_Place]) -> list[Look]:
    """Looks at these places; what they share is worked out once."""
    tested = {place[1:]: _tested(radar, place) for place in places}
    bins = angle_bin([place.nu for place in places], radar.array.n_bin).tolist()
    return [Look(place.nu, bin_, *tested[place[1:]], place.alike > 0) for place, bin_ in zip(places, bins, strict=True)]


def _tested(radar: RadarConfig, place: _Place) -> tuple[range, float]:
    """Range cells of a gate and the limit of their tests; ALL_RANGES: where targets may be found at all."""
    cells, width, acquisition = range(0), radar.receiver.range_cell_km, radar.acquisition
    if width > 0.0:
        ends = acquisition.ranges_km if place.gate == ALL_RANGES else place.gate
        cells = range_cells(*ends, width)
    return cells, threshold(place.p_fa, max(place.alike, 1) * max(len(cells), 1))


def check_waveform(waveform: Waveform, radar: RadarConfig, dwells: int) -> None:
    """Refuse what the transmitter cannot send, and a dwell that the run cannot have."""
    array = radar.array
    power = waveform.isotropic + energy(waveform.factor.astype(np.complex128))
    check_dwell(waveform.k, radar, dwells)
    if waveform.factor.shape[0] != array.n_tx:
        raise Refused(f"waveform for {waveform.factor.shape[0]} antennas, the array has {array.n_tx}")
    check_parts(waveform, radar)
    check_roster(waveform.roster, waveform.beams, radar, waveform.k + 1)
    if (waveform.beams >= array.n_bin).any():
        raise Refused(f"beams {waveform.beams.tolist()}: bins are 0 .. {array.n_bin - 1}")
    if not waveform.tracking and (waveform.beams != -1).any():
        raise Refused("an acquisition waveform must have no beams")
    if power > array.power * (1.0 + POWER_TOLERANCE):
        raise Refused(f"power {power:g}, at most {array.power:g} is allowed")
    if not waveform.tracking and waveform.isotropic == 0.0:
        raise Refused("an acquisition waveform must light up every cell")
    if 0.0 == waveform.isotropic < power and not roster_of(waveform).searched.size and (waveform.beams == -1).all():
        raise Refused("a waveform must light up some cell: a scan has one at least")
    check_directions(waveform.beams, waveform.nus, radar)


def compared(radar: RadarConfig, asked: Transmission, measured: ScanData, waveform_k: int | None = None) -> ScanData:
    """What was measured, with the beams that were asked for and the directions of what is left out.

    waveform_k : dwell whose waveform was radiated; None: the usual one

    Where the front end says where its beams really were, as a recording does, they are left as they are. Raises
    SenselessScan for a cell that was not asked for, or with a number that cannot be.
    """
    if not isinstance(measured, ScanData):
        raise SenselessScan(f"transmit returned {type(measured).__name__}, ScanData is needed")
    _check_columns(measured)
    if measured.beams is None:
        unmeasured = _unmeasured(radar, asked, measured)
        measured = replace(
            measured,
            beams=asked.beams,
            beam_nus=asked.nus,
            gates=asked.gates,
            unmeasured=np.array(unmeasured) if unmeasured else None,
            waveform_k=waveform_k,
        )
    is_whole = measured.fault is None or measured.unmeasured is None
    return replace(measured, fault=None if is_whole else fault_line(measured.fault))


def _unmeasured(radar: RadarConfig, asked: Transmission, measured: ScanData) -> list[float]:
    """Directions of looks that have no row, ascending; of those that are merged, the direction of their bin."""
    centres, width_km = bin_centres(radar.array.n_bin), radar.receiver.range_cell_km
    bins = np.asarray(measured.bins)
    if radar.receiver.cells == "bins":
        if np.array_equal(bins, asked.bins):
            return []
        _refuse(measured, ~np.isin(bins, asked.bins))
        left: list[float] = centres[np.setdiff1d(asked.bins, bins)].tolist()
        return left
    nus = np.empty(0) if measured.nus is None else np.asarray(measured.nus)
    if nus.tolist() == [look.nu for look in asked.looks] and (nus[1:] > nus[:-1]).all():
        return []
    by_nu = dict[float, list[Look]]()
    for look in asked.looks:
        by_nu.setdefault(look.nu, []).append(look)
    ranges_km = np.zeros(nus.size) if measured.ranges_km is None else np.asarray(measured.ranges_km)
    cells = np.floor(ranges_km / width_km).tolist() if width_km > 0.0 else [0.0] * nus.size
    # Two looks may have one direction and other gates.
    of_rows = [
        [look for look in by_nu.get(nu, ()) if not look.cells or cell in look.cells]
        for nu, cell in zip(nus.tolist(), cells, strict=True)
    ]
    _refuse(measured, np.array([not looks for looks in of_rows], dtype=np.bool_))
    found = {_named(look) for looks in of_rows for look in looks}
    lost = [look for look in asked.looks if _named(look) not in found]
    return sorted({float(centres[look.bin]) if look.is_merged else look.nu for look in lost})


def _named(look: Look) -> tuple[float, tuple[int, ...]]:
    """What one row is reported of: a look, or all merged looks of a bin."""
    return (look.bin, ()) if look.is_merged else (look.nu, (*look.cells[:1], *look.cells[-1:]))


def _refuse(measured: ScanData, is_strange: NDArray[np.bool_]) -> None:
    if is_strange.any():
        raise SenselessScan(f"{_cell(measured, int(np.argmax(is_strange)))} was not asked for")


_COLUMNS = ("bins", "statistic", "alpha_hat", "sigma_hat", "signature_power")  # that each scan has
_OF_LOOKS = Scan.PARTS["directions"][:5]


def _check_columns(measured: ScanData) -> None:
    """SenselessScan unless all columns have a finite number for each cell, and each statistic its sigma_hat."""
    names = [*_COLUMNS, *(name for name in _OF_LOOKS if getattr(measured, name) is not None)]
    columns = [_column(measured, name) for name in names]
    n = columns[0].size
    for name, column in zip(names, columns, strict=True):
        if column.shape != (n,) or column.dtype.kind not in ("iufc" if name == "alpha_hat" else "iuf"):
            raise SenselessScan(f"{name}: {n} numbers are needed, got {column.dtype} of shape {column.shape}")
    if not (is_finite := np.isfinite(np.array(columns))).all():
        at, row = (int(i) for i in np.argwhere(~is_finite)[0])
        raise SenselessScan(f"{_cell(measured, row)}: {names[at]} is {columns[at][row]}")
    _, statistic, _, sigma_hat, *_ = columns
    is_noiseless = (statistic > 0.0) & ~(sigma_hat > 0.0)
    if is_noiseless.any():
        at = int(np.flatnonzero(is_noiseless)[0])
        said = f"a statistic of {statistic[at]:g} with sigma_hat {sigma_hat[at]:g}"
        raise SenselessScan(f"{_cell(measured, at)}: {said}, which must be > 0")


def _column(measured: ScanData, name: str) -> NDArray[Any]:
    values = getattr(measured, name)
    if values is None:
        raise SenselessScan(f"{name} is missing")
    try:
        return np.asarray(values)
    except ValueError as error:  # its rows are of different lengths
        raise SenselessScan(f"{name}: {error}") from None


def _cell(measured: ScanData, row: int) -> str:
    """The cell of a row, in words."""
    where = "" if measured.nus is None or np.size(measured.nus) <= row else f", nu = {measured.nus[row]:.4g}"
    return f"bin {measured.bins[row]}{where}"


def scan_message(
    settings: Settings, k: int, t: int, measured: ScanData, waveform: Waveform | None, last_k: int | None = None
) -> Scan:
    """The message of what was measured. Raises SenselessScan if it cannot be: all readers would drop it.

    last_k : dwell of the last scan, if it is known: the radar skipped the dwells between
    """
    radar = settings.radar
    sent_roster, settings_sent = (no_tracks(), None) if waveform is None else (waveform.roster, waveform.settings)
    unsent = {name for part, names in Scan.PARTS.items() for name in names if not IS_NEEDED[part](radar)}
    said = {"run": settings.run, "k": k, "t": t, "roster": measured.roster or sent_roster}
    said |= {"settings": measured.settings or settings_sent}
    said |= {"skipped": None if last_k is None else k - 1 - last_k or None}
    try:
        with np.errstate(over="ignore"):  # what is infinite then is refused
            said |= {
                name: values
                if name in {"fault", "waveform_k", "utc_s", "front_end"}
                else np.asarray(values, dtype=_TYPES.get(name, np.float64))
                for name, values in vars(measured).items()
                if values is not None and name not in {"roster", "settings"}
            }
        scan = Scan.model_validate({name: value for name, value in said.items() if name not in unsent})
        check_scan(scan, radar)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise SenselessScan(f"{where}: {plain(first)}" if where else plain(first)) from None
    except (Refused, TypeError, ValueError) as error:
        raise SenselessScan(str(error)) from None
    return scan


def truth_message(scan: Scan, truth: GroundTruth, waveform: Waveform | None) -> Truth:
    """Where the targets were in the dwell of a scan."""
    return Truth(
        run=scan.run,
        k=scan.k,
        t=scan.t,
        states=truth.states,
        heights_km=np.zeros(len(truth.states)) if truth.heights_km is None else truth.heights_km,
        bins=truth.bins,
        snr_db=truth.snr_db,
        waveform_k=-1 if waveform is None else waveform.k,
    )
