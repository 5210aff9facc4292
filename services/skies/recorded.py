"""Recorded positions of aircraft as targets, and targets as such a recording.

A position becomes distance and azimuth from the radar along the ellipsoid (WGS 84): x along the boresight, y to the
right of it. The altitude above the ellipsoid or the sea is the height over the plane of the array, if heights are asked
for. The Earth's curvature, 0.8 km at a distance of 100 km, is not in it.
"""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from itertools import pairwise
from math import cos, hypot, radians
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput
from cogradar.services.skies.courses import GAP_S, Course, believed, without_repeats
from cogradar.services.skies.files import Target
from cogradar.services.skies.place import Place
from cogradar.services.skies.readers.formats import reports
from cogradar.services.skies.readers.report import Report, Tally, Why
from cogradar.services.skies.selection import Selection
from cogradar.shared.scenario.faults import printable
from cogradar.shared.world.targets import Flights

SETTLED_S = 20.0  # from the first position on, after which all that were there have told theirs
STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0)  # between rows of an aircraft, the least that keeps
MOST_ROWS = 20_000
MOST_POSITIONS = 1_000_000  # that are read: some 400 MB
PAUSE_S = 3600.0  # without any position: another recording, or a wrong clock
SINCE_1970_S = 1e8  # an earlier time does not count from then
DEGREE_KM = 110.5  # of latitude, at least
SIGNALS_S = 5  # between positions of an aircraft in a recording that we make


class Recording(NamedTuple):
    """What a recording becomes."""

    targets: list[Target]
    seconds: int
    aircraft: int  # of which there are positions in view
    begin_utc: str | None  # of clock 0; None: the recording's times do not say
    tally: Tally


class _Flight(NamedTuple):
    """Rows of an aircraft without a gap."""

    aircraft: str
    rows: Course


def recorded(
    file: Path, place: Place, range_km: float, *, heights: bool = False, selection: Selection | None = None
) -> Recording:
    """The flights of a recording that come into view, with their trajectories, and if asked for with their heights.

    Clock 0 is the first second, SETTLED_S or more after the first position, in which an aircraft is in view. Raises
    BadInput.
    """
    try:
        return _recorded(file, place, range_km, selection or Selection(), heights=heights)
    except BadInput as error:
        raise BadInput(printable(str(error))) from None  # whatever the file has


def _recorded(file: Path, place: Place, range_km: float, selection: Selection, *, heights: bool) -> Recording:
    tally = Tally()
    near = _near(file, place, range_km, selection, tally)
    flights = [
        flight
        for aircraft, mine in _by_aircraft(near, tally, file, selection).items()
        for course in believed(_course(without_repeats(mine, tally), place, range_km, tally), tally)
        for flight in _flights(aircraft, course, tally)
    ]
    if heights and not any(np.isfinite(flight.rows.z).any() for flight in flights) and flights:
        raise BadInput(f"{file}: no row has an altitude, which --heights needs")
    flights = _most_in_view(flights, selection.most, tally)
    if not flights:
        raise BadInput(
            f"{file}: no aircraft with two positions within {range_km:g} km before the radar at"
            f" {place.latitude:g},{place.longitude:g}; {tally.rows} rows were read"
            + (f": {tally.reasons}" if tally.reasons else "")
            + "".join(f"; {note}" for note in tally.notes)
        )
    begin = _clock_0(flights)
    kept = [flight._replace(rows=flight.rows._replace(t=flight.rows.t - begin)) for flight in flights]
    kept = _still_there(kept, tally)
    steps = [step for step in STEPS_S if sum(_dense(flight.rows.t, step).sum() for flight in kept) <= MOST_ROWS]
    step = steps[0] if steps else STEPS_S[-1]
    targets: list[Target] = [
        {"trajectory": _trajectory(_thinned(flight.rows, step, tally), heights=heights)} for flight in kept
    ]
    if step > STEPS_S[0]:
        tally.note(f"of each aircraft a row per {step:g} s is kept, so that there are at most {MOST_ROWS}")
    return Recording(
        targets,
        int(max(flight.rows.t[-1] for flight in kept)),
        len({flight.aircraft for flight in kept}),
        _utc(begin) if begin > SINCE_1970_S else None,
        tally,
    )


