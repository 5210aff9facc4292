"""When the dwells of a run happen, and what follows from it: which are open, what may be late, what may be lost.

Only this file compares a rate. A process asks the pacing of its run.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from cogradar.shared.wire.pool.live_names import LEASE_S, LEAVE_AFTER_S

MAX_AHEAD_DWELLS = 200  # how far a run may be ahead of the journal; senders keep more than twice as much
MAX_WAIT_S = 1.0  # real time: how long a track waits for a missing scan while newer ones come
REST_S = 2.0  # real time: so long, or a period, the rest of a dwell is awaited after its first message
SEARCH_SHARE = 0.4  # of a period, for the searches of all tracks; the allocator waits for half a period
REBUILD_SHARE = 0.1  # of a period, between two dwells, for tracks that are rebuilt while the others are planned for
SNAPSHOT_S = 1.0  # real time: from a snapshot of a track to the next; a takeover replays no more than about twice that
SNAPSHOT_RATE = 100_000  # bytes a second at most for the snapshots of one track
TAKEOVER_S = LEASE_S + LEAVE_AFTER_S + SNAPSHOT_S  # real time: without plans of a track, until its new owner has them
COASTED_S = 3.0 * TAKEOVER_S  # so long a track goes on without a plan: its new owner may die, too
MAX_AHEAD_S = 2.0 * COASTED_S  # real time: how far, besides, the allocator may be ahead of the radar
ORDER_S = 0.5  # real time: from a command to its first dwell, so that all hear of it before


@dataclass(frozen=True)
class Lockstep:
    """Each dwell happens as soon as its waveform is there. Nothing is late, and what is lost is sent again."""

    has_deadlines: ClassVar[bool] = False  # whether dwells and answers are due at a time, whatever is missing
    loses_dwells: ClassVar[bool] = False  # whether a dwell may be lost for good, and none can be repeated
    awaited_offers: ClassVar[int] = 3  # checkpoints for which a planner that joins waits for an offer of its tracks
    most_ahead: ClassVar[float] = math.inf  # dwells by which a waveform may be ahead of the radar
    search_s: ClassVar[float] = math.inf  # for the searches of all tracks of a dwell
    rest_s: ClassVar[float] = math.inf  # for which the rest of a dwell is awaited
    silence_s: ClassVar[float] = 0.0  # that is usual between two messages of a run
    rebuild_s: ClassVar[float] = math.inf  # at a time for tracks that are behind

    def is_snapshot_due(self, k: int, _track: int, most: int, _n_byte: int) -> bool:
        """Whether a track's snapshot is due before dwell k: each `most` dwells."""
        return k % most == 0

    def is_far(self, _dwells: int) -> bool:
        """Whether a track that is so many dwells behind is rebuilt from a snapshot, though all scans are here."""
        return False

    def seconds(self, _dwells: int) -> float:
        """Duration of this many dwells by the clock: 0 in lockstep."""
        return 0.0

    def wait_s(self, _periods: float) -> float | None:
        """After so many periods an answer is due; None: only when it is complete."""
        return None

    def next_due_s(self, _due_s: float | None, _now_s: float) -> float | None:
        """When the dwell after the one that is due now is due; None: none is due now."""
        return None

    def overdue(self, _due_s: float, _now_s: float) -> int:
        """Dwells that should have happened since one was due, besides that one: none in lockstep."""
        return 0

    def may_transmit(self, ahead: int) -> bool:
        """Whether a dwell may happen at once, so many dwells ahead of the journal."""
        return ahead < MAX_AHEAD_DWELLS

    def first_open(self, _next_k: int, acknowledged_k: int) -> int:
        """The first dwell of which messages are still of use: the first one that is not acknowledged."""
        return acknowledged_k

    def may_answer(self, ahead: int) -> bool:
        """Whether a waveform may be made so many dwells ahead of the journal: later ones may be under other orders."""
        return ahead < MAX_AHEAD_DWELLS

    def first_ordered(self, _newest_k: int, acknowledged_k: int, _notice_s: float) -> int:
        """The first dwell that a command can shape.

        No dwell from there on is answered before a checkpoint beyond the acknowledged one has come, and each such
        checkpoint says the order.
        """
        return acknowledged_k + MAX_AHEAD_DWELLS + 1

    def may_coast(self, _waited: int) -> bool:
        """Whether a track goes on without a scan, having waited for it so many dwells."""
        return False

    def skipped(self, _away_s: float) -> int:
        """Dwells that the radar skips when it comes back after so long: none."""
        return 0


