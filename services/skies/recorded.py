"""Recorded positions of aircraft as targets, and targets as such a recording.

A position becomes distance and azimuth from the radar along the ellipsoid (WGS 84): x along the boresight, y to the
right of it. The altitude above the ellipsoid or the sea is the height over the plane of the array, if heights are asked
for: the Earth's curvature, 0.8 km at a distance of 100 km, is not in it.
"""

import csv
import io
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from itertools import pairwise
from math import hypot, isfinite
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cogradar.services.errors import BadInput
from cogradar.services.skies.files import Target
from cogradar.services.skies.place import Place
from cogradar.shared.scenario.limits import MAX_HEIGHT_KM
from cogradar.shared.world.targets import Flights

# Names that archives of ADS-B use, in lower case, the usual ones first.
COLUMNS = {
    "time": ("lastposupdate", "time", "timestamp", "t", "seen_at"),
    "aircraft": ("icao24", "hex", "icao", "aircraft", "callsign", "flight"),
    "latitude": ("lat", "latitude"),
    "longitude": ("lon", "longitude", "long", "lng"),
}
# Columns of altitudes, and how many km their unit has. OpenSky has metres; readsb, and the package traffic, whose files
# have `altitude` beside `geoaltitude`, feet.
FOOT_KM = 0.3048e-3
HEIGHTS = {
    "z_km": 1.0,
    "altitude_m": 1e-3,
    "altitude_ft": FOOT_KM,
    "altitude": FOOT_KM,
    "alt_geom": FOOT_KM,
    "alt_baro": FOOT_KM,
    "geoaltitude": 1e-3,
    "baroaltitude": 1e-3,
}
ON_GROUND = "ground"
UNKNOWN = {"", "nan", "none", "null"}
MILLISECONDS = 1e11  # a larger time counts them; seconds of the next thousand years do not
MICROSECONDS = 1e14
GAP_S = 120.0  # without a position: another flight
SETTLED_S = 20.0  # from the first position on, after which all that were there have told theirs
STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0)  # between rows of an aircraft, the least that keeps
MOST_KM_S = 1.0  # a position that an aircraft would have to be faster for is a glitch
MOST_ROWS = 20_000
MOST_POSITIONS = 1_000_000  # that are read: some 200 MB
DEGREE_KM = 110.5  # of latitude, at least
SIGNALS_S = 5  # between positions of an aircraft in a recording that we make

Row = tuple[float, ...]  # t_s, x_km, y_km, and z_km if heights are asked for
Position = tuple[float, str, float, float, float | None]  # time in s, aircraft, latitude, longitude, height in km


class Recording(NamedTuple):
    """What a recording becomes."""

    targets: list[Target]
    seconds: int
    aircraft: int  # of which there are positions in view


def recorded(file: Path, place: Place, range_km: float, *, heights: bool = False) -> Recording:
    """The flights of a recording that come into view, with their trajectories, and if asked for with their heights.

    Clock 0 is the first second, SETTLED_S or more after the first position, in which somebody is in view. Raises
    BadInput.
    """
    flights = [
        (aircraft, flight)
        for aircraft, rows in _in_range(file, place, range_km, heights=heights).items()
        for flight in _flights(rows)
        if len(_thinned(flight, STEPS_S[0])) > 1
    ]
    if not flights:
        raise BadInput(
            f"{file}: no aircraft with two positions within {range_km:g} km before the radar at"
            f" {place.latitude:g},{place.longitude:g}"
        )
    begin = _clock_0([flight for _, flight in flights])
    kept = [(aircraft, [(t - begin, *at) for t, *at in flight]) for aircraft, flight in flights]
    kept = [(aircraft, _thinned(flight, STEPS_S[0])) for aircraft, flight in kept]
    kept = [(aircraft, flight) for aircraft, flight in kept if flight[-1][0] > 0.0]
    steps = (step for step in STEPS_S if sum(len(_thinned(flight, step)) for _, flight in kept) <= MOST_ROWS)
    step = next(steps, STEPS_S[-1])
    targets: list[Target] = [
        {"trajectory": [[round(value, 3) for value in row] for row in _thinned(flight, step)]} for _, flight in kept
    ]
    seconds = int(max(flight[-1][0] for _, flight in kept))
    return Recording(targets, seconds, len({aircraft for aircraft, _ in kept}))