def _near(file: Path, place: Place, range_km: float, selection: Selection, tally: Tally) -> list[Report]:
    """The positions that may be within range, in the time that is asked for, and in the air if asked for."""
    found = list[Report]()
    swapped = 0
    wide = DEGREE_KM * cos(radians(min(abs(place.latitude) + range_km / DEGREE_KM, 90.0)))
    for one in reports(file, place, tally):
        if not selection.has(one.time):
            tally.drop(Why.OUTSIDE, one.row, f"{_moment(one.time)}")
        elif one.on_ground and not selection.ground:
            tally.drop(Why.GROUND, one.row)
        elif not _may_be_near(one.latitude, one.longitude, place, range_km, wide):
            tally.drop(Why.BEYOND, one.row, f"{one.latitude:g}, {one.longitude:g}")
            swapped += _may_be_near(one.longitude, one.latitude, place, range_km, wide)
        else:
            found.append(one)
            if len(found) > MOST_POSITIONS:
                raise BadInput(
                    f"{file}: more than {MOST_POSITIONS} positions near the radar, must be fewer: --start and"
                    " --minutes select a part, or a smaller --range"
                )
    if swapped > len(found):
        tally.note(f"latitude and longitude may be swapped: so {swapped} rows would be near; rename the columns")
    return _one_session(found, selection, tally)


def _may_be_near(latitude: float, longitude: float, place: Place, range_km: float, wide: float) -> bool:
    east = (longitude - place.longitude + 180.0) % 360.0 - 180.0
    return abs(latitude - place.latitude) * DEGREE_KM <= range_km and abs(east) * wide <= 1.01 * range_km


def _one_session(found: list[Report], selection: Selection, tally: Tally) -> list[Report]:
    """The positions without those hours away: of the first stretch after a start, else of the one with most of them.

    A wrong clock puts a row years away, and a day without an aircraft is not worth playing.
    """
    found.sort(key=lambda one: (one.time, one.address, one.name, one.row))
    cuts = [i + 1 for i, (one, next_) in enumerate(pairwise(found)) if next_.time - one.time > PAUSE_S]
    parts = [found[i:j] for i, j in pairwise([0, *cuts, len(found)])]
    chosen = parts[0] if selection.start_s is not None else max(parts, key=len)
    for part in parts:
        if part is not chosen:
            said = f"{len(part)} from {_moment(part[0].time)}"
            for one in part:
                tally.drop(Why.ELSEWHEN, one.row, said)
    if len(parts) > 1:
        tally.note(
            f"there are {len(parts)} stretches of time with an hour or more between them: the one from"
            f" {_moment(chosen[0].time)} to {_moment(chosen[-1].time)} is used; --start selects another one"
        )
    return selection.in_time(chosen, tally)


def _by_aircraft(found: list[Report], tally: Tally, file: Path, selection: Selection) -> dict[str, list[Report]]:
    """Positions by aircraft. A row with a callsign only is of the aircraft that has the same in other rows."""
    addresses: dict[str, set[str]] = {}
    for one in found:
        if one.address and one.name:
            addresses.setdefault(one.name, set()).add(one.address)
    sorted_out: dict[str, list[Report]] = {}
    nameless = Counter[str]()
    for one in found:
        known = addresses.get(one.name, set())
        aircraft = one.address or (next(iter(known)) if len(known) == 1 else one.name)
        if not one.address:
            nameless[aircraft] += 1
        sorted_out.setdefault(aircraft, []).append(one)
    if nameless and any(one.address for one in found):
        tally.note(f"{nameless.total()} rows have no address: {len(nameless)} aircraft are told apart by callsign")
    return selection.among(sorted_out, addresses, file, tally)


def _course(mine: list[Report], place: Place, range_km: float, tally: Tally) -> Course:
    """Positions of one aircraft within range, as the radar sees them."""
    ranks = Counter(one.source for one in mine if one.height_km is not None)
    best = max(ranks, key=lambda source: (ranks[source], -source), default=-1)
    rows = list[tuple[float, ...]]()
    for one in mine:
        x, y = place.seen(one.latitude, one.longitude)
        if hypot(x, y) > range_km:
            tally.drop(Why.BEYOND, one.row, f"{one.latitude:g}, {one.longitude:g}")
            continue
        z = one.height_km if one.height_km is not None and (one.source == best or one.on_ground) else float("nan")
        rows.append((one.row, one.time, x, y, z))
    table = np.array(rows, np.float64).reshape(-1, 5)
    return Course(table[:, 0].astype(np.int64), *table[:, 1:].T)


