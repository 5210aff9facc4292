"""The protocol of a front end: what transmits a waveform and returns what its receiver measured.

For a real receiver write one class with `transmit` and `close` and name it to the emulator
(docs/howto/front-end.md). Pacing, recovery and messages are the business of `cogradar.services.emulator.core`, the same
for all.

Symbols: M tracks; n cells tested; Lambda Wald-type statistic; R = (isotropic / n_tx) I + F F^H transmit covariance.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.linear import energy
from cogradar.shared.protocol.messages import MAX_FAULT, EmulatorCheckpoint, Refused
from cogradar.shared.protocol.orders import Setting
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.detector import calibration
from cogradar.shared.signal.detector.calibration import Calibration, Target
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.levels import FEWEST_REFERENCES, references
from cogradar.shared.signal.detector.reception import LookTable
from cogradar.shared.signal.detector.reception import receive as measured_of
from cogradar.shared.signal.looks import NO_RANGE, Look, Measured, range_cell_centre, range_cells
from cogradar.shared.signal.receiver import Cell
from cogradar.shared.signal.waveform import Signatures

KEPT = 64  # data sets that are kept until the directions of what was detected are measured


class FrontEndError(Exception):
    """A front end cannot be opened or cannot go on; the text says why. It is closed, and opened again."""


class SenselessScan(FrontEndError):
    """What a front end has measured cannot be; the text says where and why. Of its dwell nothing was measured."""


def fault_line(text: object) -> str:
    """A fault as all are told of it: a line that any terminal shows as it is, and not a long one."""
    return printable(str(text))[:MAX_FAULT]


def told(error: BaseException) -> str:
    """An exception in a line: the file and line of somebody else's code that it comes from, its type, its text."""
    frames = traceback.walk_tb(error.__traceback__)
    theirs = [(frame.f_code.co_filename, line) for frame, line in frames if not _is_ours(frame.f_globals)]
    lines = [line for file, line in theirs if file == theirs[0][0]]  # of what we called, not of what it calls in turn
    where = f"{Path(theirs[0][0]).name}, line {lines[-1]}: " if theirs else ""
    return f"{where}{type(error).__name__}: {error}"


def _is_ours(names: Mapping[str, Any]) -> bool:
    return str(names.get("__name__")).startswith("cogradar.")


@dataclass(frozen=True)
class Settings:
    """What a front end is told when it is opened: what the radar knows, never the truth."""

    run: str
    radar: RadarConfig
    strategy: Strategy
    dwells: int  # of the run, after the acquisition
    rate_hz: float  # dwells per second; 0: in lockstep, each as soon as its waveform is there

    @classmethod
    def of(cls, checkpoint: EmulatorCheckpoint) -> Self:
        """Settings of a run that begins, or goes on, with this checkpoint. Raises Refused if its clock cannot be."""
        if checkpoint.t > min(checkpoint.k, checkpoint.dwells):
            raise Refused(f"checkpoint {checkpoint.k} of {checkpoint.dwells} dwells at t = {checkpoint.t}")
        radar = RadarConfig.model_validate(checkpoint.radar)
        return cls(checkpoint.run, radar, checkpoint.strategy, checkpoint.dwells, checkpoint.rate_hz)


@dataclass(frozen=True)
class Transmission:
    """What to radiate in one dwell, and which cells to test."""

    isotropic: float  # >= 0, power spread evenly over all directions
    factor: NDArray[np.complex128]  # (n_tx, r), F, one column per beam
    beams: NDArray[np.int32]  # (M, L) bins of each track's beams; -1: none (further), all during acquisition
    bins: NDArray[np.int32]  # (n,) cells to test, ascending: all if power goes everywhere, else the beams' cells
    looks: Sequence[Look]  # the same with direction, range cells and limit; with range cells, all bins have two each
    nus: NDArray[np.float64]  # (M, L) directions of `beams`, of bins their centres; 0 where there is none
    gates: NDArray[np.float64]  # (M, 2) ranges to be tested for each track, km; (0, 0): all

    @property
    def power(self) -> float:
        """All of it; 0: nothing is radiated."""
        return self.isotropic + energy(self.factor)

    @property
    def range_cells(self) -> list[int]:
        """Numbers of the range cells that some look tests, ascending; without range cells NO_RANGE alone."""
        return LookTable.of(self.looks).range_cells()


