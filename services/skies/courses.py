"""Which positions of an aircraft are believed: repeats, jumps, second clocks and shared identifiers are told apart.

The gate looks both ways. A row is believed if it belongs to the longest chain of rows between which an aircraft can
fly, and if it is not far from the line between its neighbours of that chain. Rows are in the order of their times; an
array of a course has one entry for each.
"""

from collections.abc import Iterator
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.skies.readers.report import Report, Tally, Why

Floats = NDArray[np.float64]

GAP_S = 120.0  # without a position: another flight
MOST_KM_S = 1.0  # no aircraft is faster
TIMES_FASTER, FASTER_KM_S = 2.0, 0.12  # than it is around a row, and by so much more, no aircraft becomes at once
AROUND = 5  # rows before and after that say how fast it is around
FEWEST = 6  # rows from which that is taken
LATE_S = 1.0  # that a time may be wrong by: many files have whole seconds
NEAR_KM = 0.1  # to which positions are known
TURN_KM_S2 = 0.05  # 5 g
OFF_KM = 0.3  # from the line between its neighbours, of a straight flight with times in whole seconds
ALONE = 3  # rows at each end of a piece of a course that may be wrong without the rest of it
LINKS = 128  # pieces of a course between which links are tried
OWN_ROWS, OWN_S = 6, 20.0  # a second aircraft under one identifier has at least so many rows in so long a time
MOST_SHARED = 8  # aircraft under one identifier
STOPPED_KM_S, BRAKES_KM_S2, HOVERS_KM_S = 0.015, 0.003, 0.09  # how an aircraft comes to rest
RESTS_KM_S = 0.03  # an aircraft that says to be faster is not at rest
CLOCKS_S = 1.2  # by which rows must be ahead or behind their course, half of them more, to be of two clocks
CLOCK_ROWS = 12
MOVES_KM_S = 0.05


class Course(NamedTuple):
    """Rows of one aircraft."""

    row: NDArray[np.int64]
    t: Floats
    x: Floats  # km
    y: Floats  # km
    z: Floats  # km; NaN: not known

    def where(self, kept: NDArray[np.bool_] | NDArray[np.int64]) -> "Course":
        return Course(self.row[kept], self.t[kept], self.x[kept], self.y[kept], self.z[kept])


def without_repeats(reports: list[Report], tally: Tally) -> list[Report]:
    """Reports of an aircraft without those that say again what an earlier one said. Rest is not silence.

    Archives repeat the last position of an aircraft that has gone silent, and merged feeds tell a position twice. Such
    a row is one at the same place as an earlier one, while the aircraft moves. A helicopter that stands still tells its
    place again, too: it comes to rest and leaves as slowly as aircraft can.
    """
    reports = sorted(reports, key=lambda one: (one.time, one.row))
    kept, last_at = list[Report](), dict[tuple[float, float], float]()
    said = set[tuple[float, float, float]]()
    for one in reports:
        at = one.latitude, one.longitude
        if (one.time, *at) in said:
            tally.drop(Why.DUPLICATE, one.row)
            continue
        said.add((one.time, *at))
        if kept and one.time - last_at.get(at, -np.inf) <= GAP_S and _apart_km(kept[-1], one) > NEAR_KM:
            tally.drop(Why.REPEATED, one.row)
            continue
        last_at[at] = one.time
        kept.append(one)
    found = list[Report]()
    for i, j in _standing(kept):
        found.append(kept[i])
        repeats = kept[i + 1 : j]
        if repeats and not _rests(kept, i, j):
            tally.drop_all(Why.REPEATED, (one.row for one in repeats))
        else:
            found += repeats
    return found


def _standing(reports: list[Report]) -> Iterator[tuple[int, int]]:
    """First and after the last of each run of reports at one place."""
    begin = 0
    for i in range(1, len(reports) + 1):
        if i == len(reports) or reports[i][4:6] != reports[begin][4:6]:
            yield begin, i
            begin = i


def _apart_km(one: Report, other: Report) -> float:
    """Distance of two near places."""
    north = one.latitude - other.latitude
    east = (one.longitude - other.longitude + 180.0) % 360.0 - 180.0
    return 111.0 * hypot(north, east * float(np.cos(np.radians(one.latitude))))


