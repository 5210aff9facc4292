"""One run as metrics hears it: dwells that are still incomplete, and how each target fared in those that are not."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.recorder.journal import Score, State
from services.recorder.run_digest import Traced
from shared.numerics.seeds import radar_seed
from shared.protocol.admission import check_dwell, check_snapshot
from shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    Snapshot,
    Truth,
    Waveform,
)
from shared.scenario.scenario import Scenario
from shared.scoring.matching import associate
from shared.signal.receiver import threshold
from shared.wire.runner import TICK_S

Said = Scan | Truth | Plan | Waveform
# In real time: so long after a dwell, or a later one, was heard of, or a period, nobody waits for the rest of it.
PATIENCE_S = 2.0


@dataclass
class _Dwell:
    """What has been heard of one dwell."""

    since: int  # tick at which it was first heard of
    scan: Scan | None = None
    truth: Truth | None = None
    waveform: Waveform | None = None
    plans: dict[int, Plan] = field(default_factory=dict)

    def is_complete(self, n_target: int) -> bool:
        """Whether everything has been heard of it."""
        missing = self.scan is None or self.truth is None or self.waveform is None
        return not missing and len(self.plans) == n_target


class ScoredRun:
    """Takes messages in any order; gives scores dwell by dwell, in order."""

    def __init__(self, start: RunStart) -> None:
        self.start = start
        self.traced = Traced(start.run)
        self.k = 0  # next dwell to score
        self.t = 0  # clock of the one before
        self.said = -1  # dwell of the checkpoint that was said last
        self.quiet = 0  # ticks since a dwell was scored
        self.target_of_track: NDArray[np.int64] | None = None  # from the end of the acquisition on
        self.end: RunEnd | None = None
        self.closing = False  # in real time, after the end: nothing more will come
        self._scenario = Scenario.model_validate(start.scenario)
        self._threshold = threshold(self._scenario.radar.detector.p_fa)
        self._is_real_time = start.rate_hz > 0.0
        self._patience_s = (
            max(PATIENCE_S, 1.0 / start.rate_hz) if self._is_real_time else 0.0
        )  # searches share a period
        self._ticks = 0
        self.resumed = False  # by a metrics service that was away: what it missed is on its way
        self._dwells: dict[int, _Dwell] = {}  # k and later, in the order in which they were heard of
        self._waveforms: dict[int, Waveform] = {}  # radiated in dwell k or later
        self._plans: dict[int, Plan] = {}  # newest of each track up to dwell k

    @property
    def n_target(self) -> int:
        """Number of targets, and of tracks."""
        return self._scenario.radar.tracks

    def take(self, message: Said) -> None:
        """Hear a message. Of dwells that are scored already only what outlives them counts: plans and waveforms."""
        if message.k < self.k:
            if isinstance(message, Plan):
                known = self._plans.get(message.target, message)
                self._plans[message.target] = message if message.k >= known.k else known
            elif isinstance(message, Waveform):
                self._waveforms[message.k] = message
            return
        dwell = self._dwells.setdefault(message.k, _Dwell(self._ticks))
        match message:
            case Scan():
                dwell.scan = message
                if self._is_real_time:
                    self.quiet = 0  # the radar goes on: to say old dwells again would only make the next ones late
            case Truth():
                dwell.truth = message
            case Waveform():
                dwell.waveform = self._waveforms[message.k] = message
            case Plan():
                dwell.plans[message.target] = message

    def ready(self) -> bool:
        """Whether dwell k can be scored: it is complete, or, in real time, what is missing will not come any more."""
        dwell = self._dwells.get(self.k)
        if dwell is not None and dwell.is_complete(self.n_target):
            return True
        if not self._is_real_time:
            return False
        over = self.closing and self.end is not None and self.k <= self.end.k
        # By the clock, not by how many dwells have come since: what metrics missed while it was away comes all at once,
        # and topic by topic.
        since = next((dwell.since for dwell in self._dwells.values() if dwell.scan is not None), self._ticks)
        patience_s = self._patience_s + PATIENCE_S * self.resumed
        return over or (self._ticks - since) * TICK_S >= patience_s

    def tick(self) -> None:
        """A tick has passed. In real time, some after the end, the last dwells are scored as they are."""
        self._ticks, self.quiet = self._ticks + 1, self.quiet + 1
        self.closing = self._is_real_time and self.end is not None and self.quiet * TICK_S >= PATIENCE_S

    @property
    def lacks_the_past(self) -> bool:
        """Once, a second after a resumption in real time, which nobody would otherwise ask to say things again."""
        return self.resumed and self._is_real_time and self._ticks * TICK_S == 1.0

    def score(self) -> list[Score]:
        """Scores of dwell k, none while targets are acquired; goes on to the next dwell."""
        dwell = self._dwells.pop(self.k, None) or _Dwell(self._ticks)
        self._plans |= dwell.plans
        self.k, self.quiet = self.k + 1, 0
        if dwell.scan is None or dwell.truth is None:
            self.t += self.t > 0  # the targets fly on
            return []
        self.t = dwell.scan.t
        sent = self._waveforms.get(dwell.truth.waveform_k)
        self._waveforms = {k: waveform for k, waveform in self._waveforms.items() if k >= dwell.truth.waveform_k}
        plans = [plan for _, plan in sorted(self._plans.items()) if plan.status == "tracking"]
        if len(plans) < self.n_target:
            return []
        if self.target_of_track is None:  # the last dwell of the acquisition, t = 0
            self.target_of_track = associate(np.array([plan.estimate for plan in plans]), dwell.truth.states)
            return []
        if dwell.scan.t == 0:  # in real time: the first tracking waveform came too late for this dwell
            return []
        return self._scores(dwell.scan, dwell.truth, plans, sent, self.target_of_track)

    def _scores(
        self, scan: Scan, truth: Truth, plans: list[Plan], sent: Waveform | None, targets: NDArray[np.int64]
    ) -> list[Score]:
        detected_bins = set(scan.bins[scan.statistic >= self._threshold].tolist())
        return [
            Score(
                run=self.start.run,
                k=scan.k,
                t=scan.t,
                target=int(target),
                track=track,
                true_bin=int(truth.bins[target]),
                bin=int(scan.beams[track]),
                detected=int(truth.bins[target]) in detected_bins,
                snr_db=float(truth.snr_db[target]),
                state=State(*truth.states[target].tolist()),
                estimate=State(*plans[track].estimate.tolist()),
                share=float(sent.shares[track]) if sent is not None else 0.0,
                late=bool(sent.late[track]) if sent is not None else False,
                stale=truth.waveform_k != scan.k - 1,
            )
            for track, target in enumerate(targets)
        ]

    def checkpoint(self, *, ended: bool = False) -> list[Checkpoint]:
        """How far the run is in the store, for the radar's processes and for the emulator."""
        self.said = self.k
        start = self.start
        settings: dict[str, Any] = {"run": start.run, "strategy": start.strategy, "dwells": start.dwells}
        settings |= {"rate_hz": start.rate_hz, "radar": start.scenario["radar"], "seed": radar_seed(start.seed)}
        settings |= {"k": self.k, "t": self.t, "ended": ended}
        world = {"world": start.scenario["world"], "world_seed": start.seed}
        return [Checkpoint(**settings), EmulatorCheckpoint(**settings, **world)]

    def check(self, message: Said | Snapshot) -> None:
        """Refuse what does not fit the run's number of dwells, of targets, or its tracks."""
        check_dwell(message.k, self._scenario.radar, self.start.dwells)
        match message:
            case Snapshot():
                check_snapshot(message, self._scenario.radar)
                return
            case Plan():
                fits = message.target < self.n_target
            case Truth():
                fits = message.bins.size == self.n_target
            case Scan() | Waveform():
                fits = message.beams.size == self.n_target
        if not fits:
            raise Refused(f"{type(message).__name__.lower()} does not fit {self.n_target} targets")
