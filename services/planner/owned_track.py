"""A track that a planner owns: its state, what is prepared for its next scan, and the snapshot that is pending."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cogradar.services.delivery.pacing import Pacing
from cogradar.shared.protocol.fields import MAX_PARTICLES, MAX_UNSEEN
from cogradar.shared.protocol.messages import Scan, roster_of
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.birth import born
from cogradar.shared.tracking.filters import filter_of
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import Prediction, coast, observe, prepare

# A History brings so many scans at once: from its snapshot, a track is back after two requests. At the paper's size
# the dwells since take 0.8 s to replay at worst, and a snapshot costs 3 kB per dwell.
SNAPSHOT_DWELLS = 256


def detections_of(model: TrackerModel, scan: Scan) -> Detections:
    """What a scan message says, for the tracker."""
    roster = {} if scan.roster is None else {"ids": scan.roster.ids, "expected": scan.roster.expected}
    return Detections.of(vars(scan) | roster, model.sensor.n_bin, model.sensor.threshold)


def model_in(model: TrackerModel, scan: Scan) -> TrackerModel:
    """The model in the dwell of a scan: a command may have set its strategy."""
    strategies = [setting.value for setting in scan.settings or () if setting.key == "strategy"]
    return replace(model, tests_every_cell=strategies[-1] == Strategy.ORTHOGONAL) if strategies else model


def born_of(model: TrackerModel, scan: Scan, track: int) -> TrackState | None:
    """What a track was before its first scan, which says where it began; None if this says nothing of it.

    In real time the dwell that it began with may be some dwells ago: a waveform that comes too late is not radiated.
    """
    roster = roster_of(scan)
    if track not in roster.ids:
        return None
    place = int(np.searchsorted(roster.ids, track))
    row = place - (roster.ids.size - roster.births.shape[0])
    if row < 0:
        return None
    return coast(model, born(model, track, int(roster.born_k[place]), roster.births[row]), scan.k)


def snapshot_of(run: str, state: TrackState, unseen: Sequence[int] = ()) -> Snapshot:
    """The message that carries a state, and the dwells whose scans it went without."""
    carried = {name: getattr(state, name) for name in TrackState._fields}
    return Snapshot(run=run, **carried | {"belief": state.belief.rows}, unseen=list(unseen) or None)


def state_of(model: TrackerModel, snapshot: Snapshot) -> TrackState:
    """The state that a snapshot carries, bit for bit."""
    carried = {name: getattr(snapshot, name) for name in TrackState._fields}
    return TrackState(**carried | {"belief": filter_of(model).restored(model, snapshot.belief)})


class OwnedTrack:
    """One track of this worker."""

    def __init__(
        self, model: TrackerModel, state: TrackState, since: int, pacing: Pacing, unseen: Sequence[int] = ()
    ) -> None:
        self.state = state
        self.unseen = tuple(unseen)[-MAX_UNSEEN:]  # dwells whose scans the belief went without, the newest ones
        self.since = since  # newest scan when this worker became the owner
        self.planned = -1  # dwell of the last plan
        self._model, self._pacing = model, pacing
        self._prediction: Prediction | None = None
        self._prepared: TrackState | None = None  # state whose prediction was made, or cannot be made
        self._pending: tuple[TrackState, tuple[int, ...]] | None = None  # to be sent as a snapshot

    @property
    def k(self) -> int:
        """The next scan to observe."""
        return self.state.k + 1

    def observe(self, scan: Detections, model: TrackerModel) -> None:
        """Advance by one scan, by the model of its dwell."""
        self.state = observe(model, self.state, scan, self._prediction)
        self._prediction = None
        n_byte = self.state.belief.rows.nbytes + self.state.remembered.nbytes
        if self._pacing.is_snapshot_due(self.k, self.state.target, SNAPSHOT_DWELLS, n_byte):
            self.save()

    def save(self) -> None:
        """Let there be a snapshot as soon as one may be sent, unless the belief has more particles than a message."""
        if self._pending is None and self.state.belief.rows.shape[0] <= MAX_PARTICLES:
            self._pending = self.state, self.unseen

    @property
    def is_saved(self) -> bool:
        """Whether no snapshot waits to be sent."""
        return self._pending is None

    def coast(self, k: int) -> None:
        """Advance to just before dwell k without an observation."""
        self.unseen = (*self.unseen, *range(max(self.k, k - MAX_UNSEEN), k))[-MAX_UNSEEN:]
        self.state = coast(self._model, self.state, k)
        self._prediction = None

    def prepare(self) -> bool:
        """Predict the next dwell before its scan is there; false if there is nothing to do."""
        if self._prepared is self.state:
            return False
        self._prepared, self._prediction = self.state, prepare(self._model, self.state)
        return self._prediction is not None

    def snapshot(self, run: str, acknowledged: int) -> Snapshot | None:
        """The pending snapshot, once, as soon as dwells 0 .. acknowledged-1 are in the journal and its own is one.

        A planner that continues from it makes no plan of its dwell or of those before: none of them may be lost.
        """
        if self._pending is None or self._pending[0].k >= acknowledged:
            return None
        pending, self._pending = self._pending, None
        try:
            return snapshot_of(run, *pending)
        except ValueError:  # a belief that has flown beyond what a message may say: it goes on without a snapshot
            return None
