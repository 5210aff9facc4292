"""What views of runs are made of: every SELECT of theirs, by name. `derive` first, where scores are wanted."""

import json
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.store.tables import ALL_ROWS
from cogradar.shared.wire.codec import fields

Row = dict[str, Any]
_PICTURE = (
    "targets, tracks, followed, swaps, sqrt(localisation_km2 + missed_km2 + false_km2) AS gospa_km,"
    " sqrt(localisation_km2) AS gospa_localisation_km, sqrt(missed_km2) AS gospa_missed_km,"
    " sqrt(false_km2) AS gospa_false_km"
)
AT_ONCE = 512  # messages that are sought with one statement
PIECE = 16  # dwells whose messages are held at a time: with 100 antennas a dwell has 0.2 MB
# Each dwell is sought, however many targets there are between them.
_AT_DWELLS = "FROM json_each(?) AS dwell CROSS JOIN"


def run_row(store: Store, run: str) -> Row | None:
    """The row of a run, with its scenario as JSON."""
    return store.whole_row(run)


def progress(store: Store, run: str) -> Row | None:
    """Status and reason of a run; k and t, up to which it is durable."""
    query = "SELECT status, reason, acknowledged_k AS k, acknowledged_t AS t FROM run WHERE run = ?"
    return _first(store.read(query, [run]))


def running(store: Store, most: int) -> list[Row]:
    """The newest runs that go on: run, n_track, is_unknown, and their newest durable scan."""
    rows = store.read(
        "SELECT run, n_track, n_track IS NULL AS is_unknown, acknowledged_k - 1 AS k"
        " FROM run WHERE status = 'running' ORDER BY place DESC LIMIT ?",
        [most],
    )
    for row in rows:
        scans = stored(store, row["run"], "scan", [row.pop("k")], 0, "k, payload")
        row["scan"] = scans[0]["payload"] if scans else None
    return rows


def pictures(store: Store, run: str, first: int, last: int, most: int = ALL_ROWS) -> list[Row]:
    """k, t, dwell whose waveform was radiated, and the air picture of dwells that have scores."""
    return store.scored(
        f"SELECT k, t, waveform_k, {_PICTURE} FROM picture WHERE run = ? AND t BETWEEN ? AND ? ORDER BY t LIMIT ?",
        [run, first, last, most],
    )


def ends(store: Store, run: str) -> tuple[int, int] | None:
    """The first and the last dwell with scores; None without any."""
    row = _first(store.scored("SELECT MIN(t) AS a, MAX(t) AS b FROM picture WHERE run = ? HAVING MAX(t)", [run]))
    return None if row is None else (row["a"], row["b"])


def targets(store: Store, run: str, first: int, last: int, columns: Sequence[str]) -> list[Row]:
    """t, these columns and `lost` of all targets, in the order of dwell and target."""
    return store.scored(
        f"SELECT t, {', '.join(columns)}, {sums.IS_LOST} AS lost FROM {store.table(run)}"
        " WHERE run = ? AND t BETWEEN ? AND ? ORDER BY t, target",
        [run, first, last],
    )


def track_of(store: Store, run: str, target: int, t: int) -> int | None:
    """The track that follows a target in a dwell."""
    query = f"SELECT track FROM {store.table(run)} WHERE run = ? AND t = ? AND target = ?"
    row = _first(store.scored(query, [run, t, target]))
    return None if row is None else row["track"]


def target_course(store: Store, run: str, target: int, ts: Sequence[int]) -> list[Row]:
    """A target and its track in these dwells, as far as there are scores."""
    return store.scored(
        "SELECT k, t, track, share, snr_db, detected, late, stale, x, y, z,"
        f" sqrt((x - x_hat) * (x - x_hat) + (y - y_hat) * (y - y_hat)) AS error_km {_AT_DWELLS} {store.table(run)} AS s"
        " ON s.run = ? AND s.t = dwell.value AND s.target = ?",
        [json.dumps(ts), run, target],
    )


def target_numbers(
    store: Store, run: str, target: int, ts: Sequence[int], columns: Sequence[str]
) -> NDArray[np.float64]:
    """These columns of a target's scores, (columns, dwells); NaN: NULL."""
    return store.numbers(
        f"SELECT {', '.join(columns)} {_AT_DWELLS} {store.table(run)} AS s"
        " ON s.run = ? AND s.t = dwell.value AND s.target = ?",
        [json.dumps(list(ts)), run, target],
    )


