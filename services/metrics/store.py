"""The runs of a journal with their scores. A campaign's store keeps them; of other runs they are derived from messages.

Derived scores lie in temporary tables of this process and never in the journal, which is opened read-only (or is that
of the same process). The views `score` and `picture` show both kinds. Beside a journal on a server they lie in memory,
with copies of the rows of runs that they need. So nothing is written to the server, which may be a replica, and the
same statements give the same bits. A run is scored as far as it is acknowledged, each dwell once.
Any thread may read and derive: one statement, or the scores of AT_ONCE dwells, at a time.
"""

import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import count, groupby
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import Damaged, StoreFailed
from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.scoring.scorer import SCORED, MessageFields, Scored, Scorer
from cogradar.services.recorder.journal import Journal, Unreadable
from cogradar.services.recorder.store.check import check_scores, check_whole
from cogradar.services.recorder.store.seal import LISTED, QUARANTINED, verify
from cogradar.services.recorder.store.tables import MEMORY, PICTURE_KEY, SCORE_KEY
from cogradar.shared.scoring.columns import PICTURE, SCORE, definition
from cogradar.shared.wire.codec import BadMessage, fields

NAMES_AT_ONCE = 256  # runs that are asked for in one question
AT_ONCE = 256  # dwells that are scored at a time, some 20 ms: a client that asks meanwhile waits no longer
LET_OTHERS_S = 0.0005  # after them: a lock that is taken again at once is seldom given to somebody who waits for it
KEPT, DERIVED = "main.score", "temp.derived"  # tables of scores
KEPT_TABLES = (KEPT, "main.picture")


