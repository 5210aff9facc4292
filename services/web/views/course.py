"""The course of one target, or of one track: what a chart over time shows, in at most MAX_POINTS points.

P_D so far and the floor under the error depend on every dwell before. They are worked out once for each target that
somebody looks at, and extended as the run goes on.
"""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.metrics import queries
from cogradar.services.metrics.store import Store
from cogradar.services.web.parameters import one_of
from cogradar.services.web.problem_documents import missing
from cogradar.services.web.run_answers import Question, about_run
from cogradar.services.web.views.column_response import columns
from cogradar.services.web.views.radar import Facts, facts
from cogradar.services.web.views.tracks import track_of
from cogradar.shared.scoring.bounds import RangeFloor, amplitude_information
from cogradar.shared.scoring.errors import wilson_interval
from cogradar.shared.signal.array import in_plane
from cogradar.shared.world.disturbance import power_spectrum

MAX_POINTS = 500
KEPT_DWELLS = 1_000_000  # of all courses together, about 16 MB
AT_ONCE = 4096  # dwells that are read together, some 20 ms
SETTLED = 0.95  # a prior ten times as wide changes the floor by less than the rest
OF_BOTH = ("t", "share", "statistic", "threshold", "detected", "error_km", "late")
OF_TARGET: tuple[str, ...] = ("snr_db", "p_d", "p_d_low", "p_d_high", "floor_km", "stale")
OF_TRACK: tuple[str, ...] = ("existence", "confirmed", "follows")
_U = np.linspace(0.0, 1.0, 2048)  # u / (1 + u)
Floats = NDArray[np.float64]


@about_run("target", "track", "dwells")
def course(request: Request, question: Question) -> Response:
    """The course of a target from the oldest dwell that is kept on, or of a track from its first to its last."""
    name, parameters, store, headers = question
    kind = one_of(parameters, "target", "track")
    known = facts(store, name)
    first, last = known.dwells(parameters.get("dwells", ":"))
    if kind == "target":
        number = known.target(parameters["target"])
        every, ts = _thinned(range(first, last + 1))
        names, rows = OF_TARGET, _of_target(store, known, request.app.state.courses, number, ts)
    else:
        number = known.track(parameters["track"])
        lived = queries.track_dwells(store, name, number, first, last)
        if not lived:
            raise missing(f"run = {name!r}: no track {number} in dwells {first} to {last}")
        every, dwells = _thinned(lived)
        names, rows = OF_TRACK, _of_track(store, known, number, dwells)
    head = {"run": name, "target": None, "track": None, "every": every, **dict.fromkeys((*OF_TARGET, *OF_TRACK))}
    return columns(head | {kind: number}, (*OF_BOTH, *names), rows, headers)


