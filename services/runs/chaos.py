"""Faults on purpose: kills a process now and then, and checks that a run comes to the same end all the same."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import in_process
from cogradar.services.runs.launcher import LocalProcesses
from cogradar.services.runs.run import Progress
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart


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


def trial(
    start: RunStart, planners: int, rate: float, *, report: Callable[[Progress], None], stop: threading.Event
) -> Trial:
    """Play a run undisturbed in this process, and under faults over Zenoh: `rate` kills a minute.

    Raises RunFailed if the run does not come to its end, Interrupted if `stop` is set meanwhile.
    """
    expected = in_process.play(start, stop=stop).run["digest"]
    began, chaos = time.monotonic(), Chaos(rate, start.seed)
    processes = LocalProcesses(planners, faults=chaos)
    result = distributed.play(start, processes, report=report, notify=lambda _: None, stop=stop)
    return Trial(start.seed, chaos.killed, time.monotonic() - began, result.run["digest"], expected)
