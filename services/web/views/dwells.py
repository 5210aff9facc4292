"""One dwell of a run as data: all that a page shows of it."""

import gzip
import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic_core import to_json
from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.metrics import queries
from cogradar.services.metrics.scoring.scorer import MessageFields
from cogradar.services.metrics.store import Store
from cogradar.services.skies.place import Place, dwell_s
from cogradar.services.web.run_answers import Question, about_run
from cogradar.services.web.views.radar import Facts, facts
from cogradar.services.web.views.schemas import OF_TARGET
from cogradar.services.web.views.tracks import drawn, lit_for_target, search_of, tracks_of
from cogradar.shared.scoring.columns import FLAG
from cogradar.shared.scoring.scan_rows import Floats, ScanRows, is_blind
from cogradar.shared.signal.array import angle_bin, in_plane
from cogradar.shared.signal.scan import Strongest

SCANS = 64  # newest ones of an acquisition that are read at first, for the largest statistic
AT_ONCE = 10  # dwells that are read together
MAX_DWELLS = 100  # of an answer
KEPT_BYTES = 32_000_000  # of dwells; some 6000 with three targets, 500 with a hundred
PACKED = 1000  # bytes; of shorter answers nothing is gained
_FLAGS = (*(column.name for column in OF_TARGET if column.kind is FLAG), "lost")


class State(NamedTuple):
    """How far a run is."""

    status: str
    reason: str
    k: int  # scans that are durable
    t: int  # clock of the last one


class Encoded:
    """The dwells that were told last, as they were told: what is durable in a journal stays as it is."""

    def __init__(self) -> None:
        self._store: Store | None = None
        self._kept: OrderedDict[tuple[str, int, int], bytes] = OrderedDict()  # by run, times it was forgotten, dwell
        self._bytes = 0
        self._lock = threading.Lock()
        self.searched: tuple[Store, str, int, int, Strongest | None] | None = None  # store, run, times, k: up to scan k

    def get(self, store: Store, key: tuple[str, int, int]) -> bytes | None:
        """A dwell, if it is kept."""
        with self._lock:
            if store is not self._store or key not in self._kept:
                return None
            self._kept.move_to_end(key)
            return self._kept[key]

    def put(self, store: Store, key: tuple[str, int, int], data: bytes) -> None:
        """Keep a dwell. In its place let dwells of another journal go, or dwells that were not asked for longest."""
        with self._lock:
            if store is not self._store:
                self._store, self._kept, self._bytes = store, OrderedDict(), 0
            self._bytes += len(data) - len(self._kept.pop(key, b""))
            self._kept[key] = data
            while self._bytes > KEPT_BYTES:
                self._bytes -= len(self._kept.popitem(last=False)[1])


@about_run("dwells")
def dwells(request: Request, question: Question) -> Response:
    """Some dwells of a run, MAX_DWELLS at most, and where the next ones are; the newest if none is named."""
    name, parameters, store, headers = question
    text, known = parameters.get("dwells"), facts(store, name, is_scored=False)
    first, last = known.dwells(text) if text is not None else (known.newest, known.newest)
    # No further than is asked for: all scores of a long run that was not looked at yet take many seconds.
    store.derive_to(name, min(last, first + MAX_DWELLS - 1) + (known.row["acquisition_scans"] or 0) - 1)
    found = between(store, known, request.app.state.encoded, first, last, MAX_DWELLS)
    after = found[-1][0] + 1 if len(found) == MAX_DWELLS else last + 1
    following = f"{request.url.path}?dwells={after}:{last}" if after <= last else None
    told = b",".join(data for _, data in found)
    body, headers = b'{"dwells":[%b],"next":%b}' % (told, to_json(following)), headers | {"Vary": "Accept-Encoding"}
    if len(body) > PACKED and "gzip" in request.headers.get("accept-encoding", ""):
        # Here, in a thread of its own, and not by a middleware, for which all streams of events would wait.
        body, headers = gzip.compress(body, compresslevel=1, mtime=0), headers | {"Content-Encoding": "gzip"}
    return Response(body, 200, headers, "application/json")


def state(store: Store, run: str) -> State | None:
    """How far a run is, with all of that scored; None if there is none."""
    row = queries.progress(store, run)
    store.derive([run])  # afterwards: what is said to be there has its scores
    return None if row is None else State(**row)


