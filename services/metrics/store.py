"""The runs of a journal with their scores. A campaign's store keeps them; of other runs they are derived from messages.

Derived scores lie in a temporary table of this process and never in the journal, which is opened read-only (or is that
of the same process). The view `score` shows both kinds. A run is scored as far as it is acknowledged, each dwell once.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

from services.metrics.scores import SCORED, Score, Scorer
from services.recorder.journal import Journal, Unreadable
from services.recorder.schema import MEMORY, SCORE_COLUMNS
from shared.wire.codec import BadMessage, fields

AT_ONCE = 4096  # dwells whose scores are in memory at the same time
_ADD = "INSERT OR REPLACE INTO temp.derived VALUES (?, ?,?,?,?,?,?,?,?, ?,?,?,?, ?,?,?,?, ?,?,?,?)"


class Store:
    """What can be read of runs; `derive` first, for those whose scores are wanted."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self._scorers: dict[str, Scorer] = {}
        self._finished: set[str] = set()  # runs that have all their scores
        self.unreadable: dict[str, str] = {}  # runs that cannot be scored, and why
        journal.create_temporary(f"TABLE derived ({SCORE_COLUMNS}) WITHOUT ROWID")
        journal.create_temporary("VIEW score AS SELECT * FROM main.score UNION ALL SELECT * FROM temp.derived")

    def close(self) -> None:
        """Close the journal."""
        self.journal.close()

    def read(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT, as dictionaries."""
        return self.journal.read(query, parameters)

    def derive(self, runs: Iterable[str] | None = None, most: int | None = None) -> None:
        """Score what is acknowledged of these runs, or of all; `most` dwells of each, the others next time."""
        names = [row["run"] for row in self.read("SELECT run FROM run")] if runs is None else runs
        for run in names:
            if run not in self._finished:
                self._derive(run, most)

    def forget_dropped(self) -> None:
        """Forget the runs that are no longer in the journal."""
        runs = {row["run"] for row in self.read("SELECT run FROM run")}
        for run in (self._finished | self._scorers.keys()) - runs:
            self._forget(run)

    def _derive(self, run: str, most: int | None) -> None:
        rows = self.read(
            "SELECT acknowledged_k AS k, status, EXISTS (SELECT 1 FROM main.score WHERE score.run = run.run) AS is_kept"
            " FROM run WHERE run = ?",
            [run],
        )
        if not rows:
            return
        (row,) = rows
        if run in self._scorers and self._scorers[run].k > row["k"]:  # the journal was restored from an older state
            self._forget(run)
        try:
            if not row["is_kept"]:
                self._score(self._scorer(run), run, row["k"], most)
        except (Unreadable, BadMessage) as error:
            self.unreadable[run] = str(error)
        if row["status"] != "running" and (row["is_kept"] or run in self.unreadable or self._scorer(run).k == row["k"]):
            self._scorers.pop(run, None)
            self._finished.add(run)

    def _scorer(self, run: str) -> Scorer:
        if run not in self._scorers:
            start = self.journal.start(run)
            if start is None:
                raise Unreadable("no such run")
            self._scorers[run] = Scorer(start)
        return self._scorers[run]

    def _score(self, scorer: Scorer, run: str, end: int, most: int | None) -> None:
        end = end if most is None else min(end, scorer.k + most)
        while scorer.k < end:
            until, scores = min(end, scorer.k + AT_ONCE), list[Score]()
            dwells = self.journal.dwells(run, SCORED, scorer.k, until)
            for k, messages in groupby(dwells, itemgetter(0)):
                scores += scorer.score(k, ((topic, fields(payload)) for _, topic, payload in messages))
            scorer.k = until  # in real time the last ones may be empty
            self.journal.write_temporary(_ADD, scores)

    def _forget(self, run: str) -> None:
        self._scorers.pop(run, None)
        self._finished.discard(run)
        self.unreadable.pop(run, None)
        self.journal.write_temporary("DELETE FROM temp.derived WHERE run = ?", [(run,)])


def in_memory() -> Store:
    """A store of this process, for as long as it lives."""
    return Store(Journal(MEMORY))
