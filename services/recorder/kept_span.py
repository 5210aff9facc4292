"""How far back the journal reaches in a run without an end: its oldest dwells are cut while it goes on.

A planner that rebuilds a track recalls scans from the track's snapshot on, or from its birth. Neither is cut, nor what
any process may still ask for: the dwells shortly before the acknowledged one.

Of a run that goes on again the messages are counted first, some at a time: a radar does not wait until a gigabyte is
read.
"""

import math
from dataclasses import dataclass
from typing import Any

from cogradar.services.recorder.journal import Journal, Retention
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.services.recorder.store.check import missing
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.limits import NO_END, SECONDS_PER_HOUR

ALWAYS_DWELLS = 1024  # acknowledged ones that are kept at least: twice what a process keeps of a run
AT_A_TIME = 64  # dwells that are cut with a checkpoint, some milliseconds: more than it acknowledges
COUNTED = 5_000  # messages at a time, some,
COUNTED_AT_ONCE = 20_000  # ... but so many when a run is reopened


@dataclass
class KeptSpan:
    """Of one run; a run with an end is kept whole."""

    most_dwells: float = math.inf
    most_bytes: float = math.inf
    n_byte: int = 0  # of its messages in the journal
    first_k: int = 0  # the oldest dwell in it
    counted_k: int = 0  # the messages of this dwell and all later ones are counted
    n_counted: int = 0  # ... of the acknowledged dwells
    recorded: tuple[int, int] = (0, 0)  # acknowledged dwells, and their messages, when it was opened

    @classmethod
    def of(cls, start: RunStart, keep: Retention) -> "KeptSpan":
        """Of a run that begins."""
        if start.dwells < NO_END:
            return cls()
        hours, dt_s = math.inf if keep.hours is None else keep.hours, start.scenario["radar"]["motion"]["dt_s"]
        return cls(hours * SECONDS_PER_HOUR / dt_s, keep.bytes_of_run)

    def reopen(self, journal: Journal, row: dict[str, Any]) -> None:
        """Go on with what the journal has of a run, whose messages may still have to be counted. Raises Damaged."""
        self.first_k, self.counted_k = row["kept_k"], row["acknowledged_k"]
        self.recorded = row["acknowledged_k"], row["messages"]
        _, self.n_byte = journal.extent(row["run"], self.counted_k)
        while not self.is_counted and self.n_counted < COUNTED_AT_ONCE:
            self.count(journal, row["run"])

    @property
    def is_counted(self) -> bool:
        """Whether the messages are all there."""
        return self.counted_k <= self.first_k

    def count(self, journal: Journal, run: str) -> None:
        """Count the messages of some dwells more, from the newest on. Raises Damaged in the end if some are missing."""
        acknowledged_k, n_recorded = self.recorded
        n_dwell = max(COUNTED * (acknowledged_k - self.first_k) // max(n_recorded, 1), 1)
        before_k, self.counted_k = self.counted_k, max(self.counted_k - n_dwell, self.first_k)
        # What was cut and is there all the same is too many.
        n_message, n_byte = journal.extent(run, 0 if self.is_counted else self.counted_k, before_k)
        self.n_counted, self.n_byte = self.n_counted + n_message, self.n_byte + n_byte
        if self.is_counted and self.n_counted != self.recorded[1]:
            raise missing(journal, run, self.n_counted, *self.recorded)

    def cut(self, journal: Journal, run: RecordedRun) -> None:
        """Delete the oldest dwells that are too many, some at a time; none before all are counted."""
        if not self.is_counted:
            return
        excess = 0 if self.n_byte <= self.most_bytes else AT_A_TIME
        wanted_k = max(run.acknowledged[0] - self.most_dwells, self.first_k + excess)
        before_k = int(min(wanted_k, self.first_k + AT_A_TIME, run.acknowledged[0] - ALWAYS_DWELLS))
        if before_k > self.first_k and (before_k := min(before_k, self._needed_k(journal, run))) > self.first_k:
            n_message, n_byte = journal.cut(run.start.run, before_k)
            run.n_message, self.n_byte = run.n_message - n_message, self.n_byte - n_byte
            self.first_k = before_k

    @staticmethod
    def _needed_k(journal: Journal, run: RecordedRun) -> int:
        """The oldest dwell from which a track may have to be rebuilt; 0 while the tracks are not known."""
        snapshots = journal.snapshot_ks(run.start.run)
        tracks = run.born_ks.items()
        return 0 if run.tracks is None else min((snapshots.get(m + 1, k) for m, k in tracks), default=run.k)