def events(store: Store, encoded: Encoded, run: str, t: int) -> list[tuple[int, bytes]]:
    """The next dwells after dwell t that have scores, at most AT_ONCE: t, and the event, once for all its streams."""
    found = between(store, facts(store, run), encoded, t + 1, 2**31, AT_ONCE)
    return [(t, b"id: %d\ndata: %b\n\n" % (t, data)) for t, data in found]


def between(store: Store, known: Facts, encoded: Encoded, first: int, last: int, most: int) -> list[tuple[int, bytes]]:
    """The first dwells of these that have scores, `most` of them at most: t, and JSON."""
    run = known.row["run"]
    n = store.forgotten[run]
    found = queries.pictures(store, run, first, last, most)
    told = {row["t"]: encoded.get(store, (run, n, row["t"])) for row in found}
    new = [row for row in found if told[row["t"]] is None]
    if new:
        scores: dict[int, list[dict[str, Any]]] = {}
        for score in queries.targets(store, run, new[0]["t"], new[-1]["t"], [column.name for column in OF_TARGET]):
            scores.setdefault(score.pop("t"), []).append(score)
        for row in new:
            t = row["t"]
            told[t] = data = _dwell(store, known, row, scores.get(t, []))
            encoded.put(store, (run, n, t), data)
    return [(t, data) for t, data in told.items() if data is not None]


def acquisition(store: Store, encoded: Encoded, run: str, k: int) -> bytes:
    """The event of scan k, in which targets are still looked for."""
    stored = store.dwell(run, k, ("plan", "scan"))
    plans = [
        {
            "track": plan["target"] + 1,
            "status": plan["status"],
            "bin": plan["best_bin"] if plan["best_bin"] >= 0 else None,
            **dict(zip(("x_hat", "vx_hat", "y_hat", "vy_hat"), plan["estimate"].tolist(), strict=True)),
        }
        for plan in stored["plan"]
    ]
    rows = facts(store, run).scan_rows
    cells = _cells(rows, stored["scan"][0] if stored["scan"] else None)
    first, strongest, n = max(k + 1 - SCANS, 0), None, store.forgotten[run]
    if encoded.searched is not None and encoded.searched[:3] == (store, run, n) and encoded.searched[3] <= k:
        first, strongest = max(first, encoded.searched[3] + 1), encoded.searched[4]
    for scan in queries.messages(store, run, "scan", range(first, k + 1)).values():
        strongest = Strongest.of(rows.read(scan), strongest)
    encoded.searched = (store, run, n, k, strongest)
    found = {"run": run, "t": 0, "k": k, "scans": k + 1, "tracks": plans, "cells": cells}
    data = to_json(found | {"strongest": None if strongest is None else str(strongest)})
    return b"event: acquisition\nid: 0\ndata: %b\n\n" % data


def _dwell(store: Store, known: Facts, picture: dict[str, Any], rows: list[dict[str, Any]]) -> bytes:
    run, k, t = known.row["run"], picture["k"], picture["t"]
    stored = store.dwell(run, k, ("plan", "scan"))
    waveforms = store.dwell(run, picture["waveform_k"], ("waveform",))["waveform"]
    scan = stored["scan"][0] if stored["scan"] else None
    cells, statistics = _cells(known.scan_rows, scan), _statistics(known.scan_rows, rows, scan)
    sent = waveforms[0] if waveforms else None
    everywhere = known.radar.array.power if picture["waveform_k"] < 0 else None  # before the first waveform
    is_unknown = scan is not None and "roster" in scan
    tracks = tracks_of(known, scan, sent, stored["plan"], rows) if scan is not None and is_unknown else None
    covariances = {plan["target"] + 1: plan["covariance"] for plan in stored["plan"]}
    shown = [
        _target(known, row, statistic, scan, covariances.get(row["track"]))
        for row, statistic in zip(rows, statistics, strict=True)
    ]
    _add_positions(known, shown, ("", "_hat"))
    _add_positions(known, tracks or [], ("_hat",))
    data = {
        "run": run,
        "t": t,
        "k": k,
        "utc_s": _utc_s(known, scan, t),
        "threshold": known.threshold,
        "stale": picture["waveform_k"] != k - 1,
        "isotropic": sent["isotropic"] if sent is not None else everywhere,
        "targets": shown,
        "tracks": tracks,
        "search": search_of(known, scan) if scan is not None and is_unknown else None,
        "cells": cells,
        "orders": _obeyed(sent),
        "false_alarms": _false_alarms(known, rows, scan),
        "picture": {name: value for name, value in picture.items() if name not in {"k", "t", "waveform_k"}},
    }
    return to_json(data, inf_nan_mode="null")


