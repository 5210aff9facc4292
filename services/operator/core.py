"""Operator: begins one run after the other, seed after seed, so that services that are up track without being asked.

It keeps nothing: an operator that comes back begins with the first seed again, and the run of the one before it ends
by itself after its last dwell.
"""

from collections.abc import Sequence

from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, RunCancel, RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario

RESEND_TICKS = 8  # without a checkpoint of the run: its start was lost, or its end, or the journal that held it
MAX_PAUSE_TICKS = 1200  # before the next run, some five minutes; doubled by each run that fails


class OperatorCore:
    """Ticks and checkpoints in; the start of a run out, as soon as the one before it has ended."""

    def __init__(self, scenario: Scenario | None, rate_hz: float = 0.0) -> None:
        """Play the scenario, power-aware, at so many dwells a second (0: in lockstep); None: begin no runs."""
        self._scenario, self._rate_hz = scenario, rate_hz
        self._seed = 0
        self._run: RunStart | None = None
        self._unacknowledged = 0  # ticks since the newest checkpoint of the run
        self._pause = 1  # ticks before the next run
        self._paused = 0  # ... of which have gone by

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, send its start again, or notice that it has ended."""
        match event:
            case Tick() if self._scenario is not None:
                return self._tick(self._scenario)
            case Checkpoint() if self._run is not None and event.run == self._run.run:
                self._unacknowledged = 0
                if event.ended:
                    self._run, self._paused = None, 0
                    self._pause = min(2 * self._pause, MAX_PAUSE_TICKS) if event.t < event.dwells else 1
            case _:
                pass
        return ()

    def leave(self) -> Sequence[Message]:
        """End the run: nobody would begin another one after it."""
        return () if self._run is None else (RunCancel(run=self._run.run),)

    def _tick(self, scenario: Scenario) -> Sequence[Message]:
        self._paused += 1
        if self._run is None and self._paused < self._pause:
            return ()
        if self._run is None:
            self._seed += 1
            self._run = RunStart.of(scenario, Strategy.POWER_AWARE, self._seed, None, self._rate_hz)
            self._unacknowledged = 0
            return (self._run,)
        self._unacknowledged += 1
        return (self._run,) if self._unacknowledged % RESEND_TICKS == 0 else ()