def _thinned(dwells: Sequence[Any]) -> tuple[int, Sequence[Any]]:
    """Every n-th dwell and the newest one, MAX_POINTS at most; n."""
    every = max(1, -(-len(dwells) // MAX_POINTS))
    return every, dwells[::-1][::every][::-1]


def _of_target(store: Store, known: Facts, courses: "Courses", target: int, ts: Sequence[int]) -> list[dict[str, Any]]:
    rows = queries.target_course(store, known.row["run"], target, list(ts))
    for row in rows:
        row["threshold"] = known.threshold
        row.update({name: None if row[name] is None else bool(row[name]) for name in ("detected", "late", "stale")})
    _add_statistics(store, known, rows)
    of_course: list[tuple[float | None, ...]] = [(None,) * 4] * len(rows)
    if rows and known.row["has_truth"]:
        of_course = courses.of(store, known, target, ts[-1]).at([row["t"] for row in rows])
    for row, values in zip(rows, of_course, strict=True):
        row.update(zip(("p_d", "p_d_low", "p_d_high", "floor_km"), values, strict=True))
    return rows


def _of_track(store: Store, known: Facts, track: int, dwells: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The track in these dwells, as far as their scans are stored."""
    followed = queries.followed_by(store, known.row["run"], track, [dwell["t"] for dwell in dwells])
    return [row for some in queries.pieces(dwells) for row in _of_dwells(store, known, track, some, followed)]


def _of_dwells(
    store: Store, known: Facts, track: int, dwells: Sequence[dict[str, Any]], followed: dict[int, Any]
) -> list[dict[str, Any]]:
    run, ks = known.row["run"], [dwell["k"] for dwell in dwells]
    waveforms = queries.messages(store, run, "waveform", [dwell["waveform_k"] for dwell in dwells])
    scans, plans = queries.messages(store, run, "scan", ks), queries.messages(store, run, "plan", ks, track)
    found = []
    for k, t, sent_k in ((dwell["k"], dwell["t"], dwell["waveform_k"]) for dwell in dwells):
        if k in scans:
            after = plans[k], followed.get(t)
            one = track_of(known, scans[k], waveforms.get(sent_k), track - 1, after)
            found.append({"t": t, "follows": one["target"], **one})
    return found


def _add_statistics(store: Store, known: Facts, rows: list[dict[str, Any]]) -> None:
    """The statistic of each row's cell; None where its scan is not stored, or did not test it."""
    for some in queries.pieces(rows):
        scans = queries.messages(store, known.row["run"], "scan", [row["k"] for row in some])
        for row in some:
            _add_statistic(known, row, scans.get(row["k"]))


def _add_statistic(known: Facts, row: dict[str, Any], scan: dict[str, Any] | None) -> None:
    row["statistic"], z = None, row.pop("z")
    if scan is not None:
        state = in_plane(np.array([[row["x"], 0.0, row["y"], 0.0]], np.float64), np.array([z], np.float64))
        track = None if row["track"] is None else row["track"] - 1
        (at,) = known.scan_rows.rows_about(scan, state, [track]).tolist()
        if at >= 0:
            row.update(statistic=float(scan["statistic"][at]), threshold=float(known.scan_rows.read(scan).limits[at]))


class Courses:
    """The courses that were looked at last."""

    def __init__(self) -> None:
        self._courses: OrderedDict[tuple[str, int], tuple[tuple[Store, int], Course]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, store: Store, known: Facts, target: int, last: int) -> "Course":
        """The course of a target up to this dwell, at least."""
        run = known.row["run"]
        state = (store, store.forgotten[run])  # another journal, or an older state of it
        with self._lock:
            of_state, course = self._courses.get((run, target), (None, None))
            if course is None or of_state != state or course.is_outworn(known.oldest):
                course = Course(known)
            self._courses[run, target] = state, course
            self._courses.move_to_end((run, target))
        with course.lock:  # none is extended twice, and others are meanwhile
            course.extend(store, target, last)
        with self._lock:
            while len(self._courses) > 1 and sum(len(course) for _, course in self._courses.values()) > KEPT_DWELLS:
                self._courses.popitem(last=False)
        return course


class Course:
    """Of a target, by dwell: how often it was detected so far, and the floor under the error of its range."""

    def __init__(self, known: Facts) -> None:
        self.lock = threading.Lock()  # held while it is extended
        self._known = known
        self._before = known.oldest - 1  # dwells that it has nothing of
        self._hits, self._n, self._floor = np.zeros(1, np.int32), np.zeros(1, np.int32), np.full(1, np.nan)
        self._is_gone = False  # there is no floor any more
        self._floors: list[RangeFloor] = []  # of the prior, and of a wider one until that makes no difference

    def __len__(self) -> int:
        """Dwells that it has."""
        return len(self._hits) - 1

    @property
    def last(self) -> int:
        """The newest dwell that it reaches to."""
        return self._before + len(self._hits) - 1

    def is_outworn(self, oldest: int) -> bool:
        """Whether most of what it has is of dwells that were cut."""
        return 2 * (oldest - 1 - self._before) > len(self._hits)

    def at(self, ts: list[int]) -> list[tuple[float | None, ...]]:
        """P_D up to each of these dwells, both ends of Wilson's interval, and the floor."""
        at = [max(t - self._before, 0) for t in ts]  # 0: cut by now
        hits, n = self._hits[at], self._n[at]
        p_d = np.stack((hits / np.maximum(n, 1), *wilson_interval(hits, n)))
        p_d[:, n == 0] = np.nan  # it has not been there yet
        return list(zip(*p_d.tolist(), self._floor[at].tolist(), strict=True))

    def extend(self, store: Store, target: int, last: int) -> None:
        """Go on to this dwell."""
        run = self._known.row["run"]
        names = ("t", "detected", "x", "y", "true_bin", "snr_db", "signature_power")
        while self.last < last:
            first = self.last + 1
            ts = range(first, min(last, self.last + AT_ONCE) + 1)
            found = queries.target_numbers(store, run, target, ts, names)
            detected, there, floor = np.zeros(len(ts), np.int32), np.zeros(len(ts), np.int32), np.full(len(ts), np.nan)
            if found.size:
                found = found[:, ~np.isnan(found[1])]  # what there is of the target
                at = found[0].astype(np.int64) - first
                detected[at], there[at] = found[1], 1
                floor = self._floor_of(found[2:], at, len(ts))
            self._hits = np.append(self._hits, self._hits[-1] + np.cumsum(detected, dtype=np.int32))
            self._n = np.append(self._n, self._n[-1] + np.cumsum(there, dtype=np.int32))
            self._floor = np.append(self._floor, floor)

    def _floor_of(self, known: Floats, at: NDArray[np.int64], n: int) -> Floats:
        """The floor after each of n dwells; NaN while it depends on the prior.

        known : (5, m) x, y, true_bin, snr_db, signature_power of the dwells `at`, (m,)
        """
        radar, world = self._known.radar, self._known.world
        # The floor is of amplitudes, and of targets that are there from the start on.
        is_late = not self._floors and (not at.size or at[0] > 0)
        if world is None or radar.receiver.range_cell_km > 0.0 or is_late or self._is_gone:
            self._is_gone = True
            return np.full(n, np.nan)
        x, y, bins, snr_db, lit = known
        range_km, spectrum = np.hypot(x, y), power_spectrum(world.disturbance.model, self._known.centres)
        snr = 10.0 ** (snr_db / 10.0) / spectrum[bins.astype(np.int64)]
        information = np.zeros(n)  # nothing of a dwell that is missing
        information[at] = _range_information(range_km, np.sqrt(snr * lit))
        if not self._floors:
            isotropic = radar.array.n_rx * radar.array.power  # ||v||^2 of the orthogonal waveform
            acquired = float(_range_information(range_km[:1], np.sqrt(snr[:1] * isotropic))[0])
            sigma = radar.acquisition.v_max_km_s / np.sqrt(3.0)  # of the uniform prior
            motion = radar.motion.dt_s, world.motion.sigma_s_km_s2
            initial = self._known.row["acquisition_scans"] * acquired
            self._floors = [RangeFloor(initial, width * sigma, *motion) for width in (1.0, 10.0)]
        found = np.full(n, np.nan)
        for i, value in enumerate(information.tolist()):
            errors = [floor.advance(value)[0] for floor in self._floors]
            if errors[0] > SETTLED * errors[-1]:
                found[i] = errors[0]
                del self._floors[1:]
        return found


def _range_information(range_km: Floats, u: Floats) -> Floats:
    """`range_information` of scoring.bounds, looked up in a table: six digits of it in a hundredth of the time."""
    root = np.interp(u / (1.0 + u), _U, _table())
    return np.asarray((root * 2.0 * u / range_km) ** 2)


@cache
def _table() -> Floats:
    """Square root of the information about u, which is about linear in u / (1 + u), at _U."""
    u = np.minimum(_U / np.maximum(1.0 - _U, 1e-6), 1e6)
    return np.sqrt(amplitude_information(u))
