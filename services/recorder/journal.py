"""The journal of runs, SQLite in WAL mode: every message as it was sent, and how far each run is acknowledged.

One process writes it, under a lock. What it writes is durable when `commit` returns. Any number of processes read it
meanwhile, and see what is committed.
"""

import json
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cogradar.services.errors import INTERRUPTED, StoreFailed
from cogradar.services.recorder.file.database import Database
from cogradar.services.recorder.file.schema import Recording
from cogradar.shared.protocol.messages import Command, RunEnd, RunStart
from cogradar.shared.protocol.orders import Order
from cogradar.shared.scenario.trajectories.rows import Rows

DELETED_DWELLS = 256  # of a dropped run at a time, some milliseconds
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
            "INSERT OR IGNORE INTO run (run, scenario, document, strategy, seed, dwells, rate_hz, n_target, n_track,"
            " has_truth, began_s) VALUES (?,?,?,?,?,?,?,?,?,?,strftime('%s'))",
            *(start.run, start.scenario["name"], document, strategy, start.seed, start.dwells, start.rate_hz),
            *(n_target, n_track, world is not None),
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
            "SELECT run FROM (SELECT run, ended_s, ROW_NUMBER() OVER (ORDER BY ended_s DESC, rowid DESC) AS nth"
            " FROM run WHERE status IN ('complete', 'failed'))"
            " WHERE ended_s <= strftime('%s') - ? AND (nth > ? OR ended_s < strftime('%s') - ?)"
        )
        runs = math.inf if keep.runs is None else keep.runs
        seconds = math.inf if keep.days is None else keep.days * 86400.0
        for row in self.read(query, [keep.grace_s, runs, seconds]):
            self.write("INSERT OR IGNORE INTO dropped VALUES (?)", row["run"])
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
                "DELETE FROM command WHERE run = ?1 AND n <= ?2 AND (k IS NULL OR over_k <= ?3)"
                " AND n < (SELECT MAX(n) FROM command WHERE run = ?1)",
                *(run, ended[0], before_k),
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
        return self.write("INSERT OR IGNORE INTO message VALUES (?,?,?,?,?)", run, k, topic, item, payload) == 1

    def add_command(self, command: Command, n: int, k: int | None, reason: str) -> None:
        """Record a command: granted from dwell k on, or refused."""
        action = json.dumps(command.action.model_dump())
        self.write(
            "INSERT INTO command (run, n, id, asker, asked_s, action, k, reason) VALUES (?,?,?,?,strftime('%s'),?,?,?)",
            *(command.run, n, command.id, command.by, action, k, reason),
        )

    def end_order(self, run: str, n: int, over_k: int) -> None:
        """Record that no dwell from this one on is shaped by an order."""
        self.write("UPDATE command SET over_k = ? WHERE run = ? AND n = ?", over_k, run, n)

    def set_snapshot(self, run: str, target: int, k: int, payload: bytes) -> None:
        """Record what a track was after dwell k, in place of what is older; what is newer stays."""
        self.write(
            "INSERT INTO snapshot VALUES (?,?,?,?) ON CONFLICT (run, target)"
            " DO UPDATE SET k = excluded.k, payload = excluded.payload WHERE excluded.k > k",
            *(run, target, k, payload),
        )

    def drop_snapshots(self, run: str, tracks: Collection[int]) -> None:
        """Drop the snapshots of all tracks but these, counted from 1."""
        marks = ",".join("?" * len(tracks))
        self.write(f"DELETE FROM snapshot WHERE run = ? AND target NOT IN ({marks})", run, *tracks)

    def add_recording(self, recording: Recording, place: int) -> None:
        """Add a finished run, durably: all of it or nothing. Changes nothing if the run is there.

        `place` orders the runs of the store, whatever the order in which they are added.
        """
        row = {"rowid": place} | recording.run
        try:
            if self._insert("OR IGNORE INTO run", [row]):
                self._insert("INTO main.score", recording.scores)
                self._insert("INTO main.picture", recording.picture)
                self._insert("INTO message", recording.messages)
            self.commit()
        except StoreFailed:
            self.rollback()
            raise

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
            " ORDER BY k, topic, item"
        )
        yield from map(tuple, self.each(query, (run, from_k, end, *topics)))

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
            "SELECT (SELECT COALESCE(SUM(LENGTH(payload)), 0) FROM message WHERE run = ?1), kept_k FROM run"
            " WHERE run = ?1"
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
        is_known = "EXISTS (SELECT 1 FROM command WHERE run = ?1 AND id = ?2)"
        query = f"SELECT COALESCE(MAX(n), 0), COUNT(*), {is_known} FROM command WHERE run = ?1"
        (row,) = self.rows(query, [run, id_])
        return int(row[0]), int(row[1]), bool(row[2])

    def unfinished(self) -> list[str]:
        """Runs that have begun and not ended, in the order in which they began."""
        return [row["run"] for row in self.read("SELECT run FROM run WHERE status = 'running' ORDER BY rowid")]

    def campaign(self) -> dict[str, Any] | None:
        """What the campaign of this store was asked to be, None if it holds none."""
        rows = self.read("SELECT document FROM campaign")
        return json.loads(rows[0]["document"]) if rows else None

    def _end(self, condition: str, values: tuple[str, ...], status: str, reason: str, digest: str | None) -> None:
        self.write(f"DELETE FROM snapshot WHERE run IN (SELECT run FROM run WHERE {condition})", *values)
        self.write(
            f"UPDATE run SET status = ?, reason = ?, digest = ?, ended_s = strftime('%s') WHERE {condition}",
            status,
            reason,
            digest,
            *values,
        )

    def _insert(self, where: str, rows: Sequence[dict[str, Any]]) -> int:
        """Insert rows, each by its columns; returns how many were."""
        return sum(
            self.write(f"INSERT {where} ({', '.join(row)}) VALUES ({','.join('?' * len(row))})", *row.values())
            for row in rows
        )
