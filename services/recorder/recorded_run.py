"""One run as the recorder receives it: which dwells are complete, and what a checkpoint says of it."""

from dataclasses import dataclass, field
from typing import Any

from services.recorder.run_digest import RunDigest
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
    Truth,
    Waveform,
)
from shared.protocol.recovery import Snapshot
from shared.scenario.radar_config import RadarConfig
from shared.wire.runner import TICK_S

OfDwell = Scan | Truth | Plan | Waveform
# In real time: so long after the first message of a dwell or of a later one, or a period, the rest is not waited for.
PATIENCE_S = 2.0
# Ticks without a complete dwell after which its messages are asked for again, first and then every time. A process that
# joins learns of the run by these checkpoints, too.
RESEND_FIRST, RESEND_EVERY = 2, 4


@dataclass
class _Dwell:
    """What has come of one dwell."""

    since: int  # tick of its first message
    t: int | None = None  # of its scan
    has_truth: bool = False
    has_waveform: bool = False
    plans: set[int] = field(default_factory=set)  # tracks


class RecordedRun:
    """Takes messages in any order; completes dwells in order."""

    def __init__(self, start: RunStart, k: int = 0, t: int = 0, *, resumed: bool = False) -> None:
        """A run of which dwells 0 .. k-1 are acknowledged. `resumed`: messages may have been missed meanwhile."""
        self.start = start
        self.digest = RunDigest(start.run)
        self.k = k  # dwells that are complete
        self.t = t  # clock of the last one
        self.acknowledged = (k, t)  # ... and those of the last checkpoint
        self.end: RunEnd | None = None
        self.is_closing = False  # in real time, after the end: nothing more will come
        self._radar = RadarConfig.model_validate(start.scenario["radar"])
        self._has_truth = start.scenario["world"] is not None
        self._is_real_time = start.rate_hz > 0.0
        self._patience_s = (
            max(PATIENCE_S, 1.0 / start.rate_hz) if self._is_real_time else 0.0
        )  # searches share a period
        self._is_resumed = resumed
        self._ticks = 0
        self._inactive = 0  # ticks since a dwell was completed
        self._dwells: dict[int, _Dwell] = {}  # k and later, in the order of their first messages

    @property
    def n_track(self) -> int:
        """Number of tracks."""
        return self._radar.tracks

    @property
    def n_target(self) -> int:
        """Number of targets; where nobody knows them, of tracks."""
        world = self.start.scenario["world"]
        return self.n_track if world is None else len(world["targets"])

    def check(self, message: OfDwell | Snapshot) -> None:
        """Refuse a message that does not match the run's number of dwells or of tracks."""
        check_dwell(message.k, self._radar, self.start.dwells)
        match message:
            case Snapshot():
                check_snapshot(message, self._radar)
                return
            case Plan():
                matches = message.target < self.n_track
            case Truth():
                matches = message.bins.size == self.n_target and self._has_truth
            case Scan() | Waveform():
                matches = message.beams.shape[0] == self.n_track
        if not matches:
            raise Refused(f"{type(message).__name__.lower()} does not match {self.n_track} tracks")

    def take(self, message: OfDwell) -> None:
        """Note a message of dwell k or later."""
        dwell = self._dwells.setdefault(message.k, _Dwell(self._ticks))
        match message:
            case Scan():
                dwell.t = message.t
                if self._is_real_time:
                    self._inactive = 0  # the radar goes on: to resend old dwells would only make the next ones late
            case Truth():
                dwell.has_truth = True
            case Waveform():
                dwell.has_waveform = True
            case Plan():
                dwell.plans.add(message.target)

    def is_ready(self) -> bool:
        """Whether dwell k is complete or, in real time, what is missing of it will not come any more."""
        if (dwell := self._dwells.get(self.k)) is not None and self._is_complete(dwell):
            return True
        if not self._is_real_time:
            return False
        has_ended = self.is_closing and self.end is not None and self.k <= self.end.k
        # By the clock, not by how many dwells have come since: what the recorder missed while it was away comes all at
        # once, and topic by topic.
        since = next((dwell.since for dwell in self._dwells.values() if dwell.t is not None), self._ticks)
        patience_s = self._patience_s + PATIENCE_S * self._is_resumed
        return has_ended or (self._ticks - since) * TICK_S >= patience_s

    def complete(self) -> None:
        """Dwell k is complete: go on to the next one."""
        dwell = self._dwells.pop(self.k, None)
        if dwell is not None and dwell.t is not None:
            self.t = dwell.t
        elif self.t > 0:
            self.t += 1  # the scan is missing; the targets fly on
        self.k, self._inactive = self.k + 1, 0

    @property
    def is_over(self) -> bool:
        """Whether it has ended and all of it is there, or the rest does not matter."""
        return self.end is not None and (self.k > self.end.k or self.end.status == "failed")

    def tick(self) -> None:
        """A tick has passed. In real time, some after the end, the last dwells are completed as they are."""
        self._ticks, self._inactive = self._ticks + 1, self._inactive + 1
        self.is_closing = self._is_real_time and self.end is not None and self._inactive * TICK_S >= PATIENCE_S

    @property
    def wants_resend(self) -> bool:
        """Whether messages must be asked for again: the run stands still, or a second after it was resumed.

        In real time a run does not stand still, so that only a resumption asks for what was missed.
        """
        if self._is_resumed and self._is_real_time and self._ticks * TICK_S == 1.0:
            return True
        return self._inactive == RESEND_FIRST or (self._inactive > 0 and self._inactive % RESEND_EVERY == 0)

    def checkpoint(self, *, resend: bool = False, ended: bool = False) -> list[Checkpoint]:
        """How far the run is acknowledged, for the radar's processes and for the emulator."""
        start, (k, t) = self.start, self.acknowledged
        settings: dict[str, Any] = {"run": start.run, "strategy": start.strategy, "dwells": start.dwells}
        settings |= {"rate_hz": start.rate_hz, "radar": start.scenario["radar"], "seed": radar_seed(start.seed)}
        settings |= {"k": k, "t": t, "resend": resend, "ended": ended}
        world = {"world": start.scenario["world"], "world_seed": start.seed}
        return [Checkpoint(**settings), EmulatorCheckpoint(**settings, **world)]

    def _is_complete(self, dwell: _Dwell) -> bool:
        has_truth = dwell.has_truth or not self._has_truth
        return dwell.t is not None and has_truth and dwell.has_waveform and len(dwell.plans) == self.n_track
