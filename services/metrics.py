"""Metrics: hears everything, stores it, scores every target, answers queries.

It is also the run's memory: its checkpoints say how far a run is in the store, from which every process that comes late
or comes back goes on, and it recalls what nobody else keeps.
"""

import json
import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.answers import answer
from services.early import Early
from services.store import Score, State, Store
from shared.detection import threshold
from shared.messages import (
    MAX_HISTORY,
    Checkpoint,
    Event,
    History,
    Message,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    ScanRecall,
    Tick,
    Truth,
    Waveform,
    WaveformRecall,
)
from shared.scenario import Scenario
from shared.scoring import associate
from shared.topics import BY_MESSAGE
from shared.wire.codec import decode, encode
from shared.wire.trace import DIGESTED, digest

CHECKPOINT_DWELLS = 16  # how often a run's checkpoint is said; far below what publishers keep
_STORED = ("scan", "truth", "plan", "waveform")
RECALL_BYTES = 1 << 20  # of one History
log = logging.getLogger(__name__)


@dataclass
class _Dwell:
    """What has been heard of one dwell."""

    scan: Scan | None = None
    truth: Truth | None = None
    waveform: Waveform | None = None
    plans: dict[int, Plan] = field(default_factory=dict)

    def take(self, message: Message) -> None:
        match message:
            case Scan():
                self.scan = message
            case Truth():
                self.truth = message
            case Waveform():
                self.waveform = message
            case Plan():
                self.plans[message.target] = message


class _Run:
    """One run being scored: dwells that are still incomplete, and which track follows which target."""

    def __init__(self, start: RunStart) -> None:
        self.start = start
        self.scenario = Scenario.model_validate(start.scenario)
        self.threshold = threshold(self.scenario.detector.p_fa)
        self.dwells: defaultdict[int, _Dwell] = defaultdict(_Dwell)
        self.k = 0  # next dwell to score
        self.t = 0  # clock of the one before
        self.said = -1  # dwell of the checkpoint that was said last
        self.quiet = 0  # ticks since a dwell was completed
        self.target_of_track: NDArray[np.int64] | None = None
        self.end: RunEnd | None = None

    def ready(self) -> bool:
        """Whether dwell k is complete: its waveform comes last, and dwell k-1's waveform says how power was split."""
        dwell = self.dwells[self.k]
        heard = dwell.scan is not None and dwell.truth is not None and dwell.waveform is not None
        return heard and len(dwell.plans) == self.scenario.n_target

    def checkpoint(self, *, ended: bool = False) -> Checkpoint:
        """How far the run is in the store."""
        self.said = self.k
        start = {name: getattr(self.start, name) for name in RunStart.model_fields}
        return Checkpoint(**start, k=self.k, t=self.t, ended=ended)