def _clock_0(flights: list[list[Row]]) -> float:
    first, last = min(flight[0][0] for flight in flights), max(flight[-1][0] for flight in flights)
    for t in np.arange(first + min(SETTLED_S, 0.5 * (last - first)), last, 1.0).tolist():
        for flight in flights:
            times, xs, *_ = zip(*flight, strict=True)
            if times[0] <= t < times[-1] and float(np.interp(t, times, xs)) >= 0.0:
                return float(t)
    return first


def _in_range(file: Path, place: Place, range_km: float, *, heights: bool) -> dict[str, list[Row]]:
    """Positions within range by aircraft, in the order of their times; before and behind the radar.

    A position without a height takes the height before it, or else the first one after it.
    """
    found: dict[str, dict[float, Row]] = {}
    last: dict[str, tuple[float, float]] = {}
    near = list[Position]()
    for position in _positions(file, heights=heights):
        if abs(position[2] - place.latitude) * DEGREE_KM <= range_km:
            near.append(position)
        if len(near) > MOST_POSITIONS:
            raise BadInput(f"{file}: more than {MOST_POSITIONS} positions near the radar, must be fewer")
    near.sort(key=itemgetter(0, 1, 2, 3))
    known = {aircraft: z for _, aircraft, _, _, z in reversed(near) if z is not None}
    for t, aircraft, latitude, longitude, z in near:
        known[aircraft] = known.get(aircraft, 0.0) if z is None else z
        # Archives repeat the last position of an aircraft that has gone silent.
        if last.get(aircraft) == (latitude, longitude):
            continue
        last[aircraft] = latitude, longitude
        x, y = place.seen(latitude, longitude)
        if hypot(x, y) <= range_km:
            rows = found.setdefault(aircraft, {})
            if not rows or _is_flown(next(reversed(rows.values())), (t, x, y)):
                rows[t] = (t, x, y, known[aircraft]) if heights else (t, x, y)
    return {aircraft: list(rows.values()) for aircraft, rows in found.items()}


def _is_flown(one: Row, next_: Row) -> bool:
    """Whether an aircraft can be at the next row after this one, positions being known to 100 m."""
    return hypot(next_[1] - one[1], next_[2] - one[2]) <= MOST_KM_S * (next_[0] - one[0]) + 0.1


def _flights(rows: list[Row]) -> Iterator[list[Row]]:
    """The rows of an aircraft without gaps, from the last one before it comes into view to the first one after."""
    starts = [0, *(i + 1 for i, (one, next_) in enumerate(pairwise(rows)) if next_[0] - one[0] > GAP_S), len(rows)]
    for begin, end in pairwise(starts):
        seen = [i for i in range(begin, end) if rows[i][1] >= 0.0]
        if seen:
            yield rows[max(seen[0] - 1, begin) : min(seen[-1] + 2, end)]


def _thinned(rows: list[Row], step_s: float) -> list[Row]:
    """Rows at least so far apart: a smooth course through two receivers' positions of one moment would swing out."""
    kept = rows[:1]
    for row in rows[1:]:
        if row[0] - kept[-1][0] >= step_s:
            kept.append(row)
    return kept


