"""Faults on purpose: kills a process now and then. In lockstep the digest is the same, in real time no track ends."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs import in_process
from cogradar.services.runs.continuity import Continuity, continuity
from cogradar.services.runs.launcher import LocalProcesses, scratch
from cogradar.services.runs.run import Progress
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart


class Chaos:
    """When to kill which process: at random times, `rate` per minute in the mean."""

    def __init__(self, rate: float, seed: int) -> None:
        self._rate, self._seed = rate, seed
        self.victims = list[str]()
        self.killed_s = list[float]()  # when, by the clock of those that ask
        self._next_s: float | None = None

    def victim(self, names: Sequence[str], now_s: float) -> str | None:
        """Name of the process to kill now, None if it is not time yet."""
        rng = generator(self._seed, Purpose.FAULT, 0, self.killed)
        if self._next_s is None:
            self._next_s = now_s + float(rng.exponential(60.0 / self._rate))
        if now_s < self._next_s:
            return None
        self._next_s = None
        self.victims.append(names[int(rng.integers(len(names)))])
        self.killed_s.append(now_s)
        return self.victims[-1]

    @property
    def killed(self) -> int:
        """Processes, so far."""
        return len(self.victims)


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
    start: RunStart, given: LocalProcesses, rate: float, *, report: Callable[[Progress], None], stop: threading.Event
) -> Trial:
    """Play a run undisturbed in this process, and under faults over Zenoh: `rate` kills a minute.

    Raises RunFailed if the run does not come to its end, Interrupted if `stop` is set meanwhile.
    """
    expected = in_process.play(start, stop=stop).run["digest"]
    began, chaos = time.monotonic(), Chaos(rate, start.seed)
    result = distributed.play(start, replace(given, faults=chaos), report=report, notify=lambda _: None, stop=stop)
    return Trial(start.seed, chaos.killed, time.monotonic() - began, result.run["digest"], expected)


@dataclass(frozen=True)
class RealTimeTrial:
    """One run in real time under faults."""

    seed: int
    victims: Sequence[str]  # processes, in the order in which they were killed
    killed_at: Sequence[float]  # ... and the dwell at that time
    continuity: Continuity
    undisturbed: float | None  # completeness of the same run in lockstep, left in peace

    @property
    def holds(self) -> bool:
        """Whether no track ended because of a process."""
        return self.continuity.ended == 0

    def __str__(self) -> str:
        found = self.continuity
        complete = "" if found.completeness is None else f", complete {found.completeness:.3f}"
        alone = "" if self.undisturbed is None else f" ({self.undisturbed:.3f} left in peace)"
        return (
            f"killed {_by_role(self.victims)}; {found.ended} of {found.tracks} tracks ended by a process, longest time"
            f" without a plan {found.longest_coast_s:.1f} s, {found.lost_dwells} dwells did not happen{complete}{alone}"
        )


def _by_role(victims: Iterable[str]) -> str:
    by_role = Counter(name.rpartition("-")[0] for name in victims)
    return ", ".join(f"{n} {role}" for role, n in sorted(by_role.items())) or "nothing"


def all_together(seen: Sequence[RealTimeTrial]) -> str:
    """What came of runs in real time, in a line."""
    victims = [name for one in seen for name in one.victims]
    ended, tracks = (sum(getattr(one.continuity, name) for one in seen) for name in ("ended", "tracks"))
    longest_s = max(one.continuity.longest_coast_s for one in seen)
    return (
        f"{len(seen)} runs, {len(victims)} processes killed ({_by_role(victims)}); {ended} of {tracks} confirmed tracks"
        f" ended by a process, longest time without a plan {longest_s:.1f} s"
    )


def trial_in_real_time(
    start: RunStart, given: LocalProcesses, rate: float, *, report: Callable[[Progress], None], stop: threading.Event
) -> RealTimeTrial:
    """Play a run in real time under faults, `rate` kills a minute, and see what became of its tracks.

    Raises RunFailed if the run does not come to its end, Interrupted if `stop` is set meanwhile.
    """
    alone = in_process.play(start.model_copy(update={"rate_hz": 0.0}), stop=stop)
    chaos, at_s, dwells = Chaos(rate, start.seed), [time.monotonic()], [0]

    def note(reached: Progress) -> None:
        if reached.k is not None and reached.k > dwells[-1]:
            at_s.append(time.monotonic())
            dwells.append(reached.k)
        report(reached)

    with scratch() as folder:
        path = f"{folder}/runs.db"
        given = replace(given, store=path, faults=chaos)
        played = distributed.play(start, given, report=note, notify=lambda _: None, stop=stop)
        with closing(Journal(path, read_only=True)) as journal:
            found = continuity(journal, start, played.picture.get("completeness"))
    # No straight line: the clock of the dwells stands still while an emulator is away.
    killed_at = np.interp(chaos.killed_s, at_s, dwells).tolist()
    return RealTimeTrial(start.seed, chaos.victims, killed_at, found, alone.picture.get("completeness"))


def timeline(seen: Sequence[RealTimeTrial]) -> Iterator[tuple[int, str, str, float, float]]:
    """What was when, a row each: seed; "killed", "track", "coast" or "missed"; of what; first and last dwell."""
    for one in seen:
        for victim, dwell in zip(one.victims, one.killed_at, strict=True):
            yield one.seed, "killed", victim, dwell, dwell
        for span in one.continuity.spans:
            yield one.seed, span.what, str(span.track or ""), span.first, span.last
