"""Which tracks a run has, dwell by dwell: those that were announced, or those that are found and lost."""

from collections.abc import Iterable, Mapping

from cogradar.services.allocator.last_sent_roster import LastSentRoster
from cogradar.services.allocator.track_update import TrackUpdate, unchanged, updated
from cogradar.services.delivery.invariant import require
from cogradar.services.delivery.pacing import COASTED_S, TAKEOVER_S, Pacing
from cogradar.services.delivery.resend import MAX_DWELLS
from cogradar.shared.protocol.admission import check_scan
from cogradar.shared.protocol.messages import Plan, Scan, Waveform, roster_of
from cogradar.shared.protocol.orders import Order, dropped
from cogradar.shared.scenario.radar_config import RadarConfig


class AnnouncedTracks:
    """A fixed roster: its tracks are there from the first dwell to the last. A scan says how far the radar is."""

    def __init__(self, radar: RadarConfig, pacing: Pacing) -> None:
        self._ids, self._pacing = frozenset(range(radar.announced)), pacing
        self._newest_k = -1  # in real time: of a scan that tracks are followed in

    def take(self, scan: Scan, first_k: int) -> bool:
        """Whether a scan is of use: in real time, for the waveform after it is due whether or not plans come.

        While targets are acquired there is nothing to extrapolate, and the radar repeats a dwell that measured nothing.
        """
        is_new = self._pacing.has_deadlines and scan.t > 0 and scan.k >= max(first_k, self._newest_k + 1)
        self._newest_k = scan.k if is_new else self._newest_k
        return is_new

    def note(self, plan: Plan) -> None:
        """A plan has come. It says nothing new."""

    def ids(self, _k: int) -> frozenset[int] | None:
        """The tracks of a dwell, always the same."""
        return self._ids

    def update(self, k: int, plans: Mapping[int, Plan], _orders: Iterable[Order]) -> TrackUpdate | None:
        """The tracks after dwell k; None unless the radar has come to it, there is a plan of each, and one is new.

        plans : of dwell k by track, or else the newest ones
        """
        newest_k = max((plan.k for plan in plans.values()), default=0)
        if len(plans) < len(self._ids) or self._pacing.seconds(k - newest_k) > COASTED_S:
            return None
        if k > max(newest_k, self._newest_k):
            return None
        return unchanged([plans[m] for m in sorted(self._ids)], k)

    def sent(self, waveform: Waveform) -> Waveform:
        """A waveform as it is to be sent: all know the roster."""
        return waveform

    def forget(self, before_k: int) -> None:
        """Nothing is kept."""

    def validate(self) -> None:
        """Nothing is kept."""


class FoundTracks:
    """An unknown number: each scan carries the roster of its dwell.

    A track without a plan for long has no planner, and ends. An allocator that has just come back waits as long as a
    takeover may take for the plans of tracks that it does not know.
    """

    def __init__(self, radar: RadarConfig, pacing: Pacing) -> None:
        self._radar, self._pacing = radar, pacing
        self._scans: dict[int, Scan] = {}
        self._ids: dict[int, frozenset[int]] = {}  # of the tracks in each of them
        self._first_k, self._newest_k = 0, -2  # since the first all scans have come, up to the newest
        self._last_sent = LastSentRoster()
        self._most_s = max(COASTED_S, pacing.seconds(2))  # without a plan

    def take(self, scan: Scan, first_k: int) -> bool:
        """Keep a scan and return true, unless it is known, or its dwell is over or far ahead. Raises Refused."""
        if not first_k <= scan.k < first_k + MAX_DWELLS or scan.k in self._scans:
            return False
        check_scan(scan, self._radar)
        self._scans[scan.k], self._ids[scan.k] = scan, frozenset(roster_of(scan).ids.tolist())
        if scan.k > self._newest_k + 1:
            self._first_k = scan.k
        self._newest_k = max(self._newest_k, scan.k)
        return True

    def note(self, plan: Plan) -> None:
        """A plan has come: some planner knows with what its track began."""
        if self._pacing.loses_dwells:  # elsewhere no birth is repeated
            self._last_sent.planned.add(plan.target)

    def ids(self, k: int) -> frozenset[int] | None:
        """The tracks of dwell k; None: not known yet."""
        return self._ids.get(k)

    def update(self, k: int, plans: Mapping[int, Plan], orders: Iterable[Order]) -> TrackUpdate | None:
        """The tracks after dwell k; None without its scan, or without a plan that may still come.

        orders : granted ones; some may end tracks
        """
        scan = self._scans.get(k)
        if scan is None:
            return None
        roster = roster_of(scan)
        if self._pacing.loses_dwells:
            roster = self._last_sent.continued(roster, k)
        known = [plans[m] for m in roster.ids.tolist() if m in plans]
        if len(known) < roster.ids.size and self._pacing.seconds(k - self._first_k) <= TAKEOVER_S:
            return None
        dropping = dropped(orders, k + 1, dict(zip(roster.ids.tolist(), roster.born_k.tolist(), strict=True)))
        kept = [plan for plan in known if plan.target not in dropping]
        new = [plan for plan in kept if self._pacing.seconds(k - plan.k) <= self._most_s]
        ended = tuple(dropping[m] for m in roster.ids.tolist() if m in dropping)
        begins = self._last_sent.is_followed or not self._pacing.loses_dwells
        return updated(self._radar, scan, roster, new, begins=begins)._replace(dropped=ended)

    def sent(self, waveform: Waveform) -> Waveform:
        """A waveform as it is to be sent: where one may be lost, with the births of which no plan has come."""
        if not self._pacing.loses_dwells:
            return waveform
        begins_none = None if self._last_sent.is_followed else True
        return self._last_sent.repeated(waveform.model_copy(update={"begins_none": begins_none}))

    def forget(self, before_k: int) -> None:
        """Drop the scans before a dwell."""
        self._scans = {k: scan for k, scan in self._scans.items() if k >= before_k}
        self._ids = {k: self._ids[k] for k in self._scans}

    def validate(self) -> None:
        """Raises BrokenInvariant."""
        require(len(self._scans) <= MAX_DWELLS, "scans of more dwells are kept than may be")
        require(self._pacing.loses_dwells or not self._last_sent.planned, "tracks are kept that have ended")


Tracks = AnnouncedTracks | FoundTracks


def tracks_of(radar: RadarConfig, pacing: Pacing) -> Tracks:
    """The tracks of a run that begins."""
    return FoundTracks(radar, pacing) if radar.is_unknown else AnnouncedTracks(radar, pacing)
