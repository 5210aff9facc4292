"""The roster that was sent last, in real time: a waveform that comes too late is never radiated.

In lockstep the roster of a scan is that of the waveform before. In real time it may be older, without the tracks that
have begun since. So the allocator continues the roster that it has sent itself, and repeats the detection with which a
track began until a plan for that track has come.

An allocator that has just come back has sent nothing, and the roster of its predecessor may be in no scan. It continues
the scan's roster, with ids beyond all that can have been used.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.messages import Waveform, roster_of
from cogradar.shared.protocol.roster import BIRTH, Roster, announced_roster

NEVER = -2  # a dwell before all that can be continued


@dataclass
class LastSentRoster:
    """Of one run."""

    roster: Roster = field(default_factory=lambda: announced_roster(0))
    k: int = NEVER  # dwell of its waveform
    planned: set[int] = field(default_factory=set)  # tracks of which a plan has come
    _births: dict[int, NDArray[np.float64]] = field(default_factory=dict)  # of the first one without, and those after

    def continued(self, roster: Roster, k: int, most: int) -> Roster:
        """The tracks of dwell k: the last roster, if it was sent after dwell k-1, else the scan's.

        Another allocator may have begun `most` tracks with each waveform since the scan's roster.

        roster : of the dwell's scan
        """
        if k == self.k + 1:
            return self.roster
        self._births = _births_of(roster)
        return roster.model_copy(update={"next_id": max(roster.next_id, k * most)})

    def repeated(self, sent: Waveform) -> Waveform:
        """A waveform with the births of the tracks without a plan, and of all tracks after the first of them."""
        roster = roster_of(sent)
        ids, births = roster.ids.tolist(), self._births | _births_of(roster)
        first = min((m for m in ids if m in births and m not in self.planned), default=roster.next_id)
        self._births = {m: births[m] for m in ids if m >= first}
        self.planned &= set(ids)
        kept = np.array(list(self._births.values())).reshape(-1, BIRTH)
        self.k, self.roster = sent.k, roster.model_copy(update={"births": kept})
        return sent.model_copy(update={"roster": self.roster})


def _births_of(roster: Roster) -> dict[int, NDArray[np.float64]]:
    """Detections with which tracks of a roster began, by track."""
    ids, rows = roster.ids.tolist(), roster.births
    return dict(zip(ids[len(ids) - len(rows) :], rows, strict=True))
