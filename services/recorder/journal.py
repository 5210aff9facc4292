"""The durable store of runs, SQLite in WAL mode: every message as it was sent, one scored row per target and dwell."""

import json
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from services.errors import StoreFailed
from services.recorder.schema import connect
from shared.protocol.messages import RunEnd, RunStart

_START = "SELECT run, document AS scenario, strategy, seed, dwells, rate_hz FROM run"


class State(NamedTuple):
    """State of a target, km and km/s."""

    x: float
    vx: float
    y: float
    vy: float


@dataclass(frozen=True)
class Score:
    """How one target fared in one dwell. `target` and `track` count from 0."""

    run: str
    k: int
    t: int
    target: int
    track: int
    true_bin: int
    bin: int  # bin the track asked for in this dwell
    detected: bool  # the cell of the true bin was tested and exceeded the threshold
    snr_db: float
    state: State  # the truth
    estimate: State  # belief mean after this dwell's scan
    share: float  # power on the track's beam, linear; 0 for a waveform without beams
    late: bool  # real time: the beam was steered by a plan extrapolated from an earlier dwell
    stale: bool  # real time: the waveform of the dwell before was not there in time, an older one was radiated


@dataclass(frozen=True)
class Recording:
    """A finished run as rows of the store: its own, its scores, and those messages that are to be kept."""

    run: dict[str, Any]
    scores: list[tuple[Any, ...]]
    messages: list[tuple[Any, ...]]