@dataclass(frozen=True)
class RealTime:
    """A dwell each period, whatever is missing: the radar uses the newest waveform, and a dwell may be lost."""

    period_s: float
    has_deadlines: ClassVar[bool] = True
    loses_dwells: ClassVar[bool] = True
    awaited_offers: ClassVar[int] = 1

    @property
    def most_ahead(self) -> float:
        """Dwells by which a waveform may be ahead of the radar."""
        return MAX_AHEAD_DWELLS + MAX_AHEAD_S / self.period_s

    @property
    def rest_s(self) -> float:
        """Time for which the rest of a dwell is awaited; the searches share a period."""
        return max(REST_S, self.period_s)

    @property
    def silence_s(self) -> float:
        """Time without a scan after which something is lost that can still be had."""
        return self.period_s + REST_S

    @property
    def search_s(self) -> float:
        """Time for the searches of all tracks of a dwell."""
        return SEARCH_SHARE * self.period_s

    @property
    def rebuild_s(self) -> float:
        """Time at a time for tracks that are behind."""
        return REBUILD_SHARE * self.period_s

    def is_snapshot_due(self, k: int, track: int, most: int, n_byte: int) -> bool:
        """Whether a track's snapshot of so many bytes is due before dwell k: by time, each `most` dwells at least.

        Tracks take turns.
        """
        every = math.ceil(max(SNAPSHOT_S, n_byte / SNAPSHOT_RATE) / self.period_s)
        return (k + track) % min(most, every) == 0

    def is_far(self, dwells: int) -> bool:
        """Whether a track that is so many dwells behind is rebuilt from a snapshot, though all scans are here."""
        return dwells > 1 and self.seconds(dwells) > 2.0 * SNAPSHOT_S

    def seconds(self, dwells: int) -> float:
        """How long so many dwells last by the clock."""
        return dwells * self.period_s

    def wait_s(self, periods: float) -> float | None:
        """After so many periods an answer is due, with what there is."""
        return periods * self.period_s

    def next_due_s(self, due_s: float | None, now_s: float) -> float | None:
        """When the dwell after the one that is due now is due; None: none is due now.

        Overdue dwells are not made up for: a transmitter that was late goes on at its rate.
        """
        due_s = now_s if due_s is None else due_s
        if now_s < due_s:
            return None
        return (now_s if now_s >= due_s + self.period_s else due_s) + self.period_s

    def overdue(self, due_s: float, now_s: float) -> int:
        """Dwells that should have happened since one was due, besides that one."""
        return max(math.floor((now_s - due_s) / self.period_s), 0)

    def may_transmit(self, _ahead: int) -> bool:
        """Never at once, only when it is due."""
        return False

    def first_open(self, next_k: int, _acknowledged_k: int) -> int:
        """The first dwell of which messages are still of use: the next one."""
        return next_k

    def may_answer(self, _ahead: int) -> bool:
        """Whether a waveform may be made so many dwells ahead of the journal: the radar does not wait."""
        return True

    def first_ordered(self, newest_k: int, _acknowledged_k: int, notice_s: float) -> int:
        """The first dwell that a command is meant to shape; a waveform says which orders it obeys.

        notice_s : from the command to that dwell
        """
        return newest_k + 1 + math.ceil(notice_s / self.period_s)

    def may_coast(self, waited: int) -> bool:
        """Whether a track goes on without a scan, having waited for it so many dwells."""
        return self.seconds(waited) > MAX_WAIT_S

    def skipped(self, away_s: float) -> int:
        """Dwells that the radar skips when it comes back after so long: no more than tracks last without a plan."""
        return math.floor(min(away_s, COASTED_S) / self.period_s)


Pacing = Lockstep | RealTime


def pacing_at(rate_hz: float) -> Pacing:
    """The pacing of a run with this rate in dwells per second; 0: lockstep."""
    return RealTime(1.0 / rate_hz) if rate_hz > 0.0 else Lockstep()