class MetricsCore:
    """Messages in, rows into the store, answers out. The store is handed in; nothing else here touches a file."""

    def __init__(self, store: Store, *, resume: bool = False) -> None:
        """With `resume`, runs that the store holds unfinished go on; else they are marked as interrupted."""
        self._store = store
        self._runs: dict[str, _Run] = {}
        self._early = Early()
        if resume:
            self._runs = {start.run: self._resumed(start) for start in store.unfinished()}
        else:
            store.give_up_unfinished()

    def handle(self, event: Event) -> Sequence[Message]:
        """Store a message and score every dwell that it completes."""
        match event:
            case RunStart():
                return self._begin(event)
            case Scan() | Truth() | Plan() | Waveform() if event.run in self._runs:
                return self._take(self._runs[event.run], event)
            case RunEnd():
                return self._end(event)
            case Scan() | Truth() | Plan() | Waveform() if not self._known(event.run):
                self._early.keep(event)
            case ScanRecall() | WaveformRecall() if self._known(event.run):
                return self._recall(event)
            case Tick():
                return [checkpoint for run in self._runs.values() for checkpoint in _after_silence(run)]
            case _:
                pass
        return ()

    def answer(self, metric: str, parameters: Mapping[str, str]) -> bytes:
        """Answer a query with JSON."""
        return json.dumps(answer(self._store, metric, parameters)).encode()

    def _known(self, run: str) -> bool:
        return bool(self._store.read("SELECT 1 FROM run WHERE run = ?", [run]))

    def _begin(self, start: RunStart) -> Sequence[Message]:
        if self._known(start.run):
            return ()
        run = self._runs[start.run] = _Run(start)
        self._store.add_run(start, run.scenario.n_target)
        return [run.checkpoint(), *self._early.replay(start.run, self.handle)]

    def _end(self, end: RunEnd) -> Sequence[Message]:
        if end.run in self._runs:
            self._runs[end.run].end = end
            return self._score(self._runs[end.run])
        start = self._store.start(end.run)
        if start is None:
            self._early.keep(end)
            return ()
        return (_Run(start).checkpoint(ended=True),)  # that was said when the run ended got lost

    def _resumed(self, start: RunStart) -> _Run:
        """A run as it was when the last process that scored it ended; the dwell scored last is scored again."""
        run = _Run(start)
        (row,) = self._store.read(
            "SELECT run.acquisition_scans, MAX(score.t) AS t FROM run LEFT JOIN score USING (run) WHERE run = ?",
            [start.run],
        )
        if row["acquisition_scans"] is not None:
            run.k = row["acquisition_scans"] - 1  # dwell of clock 0, which associates tracks and targets
            if row["t"] is not None and row["t"] > 1:
                tracks = self._store.read(
                    "SELECT target FROM score WHERE run = ? AND t = 1 ORDER BY track", [start.run]
                )
                run.target_of_track = np.array([track["target"] for track in tracks])
                run.k, run.t = run.k + row["t"], row["t"] - 1
        for payload in self._store.messages(start.run, _STORED, from_k=max(run.k - 1, 0)):
            message = decode(payload)
            if isinstance(message, Scan | Truth | Plan | Waveform):
                run.dwells[message.k].take(message)
        self._advance(run)
        return run

    def _take(self, run: _Run, message: Scan | Truth | Plan | Waveform) -> Sequence[Message]:
        _check(run.scenario, message)
        item = message.target if isinstance(message, Plan) else 0
        topic, payload = BY_MESSAGE[type(message)].name, encode(message)
        if not self._store.add_message(message.run, message.k, topic, item, payload):
            if self._store.message(message.run, message.k, topic, item) != payload:
                raise Refused(f"{topic} of dwell {message.k} differs from the one that was said before")
            return ()
        if message.k >= run.k:
            run.dwells[message.k].take(message)
        return self._score(run)

    def _recall(self, question: ScanRecall | WaveformRecall) -> Sequence[Message]:
        """Stored messages from a dwell on, as many as fit into one answer and follow each other."""
        topic: Literal["scan", "waveform"] = "scan" if isinstance(question, ScanRecall) else "waveform"
        payloads: list[bytes] = []
        rows = self._store.read(
            "SELECT k, payload FROM message WHERE run = ? AND topic = ? AND k >= ? ORDER BY k LIMIT ?",
            [question.run, topic, question.k, MAX_HISTORY],
        )
        for k, row in enumerate(rows, question.k):
            if row["k"] != k or sum(map(len, payloads)) > RECALL_BYTES:
                break
            payloads.append(row["payload"])
        return [History(run=question.run, topic=topic, k=question.k, payloads=payloads)] if payloads else ()

    def _score(self, run: _Run) -> Sequence[Message]:
        """Score what is complete; now and then, and at the end, say how far the run is in the store."""
        self._advance(run)
        if run.end is not None and (run.k > run.end.k or run.end.status == "failed"):
            trace = digest(decode(payload) for payload in self._store.messages(run.start.run, DIGESTED))
            self._store.end_run(run.end, trace)
            del self._runs[run.start.run]
            return (run.checkpoint(ended=True),)
        return (run.checkpoint(),) if run.k >= run.said + CHECKPOINT_DWELLS else ()

    def _advance(self, run: _Run) -> None:
        while run.ready():
            dwell, before = run.dwells[run.k], run.dwells.get(run.k - 1)
            self._score_dwell(run, dwell, before.waveform if before else None)
            run.dwells.pop(run.k - 1, None)
            run.t = dwell.scan.t if dwell.scan is not None else run.t
            run.k += 1
            run.quiet = 0

    def _score_dwell(self, run: _Run, dwell: _Dwell, sent: Waveform | None) -> None:
        scan, truth, plans = dwell.scan, dwell.truth, dwell.plans
        if scan is None or truth is None or plans[0].status != "tracking":
            return
        if run.target_of_track is None:
            estimates = np.array([plans[m].estimate for m in sorted(plans)])
            run.target_of_track = associate(estimates, truth.states)
            self._store.set_acquisition_scans(run.start.run, scan.k + 1)
            return  # this dwell still belongs to the acquisition: t = 0
        shares = sent.shares if sent is not None else np.zeros(len(plans))
        detected_bins = set(scan.bins[scan.statistic >= run.threshold].tolist())
        self._store.add_scores(
            [
                Score(
                    run=run.start.run,
                    t=scan.t,
                    target=int(target),
                    track=track,
                    true_bin=int(truth.bins[target]),
                    bin=int(scan.beams[track]),
                    detected=int(truth.bins[target]) in detected_bins,
                    snr_db=float(truth.snr_db[target]),
                    state=State(*truth.states[target].tolist()),
                    estimate=State(*plans[track].estimate.tolist()),
                    share=float(shares[track]),
                )
                for track, target in enumerate(run.target_of_track)
            ]
        )


def _after_silence(run: _Run) -> Sequence[Message]:
    """The checkpoint again after 2, 4, 8, 16 ticks, then every 16: all others then say again what the store lacks."""
    run.quiet += 1
    due = run.quiet in {2, 4, 8} or run.quiet % 16 == 0
    return (run.checkpoint(),) if due else ()


def _check(scenario: Scenario, message: Scan | Truth | Plan | Waveform) -> None:
    """Refuse what does not fit the run's number of targets."""
    match message:
        case Plan():
            fits = message.target < scenario.n_target
        case Truth():
            fits = message.bins.size == scenario.n_target
        case Scan() | Waveform():
            fits = message.beams.size == scenario.n_target
    if not fits:
        raise Refused(f"{type(message).__name__.lower()} does not fit {scenario.n_target} targets")