class Store:
    """One SQLite file (or ":memory:"); written by one process, readable by any."""

    def __init__(self, path: str, *, read_only: bool = False) -> None:
        self._path = path
        self._db = connect(path, read_only=read_only)
        self._db.row_factory = sqlite3.Row

    def close(self) -> None:
        """Flush and close."""
        self._db.close()

    def add_run(self, start: RunStart, n_target: int) -> None:
        """Record that a run began; a repeated start changes nothing."""
        self._write(
            "INSERT OR IGNORE INTO run (run, scenario, document, strategy, seed, dwells, rate_hz, n_target)"
            " VALUES (?,?,?,?,?,?,?,?)",
            (
                start.run,
                start.scenario["name"],
                json.dumps(start.scenario, sort_keys=True),
                start.strategy.value,
                start.seed,
                start.dwells,
                start.rate_hz,
                n_target,
            ),
        )

    def set_acquisition_scans(self, run: str, n_scan: int) -> None:
        """Record how many scans the acquisition took."""
        self._write("UPDATE run SET acquisition_scans = ? WHERE run = ?", (n_scan, run))

    def end_run(self, end: RunEnd, digest: str) -> None:
        """Record how a run ended; its tracks will not be needed any more."""
        self._write(
            "UPDATE run SET status = ?, reason = ?, last_k = ?, digest = ? WHERE run = ?",
            (end.status, end.reason, end.k, digest, end.run),
        )
        self._forget_tracks()

    def add_conflict(self, run: str) -> None:
        """Count a message that differs from the one that was said before."""
        self._write("UPDATE run SET conflicts = conflicts + 1 WHERE run = ?", (run,))

    def add_message(self, run: str, k: int, topic: str, item: int, payload: bytes) -> bool:
        """Record one message; false if it is there already."""
        cursor = self._write("INSERT OR IGNORE INTO message VALUES (?,?,?,?,?)", (run, k, topic, item, payload))
        return cursor.rowcount == 1

    def add_scores(self, scores: Sequence[Score]) -> None:
        """Record scored rows."""
        if not scores:
            return
        rows = [
            (
                s.run,
                s.k,
                s.t,
                s.target,
                s.track,
                s.true_bin,
                s.bin,
                s.detected,
                s.snr_db,
                *s.state,
                *s.estimate,
                s.share,
                s.late,
                s.stale,
            )
            for s in scores
        ]
        try:
            self._db.executemany(f"INSERT OR REPLACE INTO score VALUES ({','.join('?' * len(rows[0]))})", rows)
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from None

    def message(self, run: str, k: int, topic: str, item: int) -> bytes | None:
        """Payload of one message, None if it is not there."""
        query = "SELECT payload FROM message WHERE run = ? AND k = ? AND topic = ? AND item = ?"
        row = self._db.execute(query, (run, k, topic, item)).fetchone()
        return None if row is None else bytes(row[0])

    def messages(self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None) -> Iterator[bytes]:
        """Payloads of a run from a dwell on, up to one before another, in the order of dwell, topic, item."""
        marks, end = ",".join("?" * len(topics)), 2**31 if to_k is None else to_k
        query = (
            f"SELECT payload FROM message WHERE run = ? AND k >= ? AND k < ? AND topic IN ({marks})"
            " ORDER BY k, topic, item"
        )
        try:
            for (payload,) in self._db.execute(query, (run, from_k, end, *topics)):
                yield payload
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from None

    def set_snapshot(self, run: str, target: int, k: int, payload: bytes) -> None:
        """Record what a track was after dwell k, in place of what is older; what is newer stays."""
        self._write(
            "INSERT INTO snapshot VALUES (?,?,?,?) ON CONFLICT (run, target)"
            " DO UPDATE SET k = excluded.k, payload = excluded.payload WHERE excluded.k > k",
            (run, target, k, payload),
        )

    def snapshot(self, run: str, target: int, from_k: int) -> tuple[int, bytes] | None:
        """The snapshot of a track with its dwell, None if there is none of dwell `from_k` or later."""
        query = "SELECT k, payload FROM snapshot WHERE run = ? AND target = ? AND k >= ?"
        rows = self.read(query, [run, target, from_k])
        return (rows[0]["k"], rows[0]["payload"]) if rows else None

    def start(self, run: str) -> RunStart | None:
        """How a run began, None if it is not there."""
        rows = self.read(f"{_START} WHERE run = ?", [run])
        return _start(rows[0]) if rows else None

    def unfinished(self) -> list[RunStart]:
        """Runs that have begun and not ended, in the order in which they began."""
        return [_start(row) for row in self.read(f"{_START} WHERE status = 'running' ORDER BY rowid")]

    def give_up_unfinished(self) -> None:
        """Mark the runs that have not ended as failed: whoever played them is gone."""
        self._write("UPDATE run SET status = 'failed', reason = 'interrupted' WHERE status = 'running'", ())
        self._forget_tracks()

    def read(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT, as dictionaries."""
        try:
            return [dict(row) for row in self._db.execute(query, tuple(parameters))]
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from None

    def recording(self, run: str, keep: Sequence[tuple[str, int]]) -> Recording:
        """A finished run, with its messages of these (topic, dwell k) only."""
        (row,) = self.read("SELECT * FROM run WHERE run = ?", [run])
        scores = self._db.execute("SELECT * FROM score WHERE run = ? ORDER BY t, target", (run,)).fetchall()
        messages = [
            tuple(message)
            for topic, k in keep
            for message in self._db.execute(
                "SELECT * FROM message WHERE run = ? AND topic = ? AND k = ? ORDER BY item", (run, topic, k)
            )
        ]
        return Recording(row, [tuple(score) for score in scores], messages)

    def add_recording(self, recording: Recording, place: int) -> None:
        """Add a finished run in one transaction: all of it or nothing. Changes nothing if the run is there.

        `place` orders the runs of the store, whatever the order in which they are added.
        """
        row = {"rowid": place} | recording.run
        try:
            self._db.execute("BEGIN IMMEDIATE")
            added = self._insert("OR IGNORE INTO run", tuple(row), [tuple(row.values())])
            if added:
                self._insert("INTO score", (), recording.scores)
                self._insert("INTO message", (), recording.messages)
            self._db.execute("COMMIT")
        except sqlite3.Error as error:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
            raise StoreFailed(f"{self._path}: {error}") from None

    def campaign(self) -> dict[str, Any] | None:
        """What the campaign of this store was asked to be, None if it holds none."""
        rows = self.read("SELECT document FROM campaign")
        return json.loads(rows[0]["document"]) if rows else None

    def set_campaign(self, document: dict[str, Any]) -> None:
        """Record what the campaign is asked to be."""
        self._write("INSERT INTO campaign VALUES (?)", (json.dumps(document, sort_keys=True),))

    def _insert(self, where: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> int:
        """Insert rows, all of one length; returns how many were."""
        if not rows:
            return 0
        names = f" ({', '.join(columns)})" if columns else ""
        marks = ",".join("?" * len(rows[0]))
        return self._db.executemany(f"INSERT {where}{names} VALUES ({marks})", rows).rowcount

    def _forget_tracks(self) -> None:
        """Drop the snapshots of runs that are over, also if the process died just after it had ended one."""
        self._write("DELETE FROM snapshot WHERE run NOT IN (SELECT run FROM run WHERE status = 'running')", ())

    def _write(self, statement: str, parameters: Sequence[Any]) -> sqlite3.Cursor:
        try:
            return self._db.execute(statement, tuple(parameters))
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from None


def _start(row: dict[str, Any]) -> RunStart:
    return RunStart.model_validate(row | {"scenario": json.loads(row["scenario"])})
