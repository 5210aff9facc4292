"""Metrics: hears everything, stores it, scores every target, answers queries."""

import json
import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.answers import answer
from services.store import Score, State, Store
from shared.detection import threshold
from shared.messages import Event, Message, Plan, Refused, RunEnd, RunStart, Scan, Truth, Waveform
from shared.scenario import Scenario
from shared.scoring import associate
from shared.topics import BY_MESSAGE
from shared.wire.codec import decode, encode
from shared.wire.trace import DIGESTED, digest

log = logging.getLogger(__name__)

MAX_EARLY = 1000  # messages kept of runs whose start has not been heard yet


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
        self.run = start.run
        self.scenario = Scenario.model_validate(start.scenario)
        self.threshold = threshold(self.scenario.detector.p_fa)
        self.dwells: defaultdict[int, _Dwell] = defaultdict(_Dwell)
        self.k = 0  # next dwell to score
        self.target_of_track: NDArray[np.int64] | None = None
        self.end: RunEnd | None = None

    def ready(self) -> bool:
        """Whether dwell k is complete: its waveform comes last, and dwell k-1's waveform says how power was split."""
        dwell = self.dwells[self.k]
        heard = dwell.scan is not None and dwell.truth is not None and dwell.waveform is not None
        return heard and len(dwell.plans) == self.scenario.n_target


class MetricsCore:
    """Messages in, rows into the store, answers out. The store is handed in; nothing else here touches a file."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._runs: dict[str, _Run] = {}
        self._early: list[Message] = []

    def handle(self, event: Event) -> Sequence[Message]:
        """Store a message and score every dwell that it completes."""
        match event:
            case RunStart():
                self._begin(event)
            case Scan() | Truth() | Plan() | Waveform() if event.run in self._runs:
                self._take(self._runs[event.run], event)
            case RunEnd() if event.run in self._runs:
                self._runs[event.run].end = event
                self._score(self._runs[event.run])
            case Scan() | Truth() | Plan() | Waveform() | RunEnd() if not self._known(event.run):
                self._early = [*self._early, event][-MAX_EARLY:]
            case _:
                pass
        return ()

    def answer(self, metric: str, parameters: Mapping[str, str]) -> bytes:
        """Answer a query with JSON."""
        return json.dumps(answer(self._store, metric, parameters)).encode()

    def _known(self, run: str) -> bool:
        return bool(self._store.read("SELECT 1 FROM run WHERE run = ?", [run]))

    def _begin(self, start: RunStart) -> None:
        if self._known(start.run):
            return
        run = _Run(start)
        self._runs[start.run] = run
        self._store.add_run(start, run.scenario.n_target)
        early, self._early = self._early, []
        for message in early:
            try:
                self.handle(message)
            except Refused as refusal:  # must not take the start with it
                log.warning("dropping an early message of %s: %s", message.run, refusal)

    def _take(self, run: _Run, message: Scan | Truth | Plan | Waveform) -> None:
        _check(run.scenario, message)
        item = message.target if isinstance(message, Plan) else 0
        topic = BY_MESSAGE[type(message)].name
        if self._store.add_message(message.run, message.k, topic, item, encode(message)) and message.k >= run.k:
            run.dwells[message.k].take(message)
            self._score(run)

    def _score(self, run: _Run) -> None:
        while run.ready():
            dwell, before = run.dwells[run.k], run.dwells.get(run.k - 1)
            self._score_dwell(run, dwell, before.waveform if before else None)
            run.dwells.pop(run.k - 1, None)
            run.k += 1
        if run.end is not None and (run.k > run.end.k or run.end.status == "failed"):
            trace = digest(decode(payload) for payload in self._store.messages(run.run, DIGESTED))
            self._store.end_run(run.end, trace)
            del self._runs[run.run]

    def _score_dwell(self, run: _Run, dwell: _Dwell, sent: Waveform | None) -> None:
        scan, truth, plans = dwell.scan, dwell.truth, dwell.plans
        if scan is None or truth is None or plans[0].status != "tracking":
            return
        if run.target_of_track is None:
            estimates = np.array([plans[m].estimate for m in sorted(plans)])
            run.target_of_track = associate(estimates, truth.states)
            self._store.set_acquisition_scans(run.run, scan.k + 1)
            return  # this dwell still belongs to the acquisition: t = 0
        shares = sent.shares if sent is not None else np.zeros(len(plans))
        detected_bins = set(scan.bins[scan.statistic >= run.threshold].tolist())
        self._store.add_scores(
            [
                Score(
                    run=run.run,
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
