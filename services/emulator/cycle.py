"""One transmit-receive cycle in messages: a waveform becomes a transmission, what was measured a scan."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from pydantic import ValidationError

from services.emulator.front_end import FrontEndError, GroundTruth, ScanData, Settings, Transmission
from shared.protocol.admission import check_directions, check_dwell, check_scan
from shared.protocol.messages import Refused, Scan, Truth, Waveform
from shared.scenario.faults import plain
from shared.scenario.radar_config import RadarConfig
from shared.signal.array import angle_bin, bin_centres
from shared.signal.looks import Look, directions_everywhere, range_cells
from shared.signal.receiver import threshold

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire
Gate = tuple[float, float]  # ranges, km
ALL_RANGES = (0.0, 0.0)  # as a gate
_TYPES: dict[str, type[np.generic]] = {"bins": np.int32, "beams": np.int32, "alpha_hat": np.complex64}  # else float64


def transmission(radar: RadarConfig, waveform: Waveform | None) -> Transmission:
    """What to transmit. None: there is no waveform yet, so power goes in all directions.

    Power in all directions lets every bin be tested; beams only their own cells.
    """
    array, is_steered = radar.array, radar.receiver.cells == "steered"
    isotropic, factor = array.power, np.empty((array.n_tx, 0), dtype=np.complex128)
    beams = np.full((radar.tracks, 1), -1, dtype=np.int32)
    nus, gates = (np.zeros(beams.shape), np.zeros((radar.tracks, 2))) if is_steered else (None, None)
    if waveform is not None:
        isotropic, factor, beams = waveform.isotropic, waveform.factor.astype(np.complex128), waveform.beams
        nus, gates = waveform.nus, waveform.gates
    centres = bin_centres(array.n_bin)
    directions = directions_everywhere(array.n_bin, radar.receiver.range_cell_km)
    places = {(nu, ALL_RANGES) for nu in directions.tolist()}
    if isotropic == 0.0:
        lit = centres[beams] if nus is None else nus
        of_tracks = np.zeros((radar.tracks, 2)) if gates is None else gates
        places = {
            (float(lit[m, i]), (float(of_tracks[m, 0]), float(of_tracks[m, 1])))
            for m, i in np.argwhere(beams >= 0).tolist()
        }
    alike = directions.size // array.n_bin if isotropic > 0.0 else 1  # looks of a bin, of which one is reported
    looks = _looks(radar, sorted(places), alike)
    bins = np.array(sorted({look.bin for look in looks}), dtype=np.int32)
    return Transmission(isotropic, factor, beams, bins, looks, nus, gates)


def _looks(radar: RadarConfig, places: Sequence[tuple[float, Gate]], alike: int) -> list[Look]:
    """Looks in these directions and gates, some of which are reported together; what they share is worked out once."""
    tested = {gate: _tested(radar, gate, alike) for _, gate in places}
    bins = angle_bin([nu for nu, _ in places], radar.array.n_bin).tolist()
    return [Look(nu, bin_, *tested[gate]) for (nu, gate), bin_ in zip(places, bins, strict=True)]


def _tested(radar: RadarConfig, gate: Gate, alike: int) -> tuple[range, float]:
    """Range cells of a gate and the limit of their tests; ALL_RANGES: where targets may be found at all."""
    cells, width, acquisition = range(0), radar.receiver.range_cell_km, radar.acquisition
    if width > 0.0:
        ends = acquisition.ranges_km if gate == ALL_RANGES else gate
        cells = range_cells(*ends, width)
    return cells, threshold(radar.detector.p_fa, alike * max(len(cells), 1))


def check_waveform(waveform: Waveform, radar: RadarConfig, dwells: int) -> None:
    """Refuse what the transmitter cannot send, and a dwell that the run cannot have."""
    array = radar.array
    power = waveform.isotropic + float(np.sum(np.abs(waveform.factor.astype(np.complex128)) ** 2))
    check_dwell(waveform.k, radar, dwells)
    if waveform.factor.shape[0] != array.n_tx:
        raise Refused(f"waveform for {waveform.factor.shape[0]} antennas, the array has {array.n_tx}")
    if waveform.beams.shape[0] != radar.tracks or (waveform.beams >= array.n_bin).any():
        raise Refused(
            f"beams {waveform.beams.tolist()}, expected those of {radar.tracks} tracks in bins 0 .. {array.n_bin - 1}"
        )
    if not waveform.tracking and (waveform.beams != -1).any():
        raise Refused("an acquisition waveform must have no beams")
    if power > array.power * (1.0 + POWER_TOLERANCE):
        raise Refused(f"power {power:g}, at most {array.power:g} is allowed")
    if not waveform.tracking and waveform.isotropic == 0.0:
        raise Refused("an acquisition waveform must light up every cell")
    check_directions(waveform.beams, waveform.nus, radar)


def scan_message(settings: Settings, k: int, t: int, measured: ScanData) -> Scan:
    """The message of what was measured. Raises FrontEndError if it makes no sense: all readers would drop it."""
    columns = {column.name: getattr(measured, column.name) for column in fields(measured)}
    arrays = {
        name: np.asarray(values, dtype=_TYPES.get(name, np.float64))
        for name, values in columns.items()
        if values is not None
    }
    try:
        scan = Scan.model_validate({"run": settings.run, "k": k, "t": t} | arrays)
        check_scan(scan, settings.radar)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise FrontEndError(f"scan of dwell {k}: {'.'.join(map(str, first['loc']))}: {plain(first)}") from None
    except Refused as refusal:
        raise FrontEndError(f"dwell {k}: {refusal}") from None
    return scan


def truth_message(scan: Scan, truth: GroundTruth, waveform: Waveform | None) -> Truth:
    """Where the targets were in the dwell of a scan."""
    return Truth(
        run=scan.run,
        k=scan.k,
        t=scan.t,
        states=truth.states,
        bins=truth.bins,
        snr_db=truth.snr_db,
        waveform_k=-1 if waveform is None else waveform.k,
    )