@dataclass(frozen=True)
class ScanData:
    """What the receiver measured in the cells of one dwell.

    A cell that was asked for may be left out: it was not measured, which says nothing of any target.
    """

    bins: NDArray[np.int32]  # (n,) cells tested, ascending
    statistic: NDArray[np.float64]  # (n,) Lambda >= 0
    alpha_hat: NDArray[np.complex64]  # (n,) estimated echo amplitude
    sigma_hat: NDArray[np.float64]  # (n,) its standard deviation, > 0 where the statistic is
    signature_power: NDArray[np.float64]  # (n,) ||v||^2
    beams: NDArray[np.int32] | None = None  # (M, L) where the beams really were; None: where they were asked for
    # Needed with steered cells: by direction, and there may be several of one look
    # (`cogradar.shared.signal.looks.reported`). Of bins they say nothing new, and are not sent.
    nus: NDArray[np.float64] | None = None  # (n,) directions of the cells, as of the looks
    limits: NDArray[np.float64] | None = None  # (n,) what the statistic was compared with
    ranges_km: NDArray[np.float64] | None = None  # (n,) centre of the range cell; 0: there are none
    nu_hats: NDArray[np.float64] | None = None  # (n,) measured direction of the echo,
    nu_sigmas: NDArray[np.float64] | None = None  # (n,) ... its standard deviation; 0: not measured
    beam_nus: NDArray[np.float64] | None = None  # (M, L) directions of `beams`, and
    gates: NDArray[np.float64] | None = None  # ... (M, 2) ranges tested for each track, if `beams` is there
    roster: Roster | None = None  # of a recording: the tracks whose beams these are, if their number is unknown
    # (u,) directions that were asked for and are left out; None: as far as `beams` is given, there are none
    unmeasured: NDArray[np.float64] | None = None
    lost_km: NDArray[np.float64] | None = None  # (v,) centres of range cells that were asked for and not received
    fault: str | None = None  # why nothing was measured
    # If `beams` is there: dwell whose waveform these beams are of, where it is older than k-1; None: it is not.
    waveform_k: int | None = None
    settings: Sequence[Setting] | None = None  # of a recording: what was set by commands
    utc_s: float | None = None  # when it was measured, s since 1970 in UTC, if the receiver knows
    front_end: str | None = None  # Name of the user's own front end, which the emulator puts in.

    @classmethod
    def not_measured(cls, fault: str | None = None) -> Self:
        """Nothing was measured in a dwell, for this reason: the tracks coast, and no target was missed."""
        return replace(cls.of_looks(()), fault=fault)

    @classmethod
    def of_cells(cls, bins: NDArray[np.int32], cells: Sequence[Cell]) -> Self:
        """Scan of these cells, as `cogradar.shared.signal.receiver.wald_test` measured them one by one."""
        return cls(
            bins,
            statistic=np.array([cell.statistic for cell in cells]),
            alpha_hat=np.array([cell.alpha_hat for cell in cells], dtype=np.complex64),
            sigma_hat=np.array([cell.sigma_hat for cell in cells]),
            signature_power=np.array([cell.signature_power for cell in cells]),
        )

    @classmethod
    def of_looks(cls, measured: Sequence[Measured]) -> Self:
        """Scan of looks, as `cogradar.shared.signal.looks.reported` has them."""
        scan = cls.of_cells(np.array([one.look.bin for one in measured], np.int32), [one.cell for one in measured])
        return replace(
            scan,
            nus=np.array([one.look.nu for one in measured]),
            limits=np.array([one.look.limit for one in measured]),
            ranges_km=np.array([one.range_km for one in measured]),
            nu_hats=np.array([one.nu_hat for one in measured]),
            nu_sigmas=np.array([one.nu_sigma for one in measured]),
        )


def receive(
    data: NDArray[np.complex128] | Mapping[int, NDArray[np.complex128]], waveform: Transmission, radar: RadarConfig
) -> ScanData:
    """What the radar's receiver makes of what an array received in a dwell.

    data : (n_tx, n_rx) complex, Y after matched filtering: a row for each transmitted waveform, a column for each
           receive antenna. With range cells one of each, by number: cell i begins at i times
           `radar.receiver.range_cell_km`. Nothing is reported of range cells that are not there. A look without any
           data is left out, and a track's look without the data of one of its range cells. A look at all ranges reports
           what was received, and `lost_km` what was not. Detections change nothing of this.
    Raises SenselessScan if data have another shape, or a range cell a number that none has.
    """
    array, width_km = radar.array, radar.receiver.range_cell_km
    by_cell = data if isinstance(data, Mapping) else {NO_RANGE: data}
    signatures, processing = Signatures(waveform.isotropic, waveform.factor, array.n_rx), Processing.of(radar.receiver)
    signatures.prepare([look.nu for look in waveform.looks])
    asked = set(waveform.range_cells)
    if width_km > 0.0 and (lowest := min(by_cell, default=0)) < 0:
        raise SenselessScan(f"data of range cell {lowest}: a dictionary by numbers from 0 is needed")
    known = sorted(asked & by_cell.keys())

    @lru_cache(KEPT)
    def received(cell: int) -> DataSet:
        y = np.ascontiguousarray(by_cell[cell], dtype=np.complex128)
        if y.shape != (array.n_tx, array.n_rx):
            raise SenselessScan(f"data of shape {y.shape}, ({array.n_tx}, {array.n_rx}) are needed")
        return DataSet(y.ravel(), signatures, processing)

    others = references(sorted(by_cell)) if processing.by_range else ()
    if processing.by_range and len(others) < FEWEST_REFERENCES:
        return ScanData.not_measured(
            f'there are data of {len(by_cell)} range cells, radar.receiver.noise = "range-cells" needs'
            f" {FEWEST_REFERENCES} at least"
        )
    if not (lost := sorted(asked - by_cell.keys())):
        return ScanData.of_looks(measured_of(waveform.looks, received, known, width_km, others=others))
    everywhere = range_cells(*radar.acquisition.ranges_km, width_km) if width_km > 0.0 else range(0)
    # A miss is not believed of a look that is incomplete. So its detections must not be, either.
    looks = [look for look in waveform.looks if look.cells == everywhere or set(look.cells).isdisjoint(lost)]
    scan = ScanData.of_looks(measured_of(looks, received, known, width_km, others=others))
    return replace(scan, lost_km=np.array([range_cell_centre(cell, width_km) for cell in lost]))