def _positions(file: Path, *, heights: bool) -> Iterator[Position]:
    """Of the rows that have time, aircraft, latitude and longitude; heights: None if unknown. Raises BadInput."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream)
            header = [cell.strip().lower() for cell in next(reader, [])]
            places = [_columns(file, header, what) for what in COLUMNS]
            height = _height(file, header) if heights else None
            for line, cells in enumerate(reader, start=2):
                time, aircraft, latitude, longitude = (_first_known(cells, of) for of in places)
                if UNKNOWN.isdisjoint(text.lower() for text in (time, aircraft, latitude, longitude)):
                    where = [
                        _number(file, line, name, text)
                        for name, text in (("latitude", latitude), ("longitude", longitude))
                    ]
                    if max(abs(where[0]) - 90.0, abs(where[1]) - 360.0) > 0.0:
                        raise BadInput(f"{file}: line {line}: {latitude}, {longitude} is no latitude and longitude")
                    z = None if height is None else _height_km(file, line, cells, *height)
                    yield _time(file, line, time), aircraft.lower(), where[0], where[1], z
    except FileNotFoundError:
        raise BadInput(f"{file}: no such file") from None
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror or error}") from None
    except (ValueError, csv.Error) as error:
        raise error if isinstance(error, BadInput) else BadInput(f"{file}: no CSV file: {error}") from None


def _columns(file: Path, header: list[str], what: str) -> list[int]:
    """The column that says it; of the time all that there are, since not every row has the best one."""
    found = [header.index(name) for name in COLUMNS[what] if name in header]
    if not found:
        raise BadInput(f"{file}: its header has no column for the {what}, must have one of {', '.join(COLUMNS[what])}")
    return found if what == "time" else found[:1]


def _height(file: Path, header: list[str]) -> tuple[int, str]:
    """The column of the altitude, and its name."""
    name = next((name for name in HEIGHTS if name in header), None)
    if name is None:
        raise BadInput(
            f"{file}: its header has no column for the altitude, which --heights needs, must have one of"
            f" {', '.join(HEIGHTS)}"
        )
    return header.index(name), name


def _height_km(file: Path, line: int, cells: list[str], column: int, name: str) -> float | None:
    """What a row says of the height; of an aircraft on the ground, or below the plane of the array, 0."""
    text = _first_known(cells, [column])
    if not text:
        return None
    if text.lower() == ON_GROUND:
        return 0.0
    z = HEIGHTS[name] * _number(file, line, name, text)
    if z > MAX_HEIGHT_KM:
        raise BadInput(f"{file}: line {line}: {name} = {text[:40]!r}: {z:g} km, must be at most {MAX_HEIGHT_KM:g}")
    return max(z, 0.0)


def _first_known(cells: list[str], columns: list[int]) -> str:
    """What a row says in the first of these columns that says anything."""
    said = (cells[i].strip() for i in columns if i < len(cells))
    return next((text for text in said if text.lower() not in UNKNOWN), "")


def _number(file: Path, line: int, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise BadInput(f"{file}: line {line}: {what} = {text[:40]!r}: must be a number")
    return value


def _time(file: Path, line: int, text: str) -> float:
    """Seconds of a time, which may be in milliseconds or as ISO 8601 has it."""
    try:
        value = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise BadInput(
                f"{file}: line {line}: time = {text[:40]!r}: must be seconds or as ISO 8601 has it"
            ) from None
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if not isfinite(value):
        raise BadInput(f"{file}: line {line}: time = {text[:40]!r}: must be seconds or as ISO 8601 has it")
    if value > MICROSECONDS:
        raise BadInput(f"{file}: line {line}: time = {text[:40]!r}: must be in seconds or milliseconds")
    return value / 1e3 if value > MILLISECONDS else value


def recording(flights: Flights, seconds: int, place: Place) -> str:
    """What a receiver of ADS-B would have recorded of these flights, a dwell of which is a second: a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("time", "icao24", "lat", "lon"))
    writer.writerows(_signals(flights, seconds, place))
    return text.getvalue()


def _signals(flights: Flights, seconds: int, place: Place) -> Iterable[tuple[int, str, str, str]]:
    states = flights.start()
    for t in range(seconds + 1):
        states = flights.moved(states, t) if t else states
        for m in np.flatnonzero(flights.present(states, t)).tolist():
            if (t + m) % SIGNALS_S == 0:
                latitude, longitude = place.position(float(states[m, 0]), float(states[m, 2]))
                yield t, f"{0xABC000 + m:06x}", f"{latitude:.6f}", f"{longitude:.6f}"
