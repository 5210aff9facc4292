"""The journal of runs, in a file or on a server: every message as it was sent, and how far each run is acknowledged.

One process writes it, under a lock. What it writes is durable when `commit` returns. Any number of processes read it
meanwhile, and see what is committed.
"""

import json
import math
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cogradar.services.errors import INTERRUPTED, StoreFailed
from cogradar.services.recorder.store.database import Database
from cogradar.services.recorder.store.tables import Recording
from cogradar.shared.protocol.messages import Command, RunEnd, RunStart
from cogradar.shared.protocol.orders import Order
from cogradar.shared.scenario.trajectories.rows import Rows

DELETED_DWELLS = 256  # of a dropped run at a time, some milliseconds
PAGE = 256  # messages that are read at a time, of some kB; a dwell has fewer, as a rule
_PLACE = "(SELECT COALESCE(MAX(place), 0) + 1 FROM run)"  # after all others
_START = "SELECT run, document AS scenario, strategy, seed, dwells, rate_hz FROM run WHERE run = ?"


class Unreadable(ValueError):
    """A run of the journal that this program cannot read; the text says why."""


@dataclass(frozen=True)
class Retention:
    """What is kept: so many of the newest ended runs, none that ended longer ago; of runs without an end their newest
    dwells, by the run's clock and by the size of their messages. None: no limit.
    """

    runs: int | None = None
    days: float | None = None
    hours: float | None = None
    bytes_of_run: int = 4_000_000_000
    grace_s: int = 60  # any ended run is kept so long, for its client to see its end


def order_of(row: dict[str, Any]) -> Order:
    """The order in a row of `command`: its n, k and action. Raises ValueError, TypeError."""
    return Order.model_validate(row | {"action": json.loads(row["action"])})


