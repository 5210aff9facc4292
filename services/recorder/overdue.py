"""In real time: whose plans have not come for so long that others take its tracks."""

from collections.abc import Set

from cogradar.services.delivery.pacing import Pacing
from cogradar.shared.wire.pool.live_names import RETURN_S

# For the first plan of a track, or after a gap: a planner that begins loads its kernels, one may still be coming back.
FIRST_S = RETURN_S + 1.0
WITHIN_S, MISSED = 1.0, 2  # for the next one, in seconds and in dwells; twice as long each time that it is overdue


class OverduePlans:
    """Of the tracks of one run. A plan that comes after its waveform counts, too: its planner is slow, and not away."""

    def __init__(self, pacing: Pacing) -> None:
        self._pacing = pacing
        self._newest = -1  # dwell of the newest scan
        self._planned: dict[int, int] = {}  # of its tracks: newest dwell with a plan, or from which one is awaited
        self._wait_s: dict[int, float] = {}

    def hear_scan(self, k: int, tracks: Set[int]) -> None:
        """A dwell has tracks, which are to be planned for."""
        if k > self._newest + MISSED:  # no planner could plan for a scan that did not come
            self._planned, self._wait_s = {}, {}
        if k > self._newest:
            self._newest = k
            self._planned = {m: self._planned.get(m, k) for m in tracks}
            self._wait_s = {m: self._wait_s.get(m, FIRST_S) for m in tracks}

    def hear_plan(self, k: int, track: int) -> None:
        """A track was planned for."""
        if track in self._planned and k >= self._planned[track]:
            self._planned[track], self._wait_s[track] = k, WITHIN_S

    def take(self) -> set[int]:
        """The tracks that are overdue, each once: their new owner has its time, too."""
        missed = {m: self._newest - 1 - k for m, k in self._planned.items()}  # the newest dwell is not, yet
        overdue = {m for m, n in missed.items() if n >= MISSED and self._pacing.seconds(n) >= self._wait_s[m]}
        for m in overdue:
            self._planned[m] = self._newest
            self._wait_s[m] = min(2.0 * self._wait_s[m], FIRST_S)
        return overdue
