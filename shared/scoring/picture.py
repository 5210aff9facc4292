"""The air picture: which track follows which target from dwell to dwell, and what that comes to over a run.

Tracks and targets have ids and may come and go; an id is never used twice. A target counts from the dwell in which it
could be found on (`cogradar.shared.scoring.detectability`). One that does not count yet is left out together with the
track that is assigned to it.

Two assignments are made. For distances and for SIAP it is GOSPA's, of the dwell alone. For identities a pair of the
past is kept unless another is clearly nearer: it is worth c^2/4 more, a cost of switching as in the metric for sets of
trajectories (Garcia-Fernandez et al. 2020), here from dwell to dwell. So two tracks that are exchanged on targets
2.5 km apart are seen to be, and two that overlap within their errors are not exchanged back and forth.

A track is the track of the target that counts and that it has followed in three dwells in a row. One that is of no
target is false: a track of noise passes near some target now and then.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cogradar.shared.scoring.figures import CUT_OFF_KM, Totals
from cogradar.shared.scoring.sets import Floats, assigned, distance_of, squared_distances

ESTABLISHED = 3  # dwells in a row
REMEMBERED = 4096  # tracks, the newest by their ids: what is known of older ones is forgotten, in runs of weeks
KEPT_KM2 = 0.25 * CUT_OFF_KM**2  # what it is worth that a track goes on with its target


class Objects(NamedTuple):
    """Tracks, or targets, of one dwell."""

    ids: Sequence[int]  # n, all different
    states: Floats  # (n, 4) [x, vx, y, vy], km and km/s


class AirPicture:
    """The dwells of one run in their order."""

    def __init__(self) -> None:
        self._known: set[int] = set()  # tracks
        self._target_of: dict[int, int] = {}  # of each track: the one that it followed last
        self._track_of: dict[int, int] = {}  # of each target, likewise
        self._following: dict[int, int] = {}  # track of each target, in the last dwell
        self._in_a_row: dict[int, int] = {}  # by target: dwells for which that track has followed it
        self._whose: dict[int, int] = {}  # of each established track: the target that it is the track of
        self._confirmed: set[int] = set()  # targets
        self._out_since: dict[int, int] = {}  # dwell t from which on no track follows a target that counts

    def advance(
        self, t: int, tracks: Objects, targets: Objects, counts: Sequence[bool]
    ) -> tuple[Totals, dict[int, int]]:
        """What dwell t comes to, and the track of each target that has one, of those that do not count, too.

        counts : m, which of the targets count
        """
        squared = squared_distances(tracks.states, targets.states)
        nearest = assigned(squared)
        within = [float(squared[i, j]) for i, j in enumerate(nearest) if j >= 0 and counts[j]]
        free, n_target = [i for i, j in enumerate(nearest) if j < 0], sum(counts)
        n_track, n_pair = len(within) + len(free), len(within)
        further = ((squared[free] < CUT_OFF_KM**2) & np.asarray(counts)).any(axis=1).sum() if free and n_target else 0
        began = set(tracks.ids) - self._known
        self._known |= began
        if len(self._known) > 2 * REMEMBERED:
            self._forget(tracks.ids)
        pairs = self._continued(tracks.ids, targets.ids, squared, nearest)
        followers = {targets.ids[j]: tracks.ids[i] for i, j in enumerate(pairs) if j >= 0}
        present = dict(zip(targets.ids, counts, strict=True))
        followed = {target: track for target, track in followers.items() if present[target]}
        swaps, established = self._identified(followed)
        total = Totals(
            1,
            n_target,
            n_track,
            n_pair,
            n_pair + int(further),
            *distance_of(n_track, n_target, within),
            swaps,
            *self._stretches(followed, targets.ids),
            *self._waits(t, followed, present),
            len(began),
            established,
        )
        return total, followers

    def _forget(self, there: Sequence[int]) -> None:
        """Keep what is known of the newest tracks, and of those that are there."""
        kept = {*sorted(self._known)[-REMEMBERED:], *there}
        self._known &= kept
        self._target_of = {track: target for track, target in self._target_of.items() if track in kept}
        self._whose = {track: target for track, target in self._whose.items() if track in kept}

    def _continued(
        self, tracks: Sequence[int], targets: Sequence[int], squared: Floats, nearest: list[int]
    ) -> list[int]:
        """The assignment, (n,), in which pairs of the past are worth more."""
        columns = {target: j for j, target in enumerate(targets)}
        pairs = [
            (i, columns[target])
            for i, track in enumerate(tracks)
            if (target := self._target_of.get(track)) in columns and self._track_of[target] == track
        ]
        pairs = [(i, j) for i, j in pairs if squared[i, j] < CUT_OFF_KM**2]
        if all(nearest[i] == j for i, j in pairs):  # what is the best without them is so with them, too
            return nearest
        worth = np.zeros_like(squared)
        for pair in pairs:
            worth[pair] = KEPT_KM2
        return assigned(squared, worth)

    def _identified(self, followed: Mapping[int, int]) -> tuple[int, int]:
        """Tracks that have become another target's, and those that have become their first one's."""
        swaps = established = 0
        self._in_a_row = {
            target: 1 + (self._in_a_row[target] if self._following.get(target) == track else 0)
            for target, track in followed.items()
        }
        for target, track in followed.items():
            self._target_of[track], self._track_of[target] = target, track
            if self._in_a_row[target] >= ESTABLISHED:
                before = self._whose.get(track)
                swaps += before not in {None, target}
                established += before is None
                self._whose[track] = target
        return swaps, established

    def _stretches(self, followed: dict[int, int], present: Sequence[int]) -> tuple[int, int]:
        """Stretches that begin, and those that end although their target is there."""
        before, self._following = self._following, followed
        begun = sum(before.get(target) != track for target, track in followed.items())
        return begun, sum(target in present and followed.get(target) != track for target, track in before.items())

    def _waits(self, t: int, followed: Mapping[int, int], present: Mapping[int, bool]) -> tuple[int, int, int, int]:
        """Targets confirmed and regained, and the dwells that this took: `confirmed` to `regained_after`."""
        confirmed = confirmed_after = regained = regained_after = 0
        self._out_since = {target: since for target, since in self._out_since.items() if target in present}
        for target in (target for target, counts in present.items() if counts):
            if target not in followed:
                self._out_since.setdefault(target, t)
                continue
            since = self._out_since.pop(target, t)
            if target not in self._confirmed:
                self._confirmed.add(target)
                confirmed, confirmed_after = confirmed + 1, confirmed_after + t - since
            elif since < t:
                regained, regained_after = regained + 1, regained_after + t - since
        return confirmed, confirmed_after, regained, regained_after