def _rests(reports: list[Report], i: int, j: int) -> bool:
    """Whether reports i .. j - 1, at one place, are of an aircraft at rest."""
    if any((one.speed_km_s or 0.0) > RESTS_KM_S for one in reports[i + 1 : j]):
        return False
    ends = [(a, b) for a, b in ((i - 1, i), (j - 1, j)) if a >= 0 and b < len(reports)]
    for a, b in ends:
        dt = reports[b].time - reports[a].time
        speed = _apart_km(reports[a], reports[b]) / max(dt, 1e-3)
        if dt <= GAP_S and speed > min(HOVERS_KM_S, STOPPED_KM_S + BRAKES_KM_S2 * dt):
            return False
    return True


def believed(course: Course, tally: Tally) -> list[Course]:
    """The courses in the rows of one identifier, the longest first: several if aircraft share it."""
    found, left = list[Course](), np.arange(len(course.t))
    while len(left) and len(found) < MOST_SHARED:
        chain = left[_longest_chain(course.where(left))]
        if found and not _is_aircraft(course.t[chain]):
            break
        found.append(course.where(chain))
        left = np.setdiff1d(left, chain)
    tally.drop_all(Why.OUTLIER, course.row[left].tolist())
    if len(found) > 1:
        tally.note(f"{len(found)} aircraft share an identifier (row {course.row[0]} and others): each is kept")
    return [smooth for one in found if len((smooth := _smooth(_one_clock(one, tally), tally)).t)]


def _is_aircraft(times: Floats) -> bool:
    return len(times) >= OWN_ROWS and float(times[-1] - times[0]) >= OWN_S


def _longest_chain(course: Course) -> NDArray[np.int64]:
    """Indices of the most rows between which the aircraft can fly."""
    n = len(course.t)
    limits = _fastest(course)
    pieces = np.flatnonzero(_strain(course, np.arange(n - 1), np.arange(1, n), limits) > 1.0) + 1
    if not len(pieces):
        return np.arange(n)
    # A wrong row after a silence breaks the link to the next row only: rows at the ends of a piece are pieces, too.
    ends_too = (pieces[:, np.newaxis] + np.arange(-ALONE, ALONE + 1)).ravel()
    begins = np.unique(np.concatenate(([0], ends_too[(ends_too > 0) & (ends_too < n)])))
    ends = np.append(begins[1:], n)
    best, before = (ends - begins).astype(float), np.full(len(begins), -1)
    for k in range(1, len(begins)):
        earlier = np.arange(max(k - LINKS, 0), k)
        strain = _strain(course, ends[earlier] - 1, np.full(len(earlier), begins[k]), limits)
        # Of chains with as many rows the one that is flown most easily.
        gain = np.where(strain <= 1.0, best[earlier] - 1e-3 * strain, 0.0)
        if gain.max() > 0.0:
            before[k] = earlier[gain.argmax()]
            best[k] += gain.max()
    k, chain = int(best.argmax()), list[NDArray[np.int64]]()
    while k >= 0:
        chain.append(np.arange(begins[k], ends[k]))
        k = int(before[k])
    return np.concatenate(chain[::-1])


