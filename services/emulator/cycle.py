"""One transmit-receive cycle in messages: a waveform becomes a transmission, what was measured a scan."""

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from services.emulator.front_end import FrontEndError, GroundTruth, ScanData, Settings, Transmission
from shared.protocol.admission import check_dwell, check_scan
from shared.protocol.messages import Refused, Scan, Truth, Waveform
from shared.scenario.faults import plain
from shared.scenario.radar_config import RadarConfig

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire


def transmission(radar: RadarConfig, waveform: Waveform | None) -> Transmission:
    """What to transmit. None: there is no waveform yet, so power goes in all directions.

    Power in all directions lets every cell be tested; beams only their own.
    """
    isotropic, factor = radar.array.power, np.empty((radar.array.n_tx, 0), dtype=np.complex128)
    beams = np.full((radar.tracks, 1), -1, dtype=np.int32)
    if waveform is not None:
        isotropic, factor, beams = waveform.isotropic, waveform.factor.astype(np.complex128), waveform.beams
    bins = np.arange(radar.array.n_bin, dtype=np.int32) if isotropic > 0.0 else np.unique(beams[beams >= 0])
    return Transmission(isotropic, factor, beams, bins)


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


def scan_message(settings: Settings, k: int, t: int, measured: ScanData, beams: NDArray[np.int32]) -> Scan:
    """The message of what was measured. Raises FrontEndError if it makes no sense: all readers would drop it."""
    try:
        scan = Scan(
            run=settings.run,
            k=k,
            t=t,
            bins=np.asarray(measured.bins, dtype=np.int32),
            statistic=np.asarray(measured.statistic, dtype=np.float64),
            alpha_hat=np.asarray(measured.alpha_hat, dtype=np.complex64),
            sigma_hat=np.asarray(measured.sigma_hat, dtype=np.float64),
            signature_power=np.asarray(measured.signature_power, dtype=np.float64),
            beams=np.asarray(beams, dtype=np.int32),
        )
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
