"""The journal of runs, in a file or on a server: every message as it was sent, and how far each run is acknowledged.

One process writes it, under a lock. What it writes is durable when `commit` returns. Any number of processes read it
meanwhile, and see what is committed.
"""

import json
import math
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from cogradar.services.errors import INTERRUPTED, Damaged, StoreFailed
from cogradar.services.recorder.store.database import Database
from cogradar.services.recorder.store.seal import (
    CHECKSUM,
    LISTED,
    QUARANTINED,
    SEALED,
    checksum,
    damaged,
    message_checksum,
    scores_checksum,
    sealed,
    verify,
)
from cogradar.services.recorder.store.tables import Recording
from cogradar.shared.protocol.messages import MAX_LEADS, Command, Lead, RunEnd, RunStart
from cogradar.shared.protocol.orders import Order
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.trajectories.rows import Rows

DELETED_DWELLS = 256  # of a dropped run at a time, some milliseconds
PAGE = 256  # messages that are read at a time, of some kB; a dwell has fewer, as a rule
_ONE = "WHERE run = ?"


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


_NEW: dict[str, Any] = dict.fromkeys(SEALED["run"])  # a run that begins
_NEW |= {"status": "running", "reason": "", "leads": "[]"}
_NEW |= dict.fromkeys(("acknowledged_k", "acknowledged_t", "kept_k", "conflicts", "messages", "commands"), 0)


def order_of(row: dict[str, Any]) -> Order:
    """The order in a row of `command`: its n, k and action. Raises ValueError, TypeError."""
    return Order.model_validate({"n": row["n"], "k": row["k"], "action": json.loads(row["action"])})