def followed_by(store: Store, run: str, track: int, ts: Sequence[int]) -> dict[int, Row]:
    """The target that a track follows, by dwell t."""
    rows = store.scored(
        f"SELECT t, target, x, y {_AT_DWELLS} {store.table(run)} AS s"
        " ON s.run = ? AND s.t = dwell.value AND s.track = ?",
        [json.dumps(ts), run, track],
    )
    return {row["t"]: row for row in rows}


def track_dwells(store: Store, run: str, track: int, first: int, last: int) -> list[Row]:
    """k, t and dwell whose waveform was radiated, of the dwells in which there is a plan of a track."""
    dwells = store.scored(
        "SELECT k, t, waveform_k FROM picture WHERE run = ? AND t BETWEEN ? AND ? ORDER BY t", [run, first, last]
    )
    planned = stored(store, run, "plan", [row["k"] for row in dwells], track, "k")
    there = {row["k"] for row in planned}
    return [row for row in dwells if row["k"] in there]


def pieces(rows: Sequence[Row]) -> Iterator[Sequence[Row]]:
    """Rows of dwells, in lots of PIECE."""
    return (rows[at : at + PIECE] for at in range(0, len(rows), PIECE))


def messages(store: Store, run: str, topic: str, ks: Sequence[int], item: int = 0) -> dict[int, Any]:
    """Fields of the messages of these dwells that are stored, by dwell k."""
    return {row["k"]: fields(row["payload"]) for row in stored(store, run, topic, ks, item, "k, payload")}


def stored(store: Store, run: str, topic: str, ks: Sequence[int], item: int, columns: str) -> list[Row]:
    """Columns of the messages of these dwells that are stored: each is sought, whatever there is between them."""
    found = list[Row]()
    for at in range(0, len(ks), AT_ONCE):
        some = ks[at : at + AT_ONCE]
        which = f"run = ? AND topic = ? AND item = ? AND k IN ({_marks(len(some))})"
        values = [run, topic, item, *some]
        if columns == "k":
            found += store.read(f"SELECT k FROM message WHERE {which} ORDER BY k", values)
        else:
            found += store.stored("message", f"WHERE {which} ORDER BY k", values)
    return found


@cache
def _marks(n: int) -> str:
    return ",".join("?" * n)


def snapshot(store: Store, run: str, track: int, first: int, last: int) -> bytes | None:
    """The snapshot of a track, if it is of one of these dwells k."""
    which = "WHERE run = ? AND target = ? AND k BETWEEN ? AND ?"
    row = _first(store.stored("snapshot", which, [run, track, first, last]))
    return None if row is None else row["payload"]


def timeline(store: Store, run: str, width: int) -> list[Row]:
    """A run of a known number of tracks in buckets of dwells (`sums.timeline`)."""
    rows = store.summed(*sums.timeline(run, store.table(run), width))
    if rows:  # its newest bucket may be short: what is lost now is what the newest dwell says
        (now,) = store.scored(*sums.lost(run, store.table(run), rows[-1]["last"]))
        rows[-1] |= now
    return [row | {"missed": None, "swaps": None, "gospa_km": None} for row in rows]


def picture_timeline(store: Store, run: str, width: int) -> list[Row]:
    """A run of an unknown number of tracks in buckets of dwells: all tracks and targets together."""
    return store.scored(
        "SELECT MIN(t) AS first, MAX(t) AS last, NULL AS detected, NULL AS lost,"
        " SUM(late) AS late, SUM(waveform_k < k - 1) AS stale,"
        " sqrt(SUM(localisation_km2) / SUM(followed)) AS error_km,"
        " 1.0 - 1.0 * SUM(followed) / SUM(targets) AS missed, SUM(swaps) AS swaps,"
        " sqrt(AVG(localisation_km2 + missed_km2 + false_km2)) AS gospa_km"
        " FROM picture WHERE run = ? GROUP BY t / ? ORDER BY 1",
        [run, width],
    )


def _first(rows: list[Row]) -> Row | None:
    return rows[0] if rows else None