def calibrate(
    snapshots: NDArray[np.complex128],
    radar: RadarConfig,
    *,
    bearing_deg: float | None = None,
    range_km: float | None = None,
    waveform: tuple[float, NDArray[np.complex128]] | None = None,
) -> Calibration:
    """Whether recorded data fit the array that the radar assumes.

    snapshots   : (K, n_tx, n_rx) complex, Y of K dwells or range cells, as for `receive`: noise alone, or one target
    bearing_deg : of the target, above 0 towards +y; None: there is none
    range_km    : of the target, to compare its echo with `radar.echo.amplitude_db`; None: unknown
    waveform    : power in all directions and factor, if it was not isotropic with the power of the array
    Raises ValueError, whose text says what is wrong with the data.
    """
    array, receiver = radar.array, radar.receiver
    y = np.asarray(snapshots)
    if y.ndim != 3 or y.shape[1:] != (array.n_tx, array.n_rx) or not len(y):
        is_exchanged = y.ndim == 3 and y.shape[1:] == (array.n_rx, array.n_tx)
        cure = ": the receive antennas come first; exchange the last two axes" if is_exchanged else ""
        raise ValueError(f"snapshots of shape {y.shape}, (K, {array.n_tx}, {array.n_rx}) are needed{cure}")
    if not np.issubdtype(y.dtype, np.number):
        raise ValueError(f"values of type {y.dtype}, complex numbers are needed")
    sent = waveform or (array.power, np.empty((array.n_tx, 0), np.complex128))
    if sent[1].ndim != 2 or sent[1].shape[0] != array.n_tx:
        raise ValueError(f"factor of shape {sent[1].shape}, ({array.n_tx}, beams) is needed")
    target = None
    if bearing_deg is not None:
        range_db = 0.0 if range_km is None else 40.0 * np.log10(range_km)
        amplitude_db = None if range_km is None else radar.echo.amplitude_db - float(range_db)
        target = Target(0.5 * float(np.sin(np.radians(bearing_deg))), amplitude_db)
    signatures, by_rows = Signatures(*sent, array.n_rx), receiver.noise != "lags"
    return calibration.calibrate(y, signatures, bin_centres(array.n_bin), by_rows=by_rows, target=target)


class FrontEnd(Protocol):
    """One run's transmitter and receiver.

    Dwells come in order. A new front end is opened after a restart of the process, or after its recorder has lost the
    newest part of the journal. It goes on at the dwell after the acknowledged ones: dwell k may then be transmitted
    again. Hardware cannot go back; it transmits dwell k again and measures it anew. Its readers keep the measurement
    that reached them first. While transmission is paused by a command, dwells are passed over.

    One with a `prepare() -> bool` (`Preparing` of wire.runner) may do a part of the next dwell's work while the
    loop computes the next waveform.
    """

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        """Transmit dwell k and measure; None if there are no more dwells, as at the end of a recording.

        k : counts transmit-receive cycles from 0
        t : clock of this dwell, 0 during acquisition, then 1 .. dwells

        What has not come in time is left out, or `ScanData.not_measured` returned if nothing has. One that raises is
        closed, and opened again.
        """

    def close(self) -> None:
        """Stop transmitting: the run is over, or the process ends."""


class GroundTruth(NamedTuple):
    """Where the targets were in the last dwell, M of them: as many as in the whole run, also those not there then."""

    states: NDArray[np.float64]  # (M, 4) [x, vx, y, vy] on the ground, km and km/s; 0 of a target that was not there
    bins: NDArray[np.int32]  # (M,); -1 of a target that was not there
    snr_db: NDArray[np.float64]  # (M,) per virtual channel, before array gain
    heights_km: NDArray[np.float64] | None = None  # (M,); None: all are in the plane of the array


@runtime_checkable
class KnowsTruth(Protocol):
    """A front end that also knows where the targets are: a simulated one. Scores need it, nothing else does."""

    def truth(self, t: int) -> GroundTruth:
        """The truth at clock t: of the dwell that was transmitted last, or of one after it without transmission."""


OpenFrontEnd = Callable[[EmulatorCheckpoint], FrontEnd]  # raises FrontEndError