class Journal(Database):
    """The rows of runs. Written: what gathers in one transaction until `commit`; read: what is committed, and that."""

    def __init__(self, path: str, *, owner: str = "cogradar", read_only: bool = False) -> None:
        super().__init__(path, owner=owner, read_only=read_only)
        self._running: dict[str, dict[str, Any]] = {}  # rows of runs as this process verified or wrote them last
        self._stuck: set[str] = set()  # dropped runs whose messages cannot be deleted, as they are damaged

    def lead(self) -> None:
        """Take the lead of all runs, whose rows may be older than they were."""
        self._running.clear()
        super().lead()

    def rollback(self) -> None:
        """Undo what was written since the last commit."""
        self._running.clear()
        super().rollback()

    def add_run(self, start: RunStart) -> None:
        """Record that a run began; a repeated start changes nothing."""
        world, n_track = start.scenario["world"], start.scenario["radar"]["tracks"]
        n_track = None if n_track == "unknown" else n_track
        n_target = (n_track or 0) if world is None else len(world["targets"])
        row = {
            "run": start.run,
            "scenario": start.scenario["name"],
            "document": json.dumps(start.scenario, sort_keys=True, default=Rows.tolist),
            "strategy": start.strategy.value,
            "seed": start.seed,
            "dwells": start.dwells,
            "dt_s": start.scenario["radar"]["motion"]["dt_s"],
            "rate_hz": start.rate_hz,
            "n_target": n_target,
            "n_track": n_track,
            "has_truth": int(world is not None),
            "began_s": int(time.time()),
        }
        self._add_run(row)

    def _add_run(self, row: dict[str, Any]) -> bool:
        """Add a run, unless it is there; whether it was not. Without a place it comes after all others."""
        if "place" not in row:
            row["place"] = self.rows("SELECT COALESCE(MAX(place), 0) + 1 FROM run")[0][0]
        row = sealed("run", _NEW | row)
        marks = ",".join("?" * len(row))
        statement = f"INSERT INTO run ({', '.join(row)}) VALUES ({marks}) ON CONFLICT (run) DO NOTHING"
        return self.write(statement, *row.values()) == 1

    def _change(self, run: str, **values: Any) -> None:
        """Change columns of a run. Raises Damaged: what is damaged keeps the checksum that does not fit it."""
        if (row := self._row(run)) is None:
            return
        row = sealed("run", row | values)
        statement = f"UPDATE run SET {' = ?, '.join(values)} = ?, {CHECKSUM} = ? {_ONE}"
        if self.write(statement, *values.values(), row[CHECKSUM], run) != 1:
            raise damaged(self.path, "run", row, "it is gone")
        if row["status"] == "running":
            self._running[run] = row
        else:
            self._running.pop(run, None)

    def _add(self, run: str, **values: int) -> None:
        """Add to what a run's row counts. Raises Damaged."""
        if (row := self._row(run)) is not None:
            self._change(run, **{name: row[name] + value for name, value in values.items()})

    def _row(self, run: str) -> dict[str, Any] | None:
        """The row of a run, None if it is not there. Raises Damaged. One that goes on is read once."""
        found = self._running.get(run)
        for row in self.read(f"SELECT {LISTED['run']} FROM run {_ONE}", [run]) if found is None else ():
            verify(self.path, "run", row)  # also if it is set aside: its damage gets no checksum that fits
            found = row
        return found

    def acknowledge(self, run: str, k: int, t: int, n_message: int) -> None:
        """Record that dwells 0 .. k-1 of a run are complete, with so many messages, and the clock t of the last one."""
        scans = k - t if t > 0 else None  # the clock starts when the acquisition is over
        self._change(run, acknowledged_k=k, acknowledged_t=t, acquisition_scans=scans, messages=n_message)

    def end_run(self, end: RunEnd, digest: str | None) -> None:
        """Record how a run ended; its tracks will not be needed any more."""
        self.write("DELETE FROM snapshot WHERE run = ?", end.run)
        self._running.pop(end.run, None)  # it is read once more, and verified
        self._change(end.run, status=end.status, reason=end.reason, digest=digest, ended_s=int(time.time()), leads="[]")

    def drop_ended(self, keep: Retention) -> None:
        """Drop the ended runs beyond what is to be kept. Their messages are deleted later (`delete_dropped`)."""
        if keep.runs is None and keep.days is None:
            return
        query = (
            "SELECT run FROM (SELECT run, ended_s, ROW_NUMBER() OVER (ORDER BY ended_s DESC, place DESC) AS nth"
            " FROM run WHERE status IN ('complete', 'stopped', 'failed')) AS ended"
            " WHERE ended_s <= ? AND (nth > ? OR ended_s < ?)"
        )
        now, runs = int(time.time()), math.inf if keep.runs is None else keep.runs
        seconds = math.inf if keep.days is None else keep.days * 86400.0
        for row in self.read(query, [now - keep.grace_s, runs, now - seconds]):
            with self._or_aside(row["run"]):
                self.drop(row["run"])

    def drop(self, run: str) -> None:
        """Drop a run with all that belongs to it. Its messages are deleted later (`delete_dropped`)."""
        self.write("INSERT INTO dropped VALUES (?) ON CONFLICT DO NOTHING", run)
        for table in ("command", "snapshot", "main.score", "main.picture", "run"):
            self.write(f"DELETE FROM {table} WHERE run = ?", run)

    def dropped(self) -> list[str]:
        """Runs that are dropped and not known to be damaged: some of their messages may be there still."""
        return [run for (run,) in self.rows("SELECT run FROM dropped ORDER BY run") if run not in self._stuck]

    def delete_dropped(self) -> int:
        """Delete some messages of a dropped run: so few that no other work waits for it. Their space is used again.

        Returns how many.
        """
        for run in self.dropped()[:1]:
            try:
                with self.part():
                    ((k,),) = self.rows("SELECT MIN(k) FROM message WHERE run = ?", (run,))
                    if k is None:
                        self.write("DELETE FROM dropped WHERE run = ?", run)
                    else:
                        return self.write("DELETE FROM message WHERE run = ? AND k < ?", run, k + DELETED_DWELLS)
            except Damaged:  # it takes space, and is no run any more
                self._stuck.add(run)
        return 0

    def cut(self, run: str, before_k: int) -> tuple[int, int]:
        """Delete the messages of the dwells before this one, whose space is used again; their number, and their bytes.

        With them go the orders that shape none of the dwells that are left, and what was refused before; not the last
        command, after whose number the others count.
        """
        of_them = "FROM message WHERE run = ? AND k < ?"
        (row,) = self.rows(f"SELECT COALESCE(SUM(LENGTH(payload)), 0) {of_them}", (run, before_k))
        n_message = self.write(f"DELETE {of_them}", run, before_k)
        ((ended,),) = self.rows("SELECT MAX(n) FROM command WHERE run = ? AND over_k <= ?", (run, before_k))
        n_command = self.write(  # n <= NULL is never true: nothing is deleted
            "DELETE FROM command WHERE run = ? AND n <= ? AND (k IS NULL OR over_k <= ?)"
            " AND n < (SELECT MAX(n) FROM command WHERE run = ?)",
            *(run, ended, before_k, run),
        )
        self._add(run, messages=-n_message, commands=-n_command)
        self._change(run, kept_k=before_k)
        return n_message, int(row[0])

    def quarantine(self, run: str, reason: str) -> None:
        """Set a run aside that cannot go on because it cannot be read; its rows stay as they are."""
        self._running.pop(run, None)  # what was written of it may be undone by now
        try:
            self._change(run, status=QUARANTINED, reason=reason)
        except Damaged:  # the row keeps its checksum, and nothing else in it is believed
            self.write("UPDATE run SET status = ?, reason = ? WHERE run = ?", QUARANTINED, reason, run)

    def quarantine_place(self, place: int, reason: str) -> None:
        """The same of the run in this place: its name may be another one by now."""
        self._running.clear()
        self.write("UPDATE run SET status = ?, reason = ? WHERE place = ?", QUARANTINED, reason, place)

    def add_unknown(self, run: str, reason: str) -> None:
        """Add a run whose row is lost, set aside: a row that says no more, with a checksum that does not fit."""
        row: dict[str, Any] = dict.fromkeys(("scenario", "strategy"), "") | {"document": "{}", "dt_s": 1.0}
        row |= dict.fromkeys(("seed", "dwells", "rate_hz", "n_target", "has_truth", "began_s"), 0)
        self._add_run(row | {"run": run, "status": QUARANTINED, "reason": reason})
        self.write(f"UPDATE run SET {CHECKSUM} = {CHECKSUM} + 1 {_ONE}", run)

    @contextmanager
    def _or_aside(self, run: str) -> Iterator[None]:
        """What is done within to a run is undone if it is damaged, and it is set aside."""
        try:
            with self.part():
                yield
        except Damaged as error:
            self.quarantine(run, str(error))

    def give_up_unfinished(self) -> None:
        """Mark the runs that have not ended as failed: the lock is ours, so their recorder is gone."""
        for run in self.unfinished():
            with self._or_aside(run):
                self.end_run(RunEnd(run=run, k=0, t=0, status="failed", reason=INTERRUPTED), None)

    def hinder(self, run: str, reason: str) -> None:
        """Say what a run that goes on is hindered by."""
        self._change(run, reason=reason)

    def leads(self, run: str, revision: int) -> list[Lead]:
        """The last epochs of a run, and the revision with which each began; of this recorder's own the present one,
        unless it leads the run already. Raises Unreadable.
        """
        row = self._row(run)
        try:
            known = [Lead(epoch=epoch, revision=told) for epoch, told in json.loads(row["leads"])] if row else []
        except (ValueError, TypeError) as error:
            raise Unreadable(" ".join(str(error).split())[:300]) from None
        if not known or known[-1].epoch != self.epoch:
            known.append(Lead(epoch=self.epoch, revision=revision))
        return known[-MAX_LEADS:]

    def set_leads(self, run: str, leads: Sequence[Lead]) -> None:
        """Record the last epochs of a run. Raises Damaged."""
        self._change(run, leads=json.dumps([(lead.epoch, lead.revision) for lead in leads]))

    def add_conflict(self, run: str) -> None:
        """Count a message that differs from the one that came first."""
        self._add(run, conflicts=1)

    def add_message(self, run: str, k: int, topic: str, item: int, payload: bytes) -> bool:
        """Record one message; false if it is there already."""
        row = run, k, topic, item, payload
        query = "INSERT INTO message VALUES (?,?,?,?,?,?) ON CONFLICT DO NOTHING"
        return self.write(query, *row, message_checksum(*row)) == 1

    def add_command(self, command: Command, n: int, k: int | None, reason: str) -> None:
        """Record a command: granted from dwell k on, or refused."""
        row = {
            "run": command.run,
            "n": n,
            "id": command.id,
            "asker": command.by,
            "asked_s": int(time.time()),
            "action": json.dumps(command.action.model_dump()),
            "k": k,
            "reason": reason,
            "over_k": None,
        }
        self.add_rows("command", [sealed("command", row)])
        self._add(command.run, commands=1)

    def end_order(self, run: str, n: int, over_k: int) -> None:
        """Record that no dwell from this one on is shaped by an order."""
        for row in self.stored("command", "WHERE run = ? AND n = ?", [run, n]):
            query = "UPDATE command SET over_k = ?, checksum = ? WHERE run = ? AND n = ?"
            self.write(query, over_k, sealed("command", row | {"over_k": over_k})[CHECKSUM], run, n)

    def set_snapshot(self, run: str, target: int, k: int, payload: bytes) -> None:
        """Record what a track was after dwell k, in place of what is older; what is newer stays."""
        self.write(
            "INSERT INTO snapshot VALUES (?,?,?,?,?) ON CONFLICT (run, target) DO UPDATE SET k = excluded.k,"
            " checksum = excluded.checksum, payload = excluded.payload WHERE excluded.k > snapshot.k",
            *(run, target, k, payload, checksum((run, target, k), payload)),
        )

    def drop_snapshots(self, run: str, tracks: Collection[int]) -> None:
        """Drop the snapshots of all tracks but these, counted from 1."""
        others = f" AND target NOT IN ({','.join('?' * len(tracks))})" if tracks else ""
        self.write(f"DELETE FROM snapshot WHERE run = ?{others}", run, *tracks)

    def add_recording(self, recording: Recording, place: int) -> None:
        """Add a finished run, durably: all of it or nothing. Changes nothing if the run is there.

        `place` orders the runs of the store, whatever the order in which they are added.
        """
        own: dict[str, int | None] = {"place": place, "messages": len(recording.messages), "commands": 0}
        own["scores_checksum"] = scores_checksum(recording.scores, recording.picture)
        try:
            if self._add_run(recording.run | own):
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
        self.add_rows("campaign", [sealed("campaign", {"document": json.dumps(document, sort_keys=True)})])
        self.commit()

    def message(self, run: str, k: int, topic: str, item: int) -> bytes | None:
        """Payload of one message, None if it is not there."""
        found = self.stored("message", "WHERE run = ? AND k = ? AND topic = ? AND item = ?", (run, k, topic, item))
        return found[0]["payload"] if found else None

    def messages(self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None) -> Iterator[bytes]:
        """Payloads of a run from a dwell on, up to one before another, in the order of dwell, topic, item."""
        return (payload for _, _, payload in self.dwells(run, topics, from_k, to_k))

    def dwells(
        self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None
    ) -> Iterator[tuple[int, str, bytes]]:
        """The same with dwell and topic: (k, topic, payload). Raises Damaged."""
        marks, end = ",".join("?" * len(topics)), 2**31 if to_k is None else to_k
        query = (
            f"SELECT k, topic, item, payload, checksum FROM message WHERE run = ? AND k >= ? AND k < ?"
            f" AND topic IN ({marks}) ORDER BY k, topic, item LIMIT ?"
        )
        most, last = PAGE, (-1, "", 0)
        while True:
            rows = self.rows(query, (run, from_k, end, *topics, most))
            is_cut = len(rows) == most  # there may be more, also of the last dwell
            last_k = rows[-1][0] if is_cut else end
            if is_cut and last_k == from_k:
                most *= 2
                continue
            for k, topic, item, payload, known in rows:
                if is_cut and k >= last_k:
                    break
                is_after = (k, topic, item) > last  # else it is there twice, or out of place
                if not is_after or message_checksum(run, k, topic, item, payload) != known:
                    row = {"run": run, "k": k, "topic": topic, "item": item}
                    raise damaged(self.path, "message", row)
                last = k, topic, item
                yield k, topic, payload
            if not is_cut:
                return
            from_k, most = last_k, PAGE

    def snapshot(self, run: str, target: int, from_k: int) -> tuple[int, bytes] | None:
        """The snapshot of a track with its dwell, None if there is none of dwell `from_k` or later."""
        rows = self.stored("snapshot", "WHERE run = ? AND target = ? AND k >= ?", [run, target, from_k])
        return (rows[0]["k"], rows[0]["payload"]) if rows else None

    def snapshot_ks(self, run: str) -> dict[int, int]:
        """Dwell of the snapshot of each track, counted from 1, that has one."""
        return {row[0]: row[1] for row in self.rows("SELECT target, k FROM snapshot WHERE run = ?", (run,))}

    def extent(self, run: str, from_k: int = 0, before_k: int = NO_END) -> tuple[int, int]:
        """Number and bytes of the messages of a run's dwells from one on, up to one before another."""
        query = "SELECT COUNT(*), COALESCE(SUM(LENGTH(payload)), 0) FROM message WHERE run = ? AND k >= ? AND k < ?"
        (row,) = self.rows(query, (run, from_k, before_k))
        return int(row[0]), int(row[1])

    def start(self, run: str) -> RunStart | None:
        """How a run began, None if it is not there. Raises Unreadable, Damaged."""
        if (row := self.whole_row(run)) is None:
            return None
        try:
            told = {name: row[name] for name in ("run", "strategy", "seed", "dwells", "rate_hz")}
            return RunStart.model_validate(told | {"scenario": json.loads(row["document"])})
        except (ValueError, TypeError) as error:
            raise Unreadable(" ".join(str(error).split())[:300]) from None

    def whole_row(self, run: str) -> dict[str, Any] | None:
        """The row of a run with its document, None if it is not there. Raises Damaged."""
        for row in self.read("SELECT * FROM run WHERE run = ?", [run]):
            verify(self.path, "run", row)
            return row
        return None

    def orders(self, run: str) -> list[Order]:
        """Commands of a run that were granted and are not over. Raises Unreadable, Damaged."""
        rows = self.stored("command", "WHERE run = ? ORDER BY n", [run])  # all: over_k may be what is damaged
        try:
            return [order_of(row) for row in rows if row["k"] is not None and row["over_k"] is None]
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
        return next((json.loads(row["document"]) for row in self.stored("campaign", "")), None)