def _utc_s(known: Facts, scan: MessageFields | None, t: int) -> float | None:
    """When a dwell was: as its front end says, else as the site says when the run begins; None: neither does."""
    if scan is not None and (told_s := scan.get("utc_s")) is not None:
        return float(told_s)
    return dwell_s(known.site, t, known.radar.motion.dt_s) if known.site is not None else None


def _obeyed(sent: MessageFields | None) -> list[int]:
    """Numbers of the commands that a waveform obeys."""
    found = None if sent is None else sent.get("orders")
    return [] if found is None else np.asarray(found).tolist()


def _add_positions(known: Facts, rows: list[dict[str, Any]], suffixes: Sequence[str]) -> None:
    """Say where on the earth x and y with these suffixes are: null without a site, or if they are unknown."""
    for suffix in suffixes:
        names = f"latitude{suffix}_deg", f"longitude{suffix}_deg"
        x, y = (np.array([row[f"{axis}{suffix}"] for row in rows], np.float64) for axis in "xy")
        found = Place.of(known.site).positions(x, y)[:2] if known.site is not None else (x * np.nan, y * np.nan)
        for row, *values in zip(rows, *(column.tolist() for column in found), strict=True):
            row.update((name, None if math.isnan(value) else value) for name, value in zip(names, values, strict=True))


def _target(
    known: Facts, row: dict[str, Any], statistic: float | None, scan: MessageFields | None, covariance: Any
) -> dict[str, Any]:
    flags = {name: None if row[name] is None else bool(row[name]) for name in _FLAGS}
    is_known = row["x"] is not None and row["x_hat"] is not None
    return {
        **row,
        **flags,
        **drawn(known, *lit_for_target(row, scan, known.centres)),
        "statistic": statistic,
        "error_km": math.hypot(row["x"] - row["x_hat"], row["y"] - row["y_hat"]) if is_known else None,
        "covariance": None if covariance is None else covariance[[0, 0, 2], [0, 2, 2]].tolist(),
    }


def _statistics(scan_rows: ScanRows, rows: list[dict[str, Any]], scan: MessageFields | None) -> list[float | None]:
    """The largest statistic of a cell that holds each target (without truth: of its beam); None: none is known."""
    if scan is None:
        return [None] * len(rows)
    tracks = [None if row["track"] is None else row["track"] - 1 for row in rows]
    found = scan_rows.rows_about(scan, _states(rows), tracks).tolist()
    return [None if at < 0 else float(scan["statistic"][at]) for at in found]


def _states(rows: list[dict[str, Any]]) -> Floats:
    """States where the array measures targets, (M, 4); NaN where they are not known."""
    found = np.array([[row[name] for name in ("x", "vx", "y", "vy", "z")] for row in rows], np.float64).reshape(-1, 5)
    return in_plane(found[:, :4], found[:, 4])


def _cells(scan_rows: ScanRows, scan: MessageFields | None) -> dict[str, list[Any]] | None:
    """The cells that were tested; None if the scan is not stored."""
    if scan is None:
        return None
    is_over = scan_rows.read(scan).is_over()
    return {
        "bin": scan["bins"].tolist(),
        "statistic": scan["statistic"].tolist(),
        "detected": is_over.tolist(),
        "blind": is_blind(scan).tolist(),
        "unmeasured": angle_bin(scan.get("unmeasured", ()), scan_rows.response.n_bin).tolist(),
        "fault": scan.get("fault"),
    }


def _false_alarms(known: Facts, rows: list[dict[str, Any]], scan: MessageFields | None) -> list[int] | None:
    """The bins of detections where no target is; None if that is not known."""
    if scan is None or not known.row["has_truth"]:
        return None
    there = [row for row in rows if row["x"] is not None]
    seen = known.scan_rows.read(scan)
    is_held = known.scan_rows.holds(seen, _states(there)).any(axis=0)
    found: list[int] = seen.bins[seen.is_over() & ~is_held].tolist()
    return found