class Store:
    """What can be read of runs; `derive` first, for those whose scores are wanted."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.scores = journal if journal.has_temporary else Journal(MEMORY)
        self._copied: set[str] = set()  # runs, from the one to the other
        self._places = count(1)  # of them
        self._lock = threading.RLock()
        self._scorers: dict[str, Scorer] = {}
        self._finished: set[str] = set()  # runs that have all their scores,
        self._kept: set[str] = set()  # ... in the journal
        self._cut_k: dict[str, int] = {}  # of runs without an end: dwells k below it have no scores any more
        self._incomplete: set[str] = set()  # runs whose scores a fault of the store cut off: they are derived anew
        self.forgotten = Counter[str]()  # how often each run was: what was known of it before holds no more
        self.unreadable: dict[str, str] = {}  # runs that cannot be scored, and why
        self._damaged: dict[str, Damaged] = {}  # likewise, since something else has changed them
        self._sound: set[str] = set()  # ended runs whose rows are as they were written
        self.newest: dict[str, Scored] = {}  # dwell of each run that goes on and is scored
        self._unsummed: dict[str, int] = {}  # runs with scores that are not in the sums yet: the first such dwell t
        self.held: set[str] = set()  # runs that wait for room on the recorder's disk
        self.heard_s: float | None = None  # when something was heard of the recorder; None: it is a file alone
        self._seen_k: dict[str, int] = {}  # ... or seen: the newest dwell of runs that go on
        self.scores.create_temporary(f"TABLE derived ({definition(SCORE, SCORE_KEY)}) WITHOUT ROWID")
        self.scores.create_temporary("VIEW score AS SELECT * FROM main.score UNION ALL SELECT * FROM temp.derived")
        self.scores.create_temporary(f"TABLE pictured ({definition(PICTURE, PICTURE_KEY)}) WITHOUT ROWID")
        self.scores.create_temporary("VIEW picture AS SELECT * FROM main.picture UNION ALL SELECT * FROM temp.pictured")
        sums.create(self.scores)

    def silent_s(self, run: str, k: int) -> float:
        """For how long the recorder has said nothing, and written no dwell k of a run that goes on."""
        now_s = time.monotonic()
        if self.heard_s is None:
            return 0.0
        if self._seen_k.setdefault(run, k) != k:
            self._seen_k[run], self.heard_s = k, now_s
        return now_s - self.heard_s

    def close(self) -> None:
        """Close the journal."""
        with self._lock:
            self.journal.close()
            self.scores.close()

    def read(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT of what is recorded, as dictionaries."""
        with self._lock:
            return self.journal.read(query, parameters)

    def stored(self, table: str, which: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Whole rows of what is recorded, without documents, each as it was written. Raises Damaged."""
        with self._lock:
            return self.journal.stored(table, which, parameters)

    def whole_row(self, run: str) -> dict[str, Any] | None:
        """The row of a run with its document, None if it is not there. Raises Damaged."""
        with self._lock:
            return self.journal.whole_row(run)

    def check_rows(self, runs: Iterable[str]) -> None:
        """Raises Damaged if the row of one of these runs is not as it was written; of an ended run once."""
        for error in self.damaged_rows(runs).values():
            raise error

    def damaged_rows(self, runs: Iterable[str]) -> dict[str, Damaged]:
        """Which of these runs have a row that is not as it was written, and are not set aside for it."""
        found, names = dict[str, Damaged](), [name for name in runs if name not in self._sound]
        for at in range(0, len(names), NAMES_AT_ONCE):
            some = names[at : at + NAMES_AT_ONCE]
            which = f"WHERE run IN ({','.join('?' * len(some))}) AND status <> ? ORDER BY place"
            for row in self.read(f"SELECT {LISTED['run']} FROM run {which}", [*some, QUARANTINED]):
                try:
                    verify(self.journal.path, "run", row)
                    self._sound |= {row["run"]} if row["ended_s"] else set()
                except Damaged as error:
                    found[row["run"]] = error
        return found

    def damaged_scores(self, runs: Iterable[str]) -> dict[str, Damaged]:
        """Which of these runs have something damaged among what was scored."""
        return {run: self._damaged[run] for run in runs if run in self._damaged}

    def damage(self, runs: Iterable[str]) -> None:
        """Raises Damaged if what was scored of one of these runs is damaged."""
        for error in self.damaged_scores(runs).values():
            raise error

    def scored(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT of the scores of runs that were derived, and of these runs' own rows without documents."""
        with self._lock:
            return self.scores.read(query, parameters)

    def summed(self, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Rows of a SELECT of `sums`, over all that is scored."""
        with self._lock:
            for run in list(self._unsummed):
                self._sum(run)
            return self.scored(query, parameters)

    def all_scores(self, run: str) -> list[dict[str, Any]]:
        """The scores that a campaign has kept of a run; of another run those that were derived."""
        kept = self.read("SELECT * FROM main.score WHERE run = ? ORDER BY t, target", [run])
        return kept or self.scored("SELECT * FROM temp.derived WHERE run = ? ORDER BY t, target", [run])

    def numbers(self, query: str, parameters: Sequence[Any] = ()) -> NDArray[np.float64]:
        """Columns of such a SELECT of numbers, (columns, rows); NaN for NULL."""
        with self._lock:
            rows = self.scores.rows(query, parameters)
        return np.array([tuple(row) for row in rows], dtype=np.float64).T

    def table(self, run: str) -> str:
        """The table with the scores of a run that was derived: to read it is faster than to read the view of both."""
        return KEPT if run in self._kept else DERIVED

    def messages(self, run: str, topics: Sequence[str], first: int, last: int) -> list[tuple[int, str, bytes]]:
        """Dwell, topic and payload of the messages of these dwells k, in the order of dwell, topic and item."""
        with self._lock:
            return list(self.journal.dwells(run, topics, first, last + 1))

    def dwell(self, run: str, k: int, topics: Sequence[str] = SCORED) -> dict[str, list[MessageFields]]:
        """Fields of the messages of a dwell, by topic, in the order of their items. Raises BadMessage."""
        found: dict[str, list[MessageFields]] = {topic: [] for topic in topics}
        for _, topic, payload in self.messages(run, topics, k, k):
            found[topic].append(fields(payload))
        return found

    def derive(self, runs: Iterable[str] | None = None, most: int | None = None) -> bool:
        """Score what is acknowledged of these runs, or of all; `most` dwells of each, the others next time.

        Returns whether nothing is left to do. Raises Damaged for runs that are named, unless they are set aside: scores
        of a part of what was recorded would be wrong without a sign of it.
        """
        names = [row["run"] for row in self.read("SELECT run FROM run")] if runs is None else list(runs)
        is_done = True
        for run in names:
            n = 0
            while run not in self._finished and (most is None or n < most):
                with self._lock:
                    is_up_to_date = self._derive(run, AT_ONCE if most is None else min(AT_ONCE, most - n))
                if is_up_to_date:
                    break
                n += AT_ONCE
                time.sleep(LET_OTHERS_S)
            else:
                is_done = is_done and run in self._finished
        if runs is not None and most is None:
            self.damage(names)
        return is_done

    def derive_to(self, run: str, k: int) -> None:
        """Score a run up to its dwell k, or as far as it is."""
        while run not in self._finished:
            with self._lock:
                scored_k = self._scorers[run].k if run in self._scorers else 0
                if self._derive(run, min(max(k + 1 - scored_k, 0), AT_ONCE)) or self._scorers[run].k > k:
                    return
            time.sleep(LET_OTHERS_S)

    def forget_dropped(self) -> None:
        """Forget the runs that are no longer in the journal."""
        with self._lock:
            runs = {row["run"] for row in self.read("SELECT run FROM run")}
            for run in (self._finished | self._scorers.keys()) - runs:
                self._forget(run)

    def _derive(self, run: str, most: int) -> bool:
        """Score some dwells of a run; true if nothing is left to do."""
        if run in self._damaged:  # to score it again would end where it ended before
            return True
        status = ""
        try:
            for row in self.stored("run", "WHERE run = ?", [run]):
                status = row["status"]
                return self._derive_from(row, most)
        except Damaged as error:
            if not self.read("SELECT 1 FROM run WHERE run = ?", [run]):
                return True  # it was dropped meanwhile
            self.unreadable[run] = str(error)
            if status != QUARANTINED:
                self._damaged[run] = error
        return True

    def _derive_from(self, row: dict[str, Any], most: int) -> bool:
        run, k, is_kept = row["run"], row["acknowledged_k"], row["scores_checksum"] is not None
        is_rewound = run in self._scorers and self._scorers[run].k > k  # the journal was restored
        if is_rewound or run in self._incomplete:
            self._forget(run)
        if not self._copy(run, with_scores=is_kept):
            return True
        if is_kept:
            check_scores(self.journal, run)
            sums.add(self.scores, KEPT, run, 0)
            self._finished.add(run)
            self._kept.add(run)
            return True
        try:
            scorer = self._scorer(run)
            if row["kept_k"] > self._cut_k.get(run, 0):
                self._cut(run, row["n_target"], row["kept_k"])
                scorer.k = max(scorer.k, row["kept_k"])
            self._score(scorer, run, min(k, scorer.k + most))
            if scorer.k < k:
                return False
            if row["status"] not in {"running", QUARANTINED}:
                check_whole(self.journal, run)
        except (Unreadable, BadMessage) as error:
            self.unreadable[run] = str(error)
        except StoreFailed:  # also what is damaged: another file may be put in its place
            self._incomplete.add(run)
            raise
        if row["status"] != "running":
            self._scorers.pop(run, None)
            self.newest.pop(run, None)
            self._finished.add(run)
        return True

    def _copy(self, run: str, *, with_scores: bool) -> bool:
        """Copy the rows of a run that its scores need to where these are, once; false if it was dropped meanwhile."""
        if self.scores is self.journal or run in self._copied:
            return True
        rows = self.journal.read("SELECT * FROM run WHERE run = ?", [run])
        if not rows:
            return False
        (row,) = rows
        self._remove_copy(run)
        # A place may be another run's by now: here it means nothing.
        self.scores.add_rows("run", [row | {"document": "", "place": next(self._places)}])
        if with_scores:
            of_run = "WHERE run = ? ORDER BY t"
            self.scores.add_scores(
                *(self.journal.read(f"SELECT * FROM {name} {of_run}", [run]) for name in KEPT_TABLES)
            )
        self.scores.commit()
        self._copied.add(run)
        return True

    def _remove_copy(self, run: str) -> None:
        for table in ("run", *KEPT_TABLES):
            self.scores.write(f"DELETE FROM {table} WHERE run = ?", run)

    def _scorer(self, run: str) -> Scorer:
        if run not in self._scorers:
            start = self.journal.start(run)
            if start is None:
                raise Unreadable("no such run")
            self._scorers[run] = Scorer(start)
        return self._scorers[run]

    def _score(self, scorer: Scorer, run: str, end: int) -> None:
        found = list[Scored]()
        for k, messages in groupby(self.journal.dwells(run, SCORED, scorer.k, end), itemgetter(0)):
            scored = scorer.score(k, ((topic, fields(payload)) for _, topic, payload in messages))
            found += [scored] if scored is not None else []
        scorer.k = end  # in real time the last ones may be empty
        if found:
            self.newest[run] = found[-1]
            self.scores.add_temporary(DERIVED, [score for scored in found for score in scored.targets])
            self.scores.add_temporary("temp.pictured", [scored.picture for scored in found])
            first = min(scored.t for scored in found)
            first = self._unsummed[run] = min(first, self._unsummed.get(run, first))
            # Or when somebody asks: with each dwell of a run a block would be summed sixteen times.
            if found[-1].t // sums.DWELLS > first // sums.DWELLS:
                self._sum(run)

    def _sum(self, run: str) -> None:
        sums.add(self.scores, DERIVED, run, self._unsummed[run])
        del self._unsummed[run]

    def _cut(self, run: str, targets: int, before_k: int) -> None:
        """Forget the scores of the dwells that the journal has cut, by whole blocks of sums."""
        self._cut_k[run] = before_k
        rows = self.scored("SELECT t FROM temp.pictured WHERE run = ? AND k >= ? ORDER BY t LIMIT 1", [run, before_k])
        for row in rows:
            block_t = row["t"] // sums.DWELLS * sums.DWELLS
            self.scores.write_temporary("DELETE FROM temp.derived WHERE run = ? AND t < ?", [(run, block_t)])
            self.scores.write_temporary("DELETE FROM temp.pictured WHERE run = ? AND t < ?", [(run, block_t)])
            sums.cut(self.scores, run, targets, block_t)

    def _forget(self, run: str) -> None:
        self.forgotten[run] += 1
        self._scorers.pop(run, None)
        self.newest.pop(run, None)
        self._unsummed.pop(run, None)
        self._finished.discard(run)
        self._kept.discard(run)
        self._cut_k.pop(run, None)
        self.unreadable.pop(run, None)
        self._damaged.pop(run, None)
        self.held.discard(run)
        self._seen_k.pop(run, None)
        self.scores.write_temporary("DELETE FROM temp.derived WHERE run = ?", [(run,)])
        self.scores.write_temporary("DELETE FROM temp.pictured WHERE run = ?", [(run,)])
        sums.remove(self.scores, run)
        if run in self._copied:
            self._copied.discard(run)
            self._remove_copy(run)
            self.scores.commit()
        self._incomplete.discard(run)


def in_memory() -> Store:
    """A store of this process, for as long as it lives."""
    return Store(Journal(MEMORY))