def _flights(aircraft: str, course: Course, tally: Tally) -> Iterator[_Flight]:
    """The rows of an aircraft without gaps, from the last one before it comes into view to the first one after."""
    course = course._replace(z=_filled(course.z))
    cuts = np.flatnonzero(np.diff(course.t) > GAP_S) + 1
    for begin, end in pairwise([0, *cuts.tolist(), len(course.t)]):
        seen = begin + np.flatnonzero(course.x[begin:end] >= 0.0)
        if not len(seen):
            tally.drop_all(Why.BEHIND, course.row[begin:end].tolist())
            continue
        first, last = max(int(seen[0]) - 1, begin), min(int(seen[-1]) + 2, end)
        tally.drop_all(Why.BEHIND, [*course.row[begin:first].tolist(), *course.row[last:end].tolist()])
        flight = course.where(np.arange(first, last))
        if _dense(flight.t, STEPS_S[0]).sum() > 1:
            yield _Flight(aircraft, flight)
        else:
            tally.drop_all(Why.LONE, flight.row.tolist())


def _filled(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights of which an unknown one is as the one before it, or else the first one after it; else all unknown."""
    known = np.flatnonzero(np.isfinite(z))
    if not len(known):
        return z
    before = np.searchsorted(known, np.arange(len(z)), side="right") - 1
    return np.asarray(z[known[np.maximum(before, 0)]])


def _most_in_view(flights: list[_Flight], most: int | None, tally: Tally) -> list[_Flight]:
    """The flights of so many aircraft, with most seconds."""
    seconds = Counter[str]()
    for flight in flights:
        seconds[flight.aircraft] += int(1e3 * (flight.rows.t[-1] - flight.rows.t[0]))
    chosen = {aircraft for aircraft, _ in seconds.most_common(most)}
    for flight in flights:
        if flight.aircraft not in chosen:
            tally.drop_all(Why.FEW, flight.rows.row.tolist())
    return [flight for flight in flights if flight.aircraft in chosen]


def _still_there(flights: list[_Flight], tally: Tally) -> list[_Flight]:
    """Flights that go on after clock 0, of their rows those that are dense at most."""
    found = list[_Flight]()
    for flight in flights:
        if flight.rows.t[_dense(flight.rows.t, STEPS_S[0])][-1] > 0.0:
            found.append(flight._replace(rows=_thinned(flight.rows, STEPS_S[0], tally)))
        else:
            tally.drop_all(Why.EARLY, flight.rows.row.tolist())
    return found


def _clock_0(flights: list[_Flight]) -> float:
    """The first second from a time on in which an aircraft is in view, between two of its rows."""
    first, last = min(flight.rows.t[0] for flight in flights), max(flight.rows.t[-1] for flight in flights)
    settled = first + min(SETTLED_S, 0.5 * (last - first))
    found = [moment for flight in flights if (moment := _in_view(flight.rows, settled)) < last]
    return float(min(found, default=first))


def _in_view(rows: Course, settled: float) -> float:
    """The first whole second after a time in which x >= 0 on the straight lines between rows; infinity: none."""
    t, x = rows.t, rows.x
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = t[:-1] + (t[1:] - t[:-1]) * x[:-1] / (x[:-1] - x[1:])
    begins = np.where(x[:-1] >= 0.0, t[:-1], np.where(x[1:] > 0.0, crossing, np.inf))
    ends = np.where(x[1:] >= 0.0, t[1:], np.where(x[:-1] > 0.0, crossing, -np.inf))
    seconds = settled + np.maximum(np.ceil(begins - settled - 1e-9), 0.0)
    inside = seconds[seconds < ends]
    return float(inside[0]) if len(inside) else float("inf")


def _dense(t: NDArray[np.float64], step_s: float) -> NDArray[np.bool_]:
    """Rows at least so far apart: a smooth course through two receivers' positions of one moment would swing out."""
    kept, last = np.zeros(len(t), np.bool_), -np.inf
    for i, time in enumerate(t.tolist()):
        if time - last >= step_s:
            kept[i], last = True, time
    return kept


def _thinned(rows: Course, step_s: float, tally: Tally) -> Course:
    kept = _dense(rows.t, step_s)
    tally.drop_all(Why.DENSE, rows.row[~kept].tolist())
    return rows.where(kept)


def _trajectory(rows: Course, *, heights: bool) -> list[list[float]]:
    columns = [rows.t, rows.x, rows.y, *([np.nan_to_num(rows.z)] if heights else [])]
    return [[round(value, 3) for value in row] for row in np.column_stack(columns).tolist()]


def _utc(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _moment(time_s: float) -> str:
    """A time for people: UTC, or seconds of a clock of its own."""
    return _utc(time_s) if 0.0 <= time_s < 2e11 else f"{time_s:g} s"


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
