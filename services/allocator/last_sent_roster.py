"""The roster that was sent last, in real time: a waveform that comes too late is never radiated.

In lockstep the roster of a scan is that of the waveform before. In real time it may be older, without the tracks that
have begun since. So the allocator continues the roster that it has sent itself, and repeats the detection with which a
track began until a plan for that track has come.

An allocator that has just come back has sent nothing, and the last rosters of its predecessor may be in no scan yet. It
continues the scan's roster and begins no track before a scan carries a roster of its own. The front end takes no older
waveform after that, so no predecessor can have given the next id to another track.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.messages import Waveform, roster_of
from cogradar.shared.protocol.roster import BIRTH, Roster, announced_roster

NEVER = -2  # a dwell before all that can be continued
SENT = 64  # newest rosters, by which a scan's is recognised: so many dwells late a waveform may be


@dataclass
class LastSentRoster:
    """Of one run."""

    roster: Roster = field(default_factory=lambda: announced_roster(0))
    k: int = NEVER  # dwell of its waveform
    planned: set[int] = field(default_factory=set)  # tracks of which a plan has come
    is_followed: bool = False  # a scan carried a roster that was sent here, or no allocator came before this one
    _next_id: int = 0  # above each next_id that was seen
    _sent: deque[tuple[int, int, bytes]] = field(default_factory=lambda: deque(maxlen=SENT))
    _births: dict[int, NDArray[np.float64]] = field(default_factory=dict)  # of the first one without, and those after

    def continued(self, roster: Roster, k: int) -> Roster:
        """The tracks of dwell k: the last roster, if it was sent after dwell k-1 and is followed, else the scan's.

        roster : of the dwell's scan
        """
        self._next_id = max(self._next_id, roster.next_id)
        self.is_followed = self.is_followed or k == 0 or _key(roster) in self._sent
        if not self.is_followed or k != self.k + 1:
            self._births = _births_of(roster)
            self.roster = roster
        return self.roster.model_copy(update={"next_id": self._next_id})

    def repeated(self, sent: Waveform) -> Waveform:
        """A waveform with the births of the tracks without a plan, and of all tracks after the first of them."""
        roster = roster_of(sent)
        ids, births = roster.ids.tolist(), self._births | _births_of(roster)
        first = min((m for m in ids if m in births and m not in self.planned), default=roster.next_id)
        self._births = {m: births[m] for m in ids if m >= first}
        self.planned &= set(ids)
        kept = np.array(list(self._births.values())).reshape(-1, BIRTH)
        self.k, self.roster = sent.k, roster.model_copy(update={"births": kept})
        self._next_id = max(self._next_id, roster.next_id)
        self._sent.append(_key(roster))
        return sent.model_copy(update={"roster": self.roster})


def _key(roster: Roster) -> tuple[int, int, bytes]:
    """Identifies a roster: another dwell has another key, and so has another allocator unless it sent the same."""
    return roster.next_search, roster.next_id, roster.ids.tobytes()


def _births_of(roster: Roster) -> dict[int, NDArray[np.float64]]:
    """Detections with which tracks of a roster began, by track."""
    ids, rows = roster.ids.tolist(), roster.births
    return dict(zip(ids[len(ids) - len(rows) :], rows, strict=True))
