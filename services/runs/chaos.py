"""Faults on purpose: kills a process now and then, and checks that a run comes to the same end all the same."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from services.runs import cluster as distributed
from services.runs import in_process
from services.runs.run import Progress
from shared.numerics.seeds import Purpose, generator
from shared.protocol.messages import RunStart
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario


class Chaos:
    """When to kill which process: at random times, `rate` per minute in the mean."""

    def __init__(self, rate: float, seed: int) -> None:
        self._rate, self._seed, self.killed = rate, seed, 0
        self._next_s: float | None = None

    def victim(self, names: Sequence[str], now_s: float) -> str | None:
        """Name of the process to kill now, None if it is not time yet."""
        rng = generator(self._seed, Purpose.FAULT, 0, self.killed)
        if self._next_s is None:
            self._next_s = now_s + float(rng.exponential(60.0 / self._rate))
        if now_s < self._next_s:
            return None
        self._next_s, self.killed = None, self.killed + 1
        return names[int(rng.integers(len(names)))]


@dataclass(frozen=True)
class Trial:
    """One run under faults beside the same run in one process."""

    seed: int
    killed: int
    elapsed_s: float
    digest: str
    expected: str

    @property
    def same(self) -> bool:
        """Whether the faults left no trace."""
        return self.digest == self.expected


def trials(
    scenario: Scenario,
    dwells: int | None,
    planners: int,
    runs: int,
    rate: float,
    *,
    report: Callable[[Progress], None],
    notify: Callable[[str], None],
    stop: threading.Event,
) -> Iterator[Trial]:
    """Play seeds 1 .. runs, each undisturbed in this process and under faults over Zenoh.

    Raises RunFailed if a run does not come to its end, Interrupted if `stop` is set meanwhile.
    """
    for seed in range(1, runs + 1):
        start = RunStart.of(scenario, Strategy.POWER_AWARE, seed, dwells)
        expected = in_process.play(start, stop=stop).run["digest"]
        began, chaos = time.monotonic(), Chaos(rate, seed)
        result = distributed.play(
            start, planners=planners, store=None, report=report, notify=notify, stop=stop, chaos=chaos
        )
        yield Trial(seed, chaos.killed, time.monotonic() - began, result.run["digest"], expected)
