"""Runs for Stone Soup: detections and ground truth as its readers, dwell by dwell, and tracks as its tracks.

    from cogradar.stonesoup import DwellDetectionReader

    for time, tracks in MultiTargetTracker(..., detector=DwellDetectionReader(cogradar.play("traffic"))): ...

Dwells are as in `cogradar.play`, which is played as far as the tracker asks for, or as in `Result.dwells()`. States are
[x, vx, y, vy], km and km/s, with x along boresight. Needs Stone Soup: pip install 'cogradar[stonesoup]'.
"""

import math
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.analysis.export.times import timed
from cogradar.services.errors import MissingLibrary
from cogradar.shared.scenario.radar_config import RadarConfig

try:
    from stonesoup.base import Property
    from stonesoup.buffered_generator import BufferedGenerator
    from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing, CartesianToBearingRange
    from stonesoup.reader import DetectionReader, GroundTruthReader
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
except ImportError as missing:
    raise MissingLibrary(
        f"cogradar.stonesoup needs Stone Soup ({missing}): pip install 'cogradar[stonesoup]'"
    ) from None

BEGAN = datetime(2000, 1, 1)  # dwell 0 where no time is known
POSITION = (0, 2)  # x and y of a state
STEEPEST = 0.999  # sine of an angle from boresight, up to which the bearing's standard deviation grows


def moments(dwells: Iterable[Dwell]) -> Iterator[tuple[datetime, Dwell]]:
    """Dwells after the acquisition, during which targets stand still, with their times, which ascend.

    Times are UTC and without a zone, as Stone Soup has them. They are as the front end says, else as the `[site]` of
    the scenario; from BEGAN on where the site does not say when the run begins. A run has one clock: dwells without a
    time are counted on from the others, and the first ones back.
    """
    epoch_s = BEGAN.replace(tzinfo=UTC).timestamp()
    for at_s, _, dwell in timed((dwell for dwell in dwells if dwell.t > 0), epoch_s):
        yield datetime.fromtimestamp(at_s, UTC).replace(tzinfo=None), dwell


def detections(dwell: Dwell, time: datetime, *, every_row: bool = False) -> set[Detection]:
    """The detections of a dwell, each with its measurement model.

    time      : of the dwell, as of `moments`
    every_row : also the weaker rows of an echo that is over the limit in several looks or range cells

    A model is of bearing (rad) and range (km), of the bearing alone where the radar has no range cells. The bearing's
    standard deviation is the measured one, else of a place in the look; the range's is of a place in the cell. What is
    measured includes the target's height. `metadata` has the columns of `Dwell.detections`.
    """
    rows = dwell.detections()
    chosen = rows if every_row else rows[rows["strongest"] == 1]
    return {_detection(row, time, dwell.scenario.radar) for row in chosen}


def _detection(row: Records, time: datetime, radar: RadarConfig) -> Detection:
    is_measured = not np.isnan(row["nu_measured"])
    look = 1.0 / radar.array.n_rx if radar.receiver.cells == "steered" else 1.0 / (radar.array.n_bin - 1)
    nu, sigma = (row["nu_measured"], row["nu_measured_sigma"]) if is_measured else (row["nu"], look / math.sqrt(12.0))
    sine = min(max(2.0 * float(nu), -1.0), 1.0)
    bearing, variances = Bearing(math.asin(sine)), [4.0 * float(sigma) ** 2 / (1.0 - min(sine**2, STEEPEST**2))]
    state, kind = [bearing], Cartesian2DToBearing
    if not np.isnan(row["range_km"]):
        state, kind = [bearing, float(row["range_km"])], CartesianToBearingRange
        variances.append(float(row["range_cell_km"]) ** 2 / 12.0)
    model = kind(ndim_state=4, mapping=POSITION, noise_covar=np.diag(variances))
    metadata = dict(zip(row.dtype.names or (), row.tolist(), strict=True))
    return Detection(StateVector(state), timestamp=time, measurement_model=model, metadata=metadata)


class DwellDetectionReader(DetectionReader):  # type: ignore[misc] # Stone Soup has no types
    """The detections of each dwell after the acquisition, also of dwells without one."""

    dwells: Iterable[Dwell] = Property(doc="Of `cogradar.play`, or of `Result.dwells()`; each is read once")
    every_row: bool = Property(default=False, doc="Also the weaker rows of an echo")

    @BufferedGenerator.generator_method  # type: ignore[untyped-decorator]
    def detections_gen(self) -> Iterator[tuple[datetime, set[Detection]]]:
        """Time and detections of each dwell."""
        for time, dwell in moments(self.dwells):
            yield time, detections(dwell, time, every_row=self.every_row)


class DwellGroundTruthReader(GroundTruthReader):  # type: ignore[misc]
    """The paths, so far, of the targets that are there in each dwell. Raises BadInput where there is no truth."""

    dwells: Iterable[Dwell] = Property(doc="Of `cogradar.play`, or of `Result.dwells()`; each is read once")

    @BufferedGenerator.generator_method  # type: ignore[untyped-decorator]
    def groundtruth_paths_gen(self) -> Iterator[tuple[datetime, set[GroundTruthPath]]]:
        """Time and paths of each dwell."""
        paths = dict[int, GroundTruthPath]()
        for time, dwell in moments(self.dwells):
            there = set[GroundTruthPath]()
            for row in dwell.truth():
                path = paths.setdefault(int(row["target"]), GroundTruthPath(id=str(row["target"])))
                path.append(GroundTruthState(_state(row, ""), timestamp=time, metadata={"z_km": float(row["z"])}))
                there.add(path)
            yield time, there


def truth(dwells: Iterable[Dwell]) -> set[GroundTruthPath]:
    """The whole path of each target. Raises BadInput where there is no truth."""
    found = set[GroundTruthPath]()
    for _, paths in DwellGroundTruthReader(dwells):
        found |= paths
    return found


def tracks(dwells: Iterable[Dwell], *, tentative: bool = False) -> set[Track]:
    """The radar's own tracks; a track's id is its number.

    tentative : also the states before a track was confirmed
    """
    found = dict[int, Track]()
    for time, dwell in moments(dwells):
        for row in dwell.tracks():
            if row["confirmed"] or tentative:
                track = found.setdefault(int(row["track"]), Track(id=str(row["track"])))
                track.append(GaussianState(_state(row, "_hat"), row["covariance"], timestamp=time))
    return set(found.values())


def _state(row: Any, suffix: str) -> StateVector:
    return StateVector([float(row[f"{name}{suffix}"]) for name in ("x", "vx", "y", "vy")])
