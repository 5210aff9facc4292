"""A track that a planner holds: how far it has come, and the snapshot of it that is still to be said."""

from shared.protocol.messages import Scan, Snapshot
from shared.tracking.track import Track

# A History brings so many scans at once: from its snapshot, a track is back after two questions. At the paper's size
# the dwells since take 0.8 s to replay at worst, and a snapshot costs 3 kB per dwell.
SNAPSHOT_DWELLS = 256


class Held:
    """A track of ours. `k` is the next scan to observe."""

    def __init__(self, track: Track, k: int, since: int) -> None:
        self.track = track
        self.k = k
        self.since = since  # newest scan when the track became ours
        self.planned = -1  # dwell of the last plan
        self._snapshot: Snapshot | None = None

    def observe(self, scan: Scan) -> None:
        """Go on by one scan."""
        self.track.observe(scan)
        self.k += 1
        if self.k % SNAPSHOT_DWELLS == 0 and self._snapshot is None:
            self._snapshot = self.track.snapshot(scan.run)

    def snapshot(self, stored: int) -> Snapshot | None:
        """The newest snapshot, once, as soon as dwells 0 .. stored-1 are in the store and it is of one of them.

        Who goes on from it makes no plan of its dwell or of those before, so that these must not be lost any more.
        """
        if self._snapshot is None or self._snapshot.k >= stored:
            return None
        said, self._snapshot = self._snapshot, None
        return said