class Journal(Database):
    """The rows of runs. Written: what gathers in one transaction until `commit`; read: what is committed, and that."""

    def add_run(self, start: RunStart) -> None:
        """Record that a run began; a repeated start changes nothing."""
        world, n_track = start.scenario["world"], start.scenario["radar"]["tracks"]
        n_track = None if n_track == "unknown" else n_track
        n_target = (n_track or 0) if world is None else len(world["targets"])
        document, strategy = json.dumps(start.scenario, sort_keys=True, default=Rows.tolist), start.strategy.value
        self.write(
            "INSERT INTO run (run, place, scenario, document, strategy, seed, dwells, dt_s, rate_hz, n_target, n_track,"
            f" has_truth, began_s) VALUES (?,{_PLACE},?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT (run) DO NOTHING",
            *(start.run, start.scenario["name"], document, strategy, start.seed, start.dwells),
            *(start.scenario["radar"]["motion"]["dt_s"], start.rate_hz, n_target, n_track, int(world is not None)),
            _now_s(),
        )

    def acknowledge(self, run: str, k: int, t: int) -> None:
        """Record that dwells 0 .. k-1 of a run are complete, and the clock t of the last one."""
        scans = k - t if t > 0 else None  # the clock starts when the acquisition is over
        query = "UPDATE run SET acknowledged_k = ?, acknowledged_t = ?, acquisition_scans = ? WHERE run = ?"
        self.write(query, k, t, scans, run)

    def end_run(self, end: RunEnd, digest: str) -> None:
        """Record how a run ended; its tracks will not be needed any more."""
        self._end("run = ?", (end.run,), end.status, end.reason, digest)

    def drop_ended(self, keep: Retention) -> None:
        """Drop the ended runs beyond what is to be kept. Their messages are deleted later (`delete_dropped`)."""
        if keep.runs is None and keep.days is None:
            return
        query = (
            "SELECT run FROM (SELECT run, ended_s, ROW_NUMBER() OVER (ORDER BY ended_s DESC, place DESC) AS nth"
            " FROM run WHERE status IN ('complete', 'failed')) AS ended WHERE ended_s <= ? AND (nth > ? OR ended_s < ?)"
        )
        runs = math.inf if keep.runs is None else keep.runs
        seconds = math.inf if keep.days is None else keep.days * 86400.0
        for row in self.read(query, [_now_s() - keep.grace_s, runs, _now_s() - seconds]):
            self.write("INSERT INTO dropped VALUES (?) ON CONFLICT DO NOTHING", row["run"])
            self.write("DELETE FROM command WHERE run = ?", row["run"])
            self.write("DELETE FROM run WHERE run = ?", row["run"])

    def delete_dropped(self) -> None:
        """Delete some messages of a dropped run: so few that no other work waits for it. Their space is used again."""
        for row in self.read(
            "SELECT run, (SELECT MIN(k) FROM message WHERE run = dropped.run) AS k FROM dropped LIMIT 1"
        ):
            if row["k"] is None:
                self.write("DELETE FROM dropped WHERE run = ?", row["run"])
            else:
                self.write("DELETE FROM message WHERE run = ? AND k < ?", row["run"], row["k"] + DELETED_DWELLS)

    def cut(self, run: str, before_k: int) -> int:
        """Delete the messages of the dwells before this one, whose space is used again; how many bytes they had.

        With them go the orders that shape none of the dwells that are left, and what was refused before; not the last
        command, after whose number the others count.
        """
        of_them = "FROM message WHERE run = ? AND k < ?"
        (row,) = self.rows(f"SELECT COALESCE(SUM(LENGTH(payload)), 0) {of_them}", (run, before_k))
        self.write(f"DELETE {of_them}", run, before_k)
        self.write("UPDATE run SET kept_k = ? WHERE run = ?", before_k, run)
        (ended,) = self.rows("SELECT MAX(n) FROM command WHERE run = ? AND over_k <= ?", (run, before_k))
        if ended[0] is not None:
            self.write(
                "DELETE FROM command WHERE run = ? AND n <= ? AND (k IS NULL OR over_k <= ?)"
                " AND n < (SELECT MAX(n) FROM command WHERE run = ?)",
                *(run, ended[0], before_k, run),
            )
        return int(row[0])

    def quarantine(self, run: str, reason: str) -> None:
        """Set a run aside that cannot go on because it cannot be read; its rows stay as they are."""
        self.write("UPDATE run SET status = 'quarantined', reason = ? WHERE run = ?", reason, run)

    def hinder(self, run: str, reason: str) -> None:
        """Say what a run that goes on is hindered by."""
        self.write("UPDATE run SET reason = ? WHERE run = ? AND status = 'running'", reason, run)

    def give_up_unfinished(self) -> None:
        """Mark the runs that have not ended as failed: the lock is ours, so their recorder is gone."""
        self._end("status = 'running'", (), "failed", INTERRUPTED, None)

    def add_conflict(self, run: str) -> None:
        """Count a message that differs from the one that came first."""
        self.write("UPDATE run SET conflicts = conflicts + 1 WHERE run = ?", run)

    def add_message(self, run: str, k: int, topic: str, item: int, payload: bytes) -> bool:
        """Record one message; false if it is there already."""
        query = "INSERT INTO message VALUES (?,?,?,?,?) ON CONFLICT DO NOTHING"
        return self.write(query, run, k, topic, item, payload) == 1

    def add_command(self, command: Command, n: int, k: int | None, reason: str) -> None:
        """Record a command: granted from dwell k on, or refused."""
        action = json.dumps(command.action.model_dump())
        self.write(
            "INSERT INTO command (run, n, id, asker, asked_s, action, k, reason) VALUES (?,?,?,?,?,?,?,?)",
            *(command.run, n, command.id, command.by, _now_s(), action, k, reason),
        )

    def end_order(self, run: str, n: int, over_k: int) -> None:
        """Record that no dwell from this one on is shaped by an order."""
        self.write("UPDATE command SET over_k = ? WHERE run = ? AND n = ?", over_k, run, n)

    def set_snapshot(self, run: str, target: int, k: int, payload: bytes) -> None:
        """Record what a track was after dwell k, in place of what is older; what is newer stays."""
        self.write(
            "INSERT INTO snapshot VALUES (?,?,?,?) ON CONFLICT (run, target)"
            " DO UPDATE SET k = excluded.k, payload = excluded.payload WHERE excluded.k > snapshot.k",
            *(run, target, k, payload),
        )

    def drop_snapshots(self, run: str, tracks: Collection[int]) -> None:
        """Drop the snapshots of all tracks but these, counted from 1."""
        others = f" AND target NOT IN ({','.join('?' * len(tracks))})" if tracks else ""
        self.write(f"DELETE FROM snapshot WHERE run = ?{others}", run, *tracks)

    def add_recording(self, recording: Recording, place: int) -> None:
        """Add a finished run, durably: all of it or nothing. Changes nothing if the run is there.

        `place` orders the runs of the store, whatever the order in which they are added.
        """
        row = recording.run | {"place": place}
        columns, marks = ", ".join(row), ",".join("?" * len(row))
        try:
            if self.write(f"INSERT INTO run ({columns}) VALUES ({marks}) ON CONFLICT (run) DO NOTHING", *row.values()):
                self.add_scores(recording.scores, recording.picture)
                self.add_rows("message", recording.messages)
            self.commit()
        except StoreFailed:
            self.rollback()
            raise

    def add_scores(self, scores: Sequence[dict[str, Any]], picture: Sequence[dict[str, Any]]) -> None:
        """Add the scores of a run, and its air pictures."""
        self.add_rows("main.score", scores)
        self.add_rows("main.picture", picture)

    def add_rows(self, table: str, rows: Sequence[dict[str, Any]]) -> None:
        """Add rows of equal columns to a table."""
        for first in rows[:1]:
            statement = f"INSERT INTO {table} ({', '.join(first)}) VALUES ({','.join('?' * len(first))})"
            self.write_many(statement, [tuple(row.values()) for row in rows])

    def set_campaign(self, document: dict[str, Any]) -> None:
        """Record, durably, what the campaign of this store is asked to be."""
        self.write("INSERT INTO campaign VALUES (?)", json.dumps(document, sort_keys=True))
        self.commit()

    def message(self, run: str, k: int, topic: str, item: int) -> bytes | None:
        """Payload of one message, None if it is not there."""
        query = "SELECT payload FROM message WHERE run = ? AND k = ? AND topic = ? AND item = ?"
        return next((bytes(row[0]) for row in self.rows(query, (run, k, topic, item))), None)

    def messages(self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None) -> Iterator[bytes]:
        """Payloads of a run from a dwell on, up to one before another, in the order of dwell, topic, item."""
        return (payload for _, _, payload in self.dwells(run, topics, from_k, to_k))

    def dwells(
        self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None
    ) -> Iterator[tuple[int, str, bytes]]:
        """The same with dwell and topic: (k, topic, payload)."""
        marks, end = ",".join("?" * len(topics)), 2**31 if to_k is None else to_k
        query = (
            f"SELECT k, topic, payload FROM message WHERE run = ? AND k >= ? AND k < ? AND topic IN ({marks})"
            " ORDER BY k, topic, item LIMIT ?"
        )
        most = PAGE
        while len(rows := self.rows(query, (run, from_k, end, *topics, most))) == most:  # there may be more
            last_k = rows[-1][0]  # this dwell may be cut by the end of the page
            if last_k == from_k:
                most *= 2
                continue
            yield from (tuple(row) for row in rows if row[0] < last_k)
            from_k, most = last_k, PAGE
        yield from map(tuple, rows)

    def snapshot(self, run: str, target: int, from_k: int) -> tuple[int, bytes] | None:
        """The snapshot of a track with its dwell, None if there is none of dwell `from_k` or later."""
        query = "SELECT k, payload FROM snapshot WHERE run = ? AND target = ? AND k >= ?"
        rows = self.read(query, [run, target, from_k])
        return (rows[0]["k"], rows[0]["payload"]) if rows else None

    def snapshot_ks(self, run: str) -> dict[int, int]:
        """Dwell of the snapshot of each track, counted from 1, that has one."""
        return {row[0]: row[1] for row in self.rows("SELECT target, k FROM snapshot WHERE run = ?", (run,))}

    def extent(self, run: str) -> tuple[int, int]:
        """Bytes of the messages of a run, and the oldest dwell that was not cut."""
        query = (
            "SELECT (SELECT COALESCE(SUM(LENGTH(payload)), 0) FROM message WHERE message.run = run.run), kept_k"
            " FROM run WHERE run = ?"
        )
        return next(((row[0], row[1]) for row in self.rows(query, (run,))), (0, 0))

    def start(self, run: str) -> RunStart | None:
        """How a run began, None if it is not there. Raises Unreadable."""
        rows = self.read(_START, [run])
        try:
            return RunStart.model_validate(rows[0] | {"scenario": json.loads(rows[0]["scenario"])}) if rows else None
        except (ValueError, TypeError) as error:
            raise Unreadable(" ".join(str(error).split())[:300]) from None

    def orders(self, run: str) -> list[Order]:
        """Commands of a run that were granted and are not over. Raises Unreadable."""
        query = "SELECT n, k, action FROM command WHERE run = ? AND k IS NOT NULL AND over_k IS NULL ORDER BY n"
        try:
            return [order_of(row) for row in self.read(query, [run])]
        except (ValueError, TypeError) as error:
            raise Unreadable(" ".join(str(error).split())[:300]) from None

    def commands(self, run: str, id_: str) -> tuple[int, int, bool]:
        """The last number of a run's commands, how many there are, and whether this one is among them."""
        query = "SELECT COALESCE(MAX(n), 0), COUNT(*), COUNT(CASE WHEN id = ? THEN 1 END) FROM command WHERE run = ?"
        (row,) = self.rows(query, [id_, run])
        return int(row[0]), int(row[1]), bool(row[2])

    def unfinished(self) -> list[str]:
        """Runs that have begun and not ended, in the order in which they began."""
        return [row["run"] for row in self.read("SELECT run FROM run WHERE status = 'running' ORDER BY place")]

    def campaign(self) -> dict[str, Any] | None:
        """What the campaign of this store was asked to be, None if it holds none."""
        rows = self.read("SELECT document FROM campaign")
        return json.loads(rows[0]["document"]) if rows else None

    def _end(self, condition: str, values: tuple[str, ...], status: str, reason: str, digest: str | None) -> None:
        self.write(f"DELETE FROM snapshot WHERE run IN (SELECT run FROM run WHERE {condition})", *values)
        query = f"UPDATE run SET status = ?, reason = ?, digest = ?, ended_s = ? WHERE {condition}"
        self.write(query, status, reason, digest, _now_s(), *values)


def _now_s() -> int:
    return int(time.time())
