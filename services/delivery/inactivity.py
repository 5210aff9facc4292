"""Runs that a worker is to forget: no message comes of them any more, or another process serves their shards. The next
checkpoint begins such a run again, here or there.
"""

from collections.abc import Iterable

from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.pacing import pacing_at
from cogradar.shared.protocol.events import Event, Rewind, Shards, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Refused
from cogradar.shared.protocol.topics import ALL_SHARDS, shard_of
from cogradar.shared.scenario.radar_config import RadarConfig

FORGET_S = 600.0  # the recorder repeats the checkpoint of a run that stands still
MOST_S = 86_400.0  # ... and a run in real time, however slow, at least once a day
MAX_RUNS = 4096  # known at a time
STEP_S = 1.0  # most that one tick counts: a process that was frozen has messages waiting


class Inactivity:
    """How long each run has been inactive, by the ticks; a run is known from its first checkpoint to its last.

    A process that is alone serves all shards; of a pool it is told which.
    """

    def __init__(self) -> None:
        self._inactive_s: dict[str, float] = {}
        self._limit_s: dict[str, float] = {}
        self._now_s = 0.0
        self._held = ALL_SHARDS

    @property
    def busy(self) -> frozenset[int]:
        """Shards with runs."""
        return frozenset(map(shard_of, self._inactive_s))

    def is_elsewhere(self, event: Event) -> bool:
        """Whether an event is a message of a run that another process serves."""
        return self._held is not ALL_SHARDS and isinstance(event, Message) and shard_of(event.run) not in self._held

    def after(self, event: Event) -> list[str]:
        """Note an event; the runs to be forgotten now. Raises Refused for one run more than there can be."""
        match event:
            case Shards():
                return self._serve(event.held)
            case Rewind():
                self._forget(event.run)
                return [event.run]
            case _ if self.is_elsewhere(event):
                pass
            case Checkpoint(ended=True):
                self._forget(event.run)
            case Checkpoint() if event.run not in self._inactive_s:
                if len(self._inactive_s) >= MAX_RUNS:
                    raise Refused(f"{MAX_RUNS} runs are known, which is all there can be at a time")
                self._inactive_s[event.run], self._limit_s[event.run] = 0.0, _limit_s(event)
            case Message():
                self.note((event,))
            case Tick():
                return self._tick(event.now_s)
            case _:
                pass
        return []

    def validate(self, runs: Iterable[str]) -> None:
        """All of these runs would be forgotten one day. Raises BrokenInvariant."""
        unknown = set(runs) - self._inactive_s.keys()
        require(not unknown, f"{', '.join(sorted(unknown))} would never be forgotten")

    def note(self, messages: Iterable[Message]) -> None:
        """The runs of these messages are active."""
        for message in messages:
            if message.run in self._inactive_s:
                self._inactive_s[message.run] = 0.0

    def _serve(self, shards: frozenset[int]) -> list[str]:
        self._held = shards
        lost = [run for run in self._inactive_s if shard_of(run) not in shards]
        for run in lost:
            self._forget(run)
        return lost

    def _tick(self, now_s: float) -> list[str]:
        step, self._now_s = min(now_s - self._now_s, STEP_S), now_s
        over = []
        for run in self._inactive_s:
            self._inactive_s[run] += step
            if self._inactive_s[run] > self._limit_s[run]:
                over.append(run)
        for run in over:
            self._forget(run)
        return over

    def _forget(self, run: str) -> None:
        self._inactive_s.pop(run, None)
        self._limit_s.pop(run, None)


def _limit_s(start: Checkpoint) -> float:
    """In real time as long as the run takes besides: its dwells may be far apart, and the recorder may be away."""
    scans = RadarConfig.model_validate(start.radar).acquisition.max_scans
    return FORGET_S + min(pacing_at(start.rate_hz).seconds(scans + start.dwells), MOST_S)
