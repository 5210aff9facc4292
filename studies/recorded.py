"""Recorded air traffic as `cogradar sky --from` reads it: sample trajectories of the package `traffic`.

`traffic` is under the MIT license; its samples are positions of ADS-B that the OpenSky Network received. They are read
as files, so that no requirement of `traffic` is needed. The time of a position is known to a second only, some 100 m of
flight. A curve through all positions would turn with several g. What is written is a local parabola's position.
"""

import csv
import gzip
import json
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput

HEADER = ("time", "icao24", "latitude", "longitude")
STEP_S = 5.0  # between positions that are written
HALF_S = 12.0  # before and after a position, through which a parabola is put
FEWEST = 6  # positions in this time


def collections() -> Path:
    """The folder of the samples. Raises BadInput without the package."""
    spec = find_spec("traffic")
    if spec is None or not spec.submodule_search_locations:
        raise BadInput("the package traffic is missing: make setup")
    return Path(spec.submodule_search_locations[0], "data", "samples", "collections")


def write(name: str, begin_s: float, end_s: float, file: Path) -> int:
    """Write the positions of a sample as CSV, from and to seconds since 1970; returns how many. Raises BadInput."""
    sample = collections() / f"{name}.json.gz"
    if not sample.is_file():
        known = ", ".join(sorted(path.name.removesuffix(".json.gz") for path in sample.parent.glob("*.json.gz")))
        raise BadInput(f"{name}: must be one of {known}")
    flown = _flown(json.loads(gzip.decompress(sample.read_bytes())), begin_s - HALF_S, end_s + HALF_S)
    times = np.arange(begin_s, end_s, STEP_S)
    rows = [row for aircraft, positions in flown.items() for row in _smoothed(aircraft, positions, times)]
    if not rows:
        raise BadInput(f"{name}: has no aircraft between {begin_s:g} and {end_s:g} s")
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(rows)
    return len(rows)


def _flown(rows: list[dict[str, Any]], begin_s: float, end_s: float) -> dict[str, NDArray[np.float64]]:
    """Time, latitude and longitude of each aircraft in the air, (n, 3) ascending, without repeated positions."""
    found = defaultdict[str, dict[tuple[float, float], float]](dict)
    for row in sorted(rows, key=lambda row: row["timestamp"]):
        if begin_s <= 1e-3 * row["timestamp"] <= end_s and not row.get("onground") and row["latitude"] is not None:
            found[row["icao24"]].setdefault((row["latitude"], row["longitude"]), 1e-3 * row["timestamp"])
    return {
        aircraft: np.array([(time, *place) for place, time in places.items()]) for aircraft, places in found.items()
    }


def _smoothed(aircraft: str, positions: NDArray[np.float64], times: NDArray[np.float64]) -> Iterator[list[Any]]:
    """A row at each time that has enough positions, before it as well as after."""
    for time in times.tolist():
        near = positions[np.abs(positions[:, 0] - time) <= HALF_S]
        if len(near) >= FEWEST and near[0, 0] <= time <= near[-1, 0]:
            place = np.polynomial.polynomial.polyfit(near[:, 0] - time, near[:, 1:], 2)[0]
            yield [f"{time:.0f}", aircraft, *(f"{angle:.6f}" for angle in place.tolist())]