def _fastest(course: Course) -> Floats:
    """The speed up to which each row is believed, km/s: by how fast the aircraft is around it."""
    speeds = np.hypot(np.diff(course.x), np.diff(course.y)) / np.maximum(np.diff(course.t), LATE_S)
    if len(course.t) < FEWEST:
        return np.full(len(course.t), MOST_KM_S)
    padded = np.pad(speeds, AROUND, mode="reflect" if len(speeds) > AROUND else "edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1), axis=1)
    limits = np.minimum(TIMES_FASTER * usual + FASTER_KM_S, MOST_KM_S)
    return np.asarray(np.maximum(np.append(limits, limits[-1]), np.append(limits[0], limits)))


def _strain(course: Course, i: NDArray[np.int64], j: NDArray[np.int64], limits: Floats) -> Floats:
    """How far an aircraft would fly from rows i to rows j, after them, in units of what it can at most."""
    km = np.hypot(course.x[j] - course.x[i], course.y[j] - course.y[i])
    dt = course.t[j] - course.t[i]
    limit = np.where(dt > GAP_S, MOST_KM_S, np.maximum(limits[i], limits[j]))
    return np.asarray(km / (limit * (dt + LATE_S) + NEAR_KM))


def _beside(course: Course, apart: int) -> tuple[Floats, Floats, Floats]:
    """How far the inner rows are off the line between rows before and after, and by how much times differ there.

    Returns x and y of the inner rows minus the line's, (n - 2 apart, 2), and the product of both time steps.
    """
    t, at = course.t, np.column_stack((course.x, course.y))
    first, mid, last = slice(0, len(t) - 2 * apart), slice(apart, len(t) - apart), slice(2 * apart, len(t))
    span = np.maximum(t[last] - t[first], 1e-6)
    part = ((t[mid] - t[first]) / span)[:, np.newaxis]
    off = at[mid] - (1.0 - part) * at[first] - part * at[last]
    return off, (t[mid] - t[first]) * (t[last] - t[mid]), span


def _smooth(course: Course, tally: Tally) -> Course:
    """The course without rows that are far off the line between their neighbours, the worst ones first."""
    kept = course
    while len(kept.t) >= 4:
        off, steps, span = _beside(kept, 1)
        km = np.hypot(*off.T)
        wrong = (km > OFF_KM + 0.5 * TURN_KM_S2 * steps) & (span <= 2.0 * GAP_S)
        if not wrong.any():
            break
        worst = np.concatenate(([0.0], np.where(wrong, km + _wider(kept), 0.0), [0.0]))
        # Of a wrong first row the second is off the line; of a wrong second row the third is, as well.
        for end, inner, next_ in ((0, 1, 2), (-1, -2, -3)):
            if worst[inner] and not worst[next_]:
                worst[end], worst[inner] = worst[inner], 0.0
        around = np.maximum(np.append(worst[1:], 0.0), np.append(0.0, worst[:-1]))
        gone = (worst > 0.0) & (worst >= around)
        gone[1:] &= ~gone[:-1]
        tally.drop_all(Why.OUTLIER, kept.row[gone].tolist())
        kept = kept.where(~gone)
    return kept


def _wider(course: Course) -> Floats:
    """How far the inner rows are off the line between the second row before and the second row after; 0 at the ends."""
    found = np.zeros(len(course.t) - 2)
    if len(course.t) > 4:
        off, _, _ = _beside(course, 2)
        found[1:-1] = np.hypot(*off.T)
    return found


def _one_clock(course: Course, tally: Tally) -> Course:
    """The course without the rows of a second clock: those that are seconds ahead of, or behind, the others' course.

    Where feeds with different clocks were merged, an aircraft jumps back and forth along its course.
    """
    if len(course.t) < CLOCK_ROWS:
        return course
    lags = _lags(course)
    ahead = np.nan_to_num(lags) > 0.0
    share = float(ahead.mean())
    if _usual(lags) < 0.5 * CLOCKS_S or not 0.1 < share < 0.9:
        return course
    keep = ahead if share >= 0.5 else ~ahead
    apart = float(np.nanmedian(lags[ahead]) - np.nanmedian(lags[~ahead]))
    left = course.where(keep)
    if apart < CLOCKS_S or _usual(_lags(left)) > 0.5 * _usual(lags):  # it turns, and no straight line fits
        return course
    tally.drop_all(Why.CLOCK, course.row[~keep].tolist())
    tally.note(f"feeds were merged whose clocks differ by about {apart:.0f} s: one clock's rows are dropped")
    return left


def _usual(lags: Floats) -> float:
    known = np.abs(lags[np.isfinite(lags)])
    return float(np.median(known)) if len(known) else 0.0


def _lags(course: Course) -> Floats:
    """By how many seconds rows are ahead of a straight line through the rows around them; NaN where it stands."""
    t, at = course.t, np.column_stack((course.x, course.y))
    n, wide = len(t), 2 * AROUND + 1
    if n < wide:
        return np.full(n, np.nan)
    begin = np.clip(np.arange(n) - AROUND, 0, n - wide)
    window = begin[:, np.newaxis] + np.arange(wide)
    dt = t[window] - t[:, np.newaxis]
    mean_t = dt.mean(axis=1, keepdims=True)
    mean_at = at[window].mean(axis=1)
    spread = ((dt - mean_t) ** 2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        velocity = ((dt - mean_t)[..., np.newaxis] * (at[window] - mean_at[:, np.newaxis])).sum(axis=1)
        velocity /= spread[:, np.newaxis]
        off = at - (mean_at - mean_t * velocity)
        speed2 = (velocity**2).sum(axis=1)
        lags = (off * velocity).sum(axis=1) / speed2
    far = np.abs(dt).max(axis=1) > GAP_S
    return np.where((speed2 > MOVES_KM_S**2) & ~far, lags, np.nan)
