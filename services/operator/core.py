"""Operator: begins one run after the other, seed after seed, so that services that are up track without being asked.

It keeps nothing. An operator that comes back begins with the first seed again, and the run of the one before it ends
by itself after its last dwell. A run without an end outlives its operator: one that comes back listens first, and
takes the run that goes on for its own. It listens from the moment at which a recorder is there: one that is restarted,
too, may be reading its journal.
"""

from collections.abc import Callable, Sequence

from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, RunCancel, RunStart
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario

RESEND_TICKS = 8  # without a checkpoint of the run: its start was lost, or its end, or the journal that held it
LISTEN_TICKS = 12  # before the first run: one that goes on has a checkpoint each second at least
ASK_TICKS = 4  # from one question whether a recorder is there to the next
GONE_TICKS = 240  # without a checkpoint of a run that was found: a minute, in which a recorder may be started again
MAX_PAUSE_TICKS = 1200  # before the next run, some five minutes; doubled by each run that fails


class OperatorCore:
    """Ticks and checkpoints in; the start of a run out, as soon as the one before it has ended."""

    def __init__(self, scenario: Scenario | None, rate_hz: float = 0.0) -> None:
        """Play the scenario, power-aware, at so many dwells a second (0: in lockstep); None: begin no runs."""
        self.has_recorder: Callable[[], bool] = lambda: True  # asked before a run begins
        self._scenario, self._rate_hz = scenario, rate_hz
        self._seed = 0
        self._run = ""  # its name; empty: none goes on
        self._start: RunStart | None = None  # None of a run that was found
        self._k = 0  # acknowledged dwells of the run
        self._unacknowledged = 0  # ticks since the newest checkpoint of the run
        self._pause = LISTEN_TICKS if self._is_endless else 1  # ticks before the next run
        self._paused = 0  # ... of which have gone by

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, send its start again, or notice that it has ended."""
        match event:
            case Tick() if self._scenario is not None:
                return self._tick(self._scenario)
            case Checkpoint() if event.run == self._run:
                self._unacknowledged, self._k = 0, event.k
                if event.ended:
                    has_failed = event.t == 0 if self._is_endless else event.t < event.dwells
                    self._pause = min(2 * self._pause, MAX_PAUSE_TICKS) if has_failed else 1
                    self._follow("", None)
            case Checkpoint() if self._is_same_radar(event):
                return self._found(event)
            case _:
                pass
        return ()

    def leave(self) -> Sequence[Message]:
        """End the run: no other one would begin after it. A run without an end goes on."""
        return () if not self._run or self._is_endless else (RunCancel(run=self._run),)

    @property
    def _is_endless(self) -> bool:
        return self._scenario is not None and self._scenario.dwells == NO_END

    def _is_same_radar(self, other: Checkpoint) -> bool:
        """Whether another run that goes on is what this operator would begin: the radar cannot serve two."""
        if self._scenario is None or other.ended or not self._is_endless:
            return False
        settings = other.dwells, other.rate_hz, other.radar
        return settings == (NO_END, self._rate_hz, self._scenario.radar.model_dump())

    def _found(self, other: Checkpoint) -> Sequence[Message]:
        """Take the run of an operator before this one; of two that go on the older one stays."""
        own = self._run
        if own and (other.k, other.run) <= (self._k, own):
            return ()
        self._follow(other.run, None)
        self._k = other.k
        return (RunCancel(run=own, reason="for another run of this radar"),) if own else ()

    def _follow(self, run: str, start: RunStart | None) -> None:
        self._run, self._start = run, start
        self._k = self._unacknowledged = self._paused = 0

    def _tick(self, scenario: Scenario) -> Sequence[Message]:
        self._paused += 1
        is_due = self._paused % ASK_TICKS == 0 or self._paused >= self._pause
        if not self._run and is_due and not self.has_recorder():
            self._paused = 0
        if not self._run and self._paused < self._pause:
            return ()
        if not self._run:
            self._seed += 1
            start = RunStart.of(scenario, Strategy.POWER_AWARE, self._seed, None, self._rate_hz)
            self._follow(start.run, start)
            return (start,)
        self._unacknowledged += 1
        if self._start is None:
            if self._unacknowledged >= GONE_TICKS:
                self._follow("", None)
            return ()
        return (self._start,) if self._unacknowledged % RESEND_TICKS == 0 else ()
