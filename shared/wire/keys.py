"""Lanes: keys of the transport that one run after the other uses, since no key is ever freed.

A lane is a number that a process gives to what it says of one run. The transport keeps the newest messages of each
key, so a lane that was left is not taken again at once: readers that are late still find there how the run ended.
"""

import time
from collections import deque
from collections.abc import Callable

LEFT_ALONE = 4  # lanes of runs that ended, before the oldest of them is taken again
SILENT_S = 1200.0  # a run of which nothing is said for so long counts as ended


class Lanes:
    """Which lane each run has. There are as many as runs went on at once, and a few."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lanes: dict[str, int] = {}  # of runs that go on, and of those whose lane nobody took yet
        self._used: dict[str, float] = {}  # when they were asked for
        self._left: deque[str] = deque()  # runs that are over, in that order

    def of(self, run: str) -> int:
        """The lane of a run that something is said of now."""
        if run not in self._lanes:
            self._lanes[run] = self._vacant()
        self._used[run] = self._clock()
        return self._lanes[run]

    def leave(self, run: str) -> None:
        """The run is over."""
        if run in self._lanes and run not in self._left:
            self._left.append(run)

    def _vacant(self) -> int:
        """The lane that was left first, if enough were; else a new one."""
        now_s = self._clock()
        for run in [run for run, used_s in self._used.items() if now_s - used_s > SILENT_S]:
            self.leave(run)
        if len(self._left) <= LEFT_ALONE:
            return len(self._lanes)
        over = self._left.popleft()
        del self._used[over]
        return self._lanes.pop(over)
