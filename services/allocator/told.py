"""What the others were told of the tracks, in real time: a waveform that comes too late is never radiated.

In lockstep the roster of a scan is that of the waveform before. In real time it may be older; then the tracks that have
begun since are not in it. So the allocator goes on from what it has said itself, and repeats with what a track began
until somebody plans for it.

One that has just come back has said nothing, and what its predecessor said may be in no scan yet, or never. It goes on
from the scan's roster, with numbers beyond all that can have been used.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shared.protocol.messages import Waveform
from shared.protocol.roster import BIRTH, Roster


@dataclass
class Told:
    """Of one run."""

    roster: Roster | None = None  # that was sent last; None: none yet
    k: int = -1  # ... after this dwell
    planned: set[int] = field(default_factory=set)  # tracks of which a plan has come
    _births: dict[int, NDArray[np.float64]] = field(default_factory=dict)  # of the first one without, and those after

    def goes_on_from(self, roster: Roster, k: int, most: int) -> Roster:
        """The tracks of a dwell: those said last, unless that was of an earlier dwell than the one before.

        Whoever has said more since then has begun `most` tracks at most with each waveform.

        roster : of the dwell's scan
        """
        if self.roster is not None and k == self.k + 1:
            return self.roster
        self._births = _births_of(roster)
        return roster.model_copy(update={"next_id": max(roster.next_id, k * most)})

    def repeated(self, sent: Waveform) -> Waveform:
        """A waveform that says with what the tracks began of which no plan has come, and those after them."""
        if sent.roster is None:
            return sent
        ids, births = sent.roster.ids.tolist(), self._births | _births_of(sent.roster)
        first = min((m for m in ids if m in births and m not in self.planned), default=sent.roster.next_id)
        self._births = {m: births[m] for m in ids if m >= first}
        self.planned &= set(ids)
        kept = np.array(list(self._births.values())).reshape(-1, BIRTH)
        self.k, self.roster = sent.k, sent.roster.model_copy(update={"births": kept})
        return sent.model_copy(update={"roster": self.roster})


def _births_of(roster: Roster) -> dict[int, NDArray[np.float64]]:
    """What a roster says with what its tracks began, by track."""
    ids, rows = roster.ids.tolist(), roster.births
    return dict(zip(ids[len(ids) - len(rows) :], rows, strict=True))
