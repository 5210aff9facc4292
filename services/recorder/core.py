"""Metrics: hears everything, stores it, scores every target, answers queries.

It is also the run's memory: its checkpoints say how far a run is in the store, from which every process that comes late
or comes back goes on, and it recalls what nobody else keeps.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from services.delivery.pending import Early
from services.errors import CANCELLED
from services.metrics.answers import answer
from services.metrics.scores import ScoredRun
from services.recorder.journal import Store
from shared.protocol.messages import (
    MAX_HISTORY,
    Event,
    History,
    Message,
    Plan,
    Refused,
    RunCancel,
    RunEnd,
    RunStart,
    Scan,
    ScanRecall,
    Snapshot,
    Tick,
    Truth,
    Waveform,
    WaveformRecall,
)
from shared.protocol.topics import BY_MESSAGE
from shared.wire.codec import decode, encode

CHECKPOINT_DWELLS = 16  # how often a checkpoint is sent; far below what its readers keep to redeliver
RESUMED_DWELLS = 100  # in real time: how far back the newest plan of a track is looked for
_STORED = ("scan", "truth", "plan", "waveform")
RECALL_BYTES = 1 << 20  # of one History
log = logging.getLogger(__name__)


class MetricsCore:
    """Messages in, rows into the store, answers out. The store is handed in; nothing else here touches a file."""

    def __init__(self, store: Store, *, resume: bool = False) -> None:
        """With `resume`, runs that the store holds unfinished go on; else they are marked as interrupted."""
        self._store = store
        self._runs: dict[str, ScoredRun] = {}
        self._early = Early()
        self._reminded: set[str] = set()  # runs of which this tick said again that they are over
        if resume:
            for start in store.unfinished():
                self._runs[start.run] = run = self._resumed(start)
                log.info("going on with %s from dwell %d: the store holds it unfinished", start.run, run.k)
        else:
            store.give_up_unfinished()

    def handle(self, event: Event) -> Sequence[Message]:
        """Store a message and score every dwell that it completes."""
        match event:
            case RunStart():
                return self._begin(event)
            case Scan() | Truth() | Plan() | Waveform() | Snapshot():
                return self._take(event)
            case RunEnd() | RunCancel():
                return self._end(event if isinstance(event, RunEnd) else self._cancelled(event.run))
            case ScanRecall() | WaveformRecall() if self._known(event.run):
                return self._recall(event)
            case Tick():
                self._reminded.clear()
                return [said for run in list(self._runs.values()) for said in self._tick(run)]
            case _:
                pass
        return ()

    def close(self) -> None:
        """Close the store: its write-ahead log goes into the file, which is then whole by itself."""
        self._store.close()

    def answer(self, metric: str, parameters: Mapping[str, str]) -> bytes:
        """Answer a query with JSON."""
        return json.dumps(answer(self._store, metric, parameters)).encode()

    def _known(self, run: str) -> bool:
        return bool(self._store.read("SELECT 1 FROM run WHERE run = ?", [run]))

    def _begin(self, start: RunStart) -> Sequence[Message]:
        if (there := self._store.start(start.run)) is not None:
            if there != start:
                raise Refused("another run has this name")
            return ()
        run = self._runs[start.run] = ScoredRun(start)
        self._store.add_run(start, run.n_target)
        return [*run.checkpoint(), *self._early.replay(start.run, self.handle)]

    def _end(self, end: RunEnd) -> Sequence[Message]:
        if end.run in self._runs:
            self._runs[end.run].end = end
            return self._score(self._runs[end.run])
        said = self._end_again(end.run)
        if not said:
            self._early.keep(end)
        return said

    def _end_again(self, run: str) -> Sequence[Message]:
        """What was said when a run ended, which got lost; nothing if no such run is known."""
        start = self._store.start(run)
        return () if start is None else ScoredRun(start).checkpoint(ended=True)

    def _cancelled(self, run: str) -> RunEnd:
        """The end of a run as it is. One that is not known yet ends when it begins."""
        known = self._runs.get(run)
        k, t = (max(known.k - 1, 0), known.t) if known is not None else (0, 0)
        return RunEnd(run=run, k=k, t=t, status="failed", reason=CANCELLED)

    def _resumed(self, start: RunStart) -> ScoredRun:
        """A run as it was when the last process that scored it ended; the dwell scored last is scored again."""
        run = ScoredRun(start)
        run.resumed = True
        (row,) = self._store.read(
            "SELECT run.acquisition_scans AS n_scan, MIN(score.t) AS first, MAX(score.t) AS last, MAX(score.k) AS k"
            " FROM run LEFT JOIN score USING (run) WHERE run = ?",
            [start.run],
        )
        if row["n_scan"] is not None:
            run.k = row["n_scan"] - 1  # the dwell that associates tracks and targets
            if row["last"] != row["first"]:  # else the first scored dwell may have been cut short
                tracks = self._store.read(
                    "SELECT target FROM score WHERE run = ? AND t = ? ORDER BY track", [start.run, row["first"]]
                )
                run.target_of_track = np.array([track["target"] for track in tracks])
                run.k, run.t = row["k"], row["last"] - 1
        # In real time a plan may be missing, and the one before it then stands for it.
        before = RESUMED_DWELLS if start.rate_hz else 1
        for payload in self._store.messages(start.run, _STORED, from_k=max(run.k - before, 0)):
            message = decode(payload)
            if isinstance(message, Scan | Truth | Plan | Waveform):
                run.take(message)
        self._advance(run)
        return run

    def _take(self, message: Scan | Truth | Plan | Waveform | Snapshot) -> Sequence[Message]:
        if (run := self._runs.get(message.run)) is None:
            return self._take_late_or_early(message)
        run.check(message)
        if isinstance(message, Snapshot):
            self._keep(run, message)
            return ()
        item = message.target if isinstance(message, Plan) else 0
        topic, payload = BY_MESSAGE[type(message)].name, encode(message)
        if not self._store.add_message(message.run, message.k, topic, item, payload):
            if self._store.message(message.run, message.k, topic, item) != payload:
                self._store.add_conflict(message.run)
                raise Refused(f"{topic} of dwell {message.k} differs from the one that was said before")
            return ()
        run.traced.hear(message.k, topic)
        run.take(message)
        return self._score(run)

    def _take_late_or_early(self, message: Scan | Truth | Plan | Waveform | Snapshot) -> Sequence[Message]:
        """Keep a message of a run that is not known yet. Who transmits in one that is over has not heard that it is."""
        if not self._known(message.run):
            if not isinstance(message, Snapshot):
                self._early.keep(message)
            return ()
        if not isinstance(message, Scan) or message.run in self._reminded:
            return ()
        self._reminded.add(message.run)
        return self._end_again(message.run)

    def _keep(self, run: ScoredRun, snapshot: Snapshot) -> None:
        """Keep what a track was, unless a dwell up to then is incomplete: who goes on from it plans none of them."""
        if snapshot.k >= run.k:
            raise Refused(f"snapshot of dwell {snapshot.k}, the store has only those before {run.k}")
        self._store.set_snapshot(snapshot.run, snapshot.target, snapshot.k, encode(snapshot))

    def _recall(self, question: ScanRecall | WaveformRecall) -> Sequence[Message]:
        """What is asked for; of a track its snapshot, and the scans only if some track has none that helps."""
        run, first = question.run, question.k
        if isinstance(question, WaveformRecall):
            return self._history(run, "waveform", first, 1)  # allocator and planners say the later ones again
        found = [self._store.snapshot(run, target, first) for target in question.targets]
        snapshots = [History(run=run, topic="snapshot", k=k, payloads=[payload]) for k, payload in filter(None, found)]
        return [*snapshots, *(self._history(run, "scan", first, MAX_HISTORY) if None in found else ())]

    def _history(self, run: str, topic: Literal["scan", "waveform"], first: int, most: int) -> Sequence[History]:
        """Stored messages from a dwell on, as many as fit into one answer and follow each other."""
        payloads: list[bytes] = []
        rows = self._store.read(
            "SELECT k, payload FROM message WHERE run = ? AND topic = ? AND k >= ? ORDER BY k LIMIT ?",
            [run, topic, first, most],
        )
        for k, row in enumerate(rows, first):
            if row["k"] != k or sum(map(len, payloads)) > RECALL_BYTES:
                break
            payloads.append(row["payload"])
        return [History(run=run, topic=topic, k=first, payloads=payloads)] if payloads else ()

    def _score(self, run: ScoredRun) -> Sequence[Message]:
        """Score what is complete; now and then, and at the end, say how far the run is in the store."""
        self._advance(run)
        if run.end is not None and (run.k > run.end.k or run.end.status == "failed"):
            trace = "" if run.end.reason == CANCELLED else run.traced.digest(self._store)  # nobody waits for a part's
            self._store.end_run(run.end, trace)
            del self._runs[run.start.run]
            return run.checkpoint(ended=True)
        return run.checkpoint() if run.k >= run.said + CHECKPOINT_DWELLS else ()

    def _tick(self, run: ScoredRun) -> Sequence[Message]:
        run.tick()
        if run.lacks_the_past:
            return [*run.checkpoint(), *run.checkpoint()]  # one that repeats itself: the history may have been lost
        return self._score(run) if run.closing else _after_silence(run)

    def _advance(self, run: ScoredRun) -> None:
        while run.ready():
            acquiring = run.target_of_track is None
            self._store.add_scores(run.score())
            run.traced.go_on(self._store, run.k)
            if run.target_of_track is not None and (acquiring or run.t == 0):
                self._store.set_acquisition_scans(run.start.run, run.k - run.t)


def _after_silence(run: ScoredRun) -> Sequence[Message]:
    """The checkpoint again after 2, 4, 8, 16 ticks, then every 16: all others then say again what the store lacks."""
    due = run.quiet in {2, 4, 8} or run.quiet % 16 == 0
    return run.checkpoint() if due else ()
