"""How the tracks of a run come to be: by an acquisition of a known number, or born, as the rosters of scans say."""

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any, ClassVar

from cogradar.services.delivery.pacing import Pacing
from cogradar.services.planner.owned_track import born_of, detections_of, model_in
from cogradar.services.planner.ownership import owner_of, owners
from cogradar.shared.protocol.messages import Plan, Scan, roster_of
from cogradar.shared.protocol.slots import N_SLOT
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.scan import Strongest
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import Acquisition, coast, observe, start

Scans = Mapping[int, Scan]  # by dwell, those that are kept
_owner_of = lru_cache(maxsize=1 << 14)(owner_of)  # asked of all tracks with each scan and checkpoint
TOLD_SCANS = 64  # newest ones, of which it is told how near the search came to a detection


class AcquiredTracks:
    """Announced tracks: all begin when every target is detected, and none ends."""

    is_fixed: ClassVar[bool] = True  # whether the tracks are the same in all dwells
    plans_first: ClassVar[bool] = True  # whether the planner plans for the dwell that a track begins with

    def __init__(self, run: str, radar: RadarConfig, model: TrackerModel) -> None:
        self._run, self._model, self._n_track = run, model, radar.announced
        self._acquisition = Acquisition(model)  # gapless from k = 0 to the one that confirms the last target
        self._searched: dict[int, int] = {}  # up to which dwell there are plans of a track that is searched for
        self.slots = range(min(N_SLOT, radar.announced))

    def alive(self, _scans: Scans, _first_k: int) -> list[int]:
        """All tracks."""
        return list(range(self._n_track))

    def owner(self, workers: Sequence[str]) -> Callable[[int], str]:
        """The worker of each track; "": there is none."""
        found = dict(enumerate(owners(self._run, self._n_track, workers)))
        return lambda track: found.get(track, "")

    def first_k(self, _track: int) -> int:
        """The scan that a track needs to begin."""
        return len(self._acquisition.scans)

    def search(self, scans: Scans, tracks: Iterable[int], first_k: int) -> Iterator[Plan]:
        """Plans of the dwells after which the targets are still searched for, also of tracks that are newly owned: the
        worker that owned them before may not have planned for them.
        """
        acquisition = self._acquired(scans)
        end = len(acquisition.scans) - (acquisition.bins is not None)
        for k, m in itertools.product(range(first_k, end), tracks):
            if k >= self._searched.get(m, 0):
                self._searched[m] = k + 1
                yield Plan(run=self._run, k=k, t=0, target=m, status="searching")

    def begin(self, track: int, scans: Scans) -> TrackState | None:
        """Its first state, once all targets are found."""
        acquisition = self._acquired(scans)
        if acquisition.bins is None:
            return None
        bin_, range_km = int(acquisition.bins[track]), acquisition.ranges_km[track]
        return start(self._model, track, bin_, acquisition.scans, range_km)

    def _acquired(self, scans: Scans) -> Acquisition:
        """The acquisition, as far as the scans reach."""
        acquisition = self._acquisition
        while acquisition.bins is None and (scan := scans.get(len(acquisition.scans))) is not None and scan.t == 0:
            # In real time a dwell may come again when the acquisition is over.
            acquisition.add(detections_of(self._model, scan))
        return acquisition

    def progress(self, _scans: Scans) -> str:
        """How near the targets are to being found, in words; "": they are."""
        return self._acquisition.progress

    def judged(self, _state: TrackState) -> dict[str, Any]:
        """No fields of a plan: the existence of the target is certain."""
        return {}


class BornTracks:
    """An unknown number: scans carry rosters, in which tracks are born and end."""

    is_fixed: ClassVar[bool] = False
    plans_first: ClassVar[bool] = False  # the allocator does, from the detection itself
    slots: ClassVar[range] = range(N_SLOT)

    def __init__(self, run: str, model: TrackerModel, pacing: Pacing) -> None:
        self._run, self._model, self._pacing = run, model, pacing
        self._born: dict[int, int] = {}  # dwell that each track began with

    def alive(self, scans: Scans, first_k: int) -> list[int]:
        """The tracks in the rosters since a dwell."""
        rosters = [roster_of(scan) for k, scan in scans.items() if k >= first_k]
        self._born = {m: k for one in rosters for m, k in zip(one.ids.tolist(), one.born_k.tolist(), strict=True)}
        return sorted(self._born)

    def owner(self, workers: Sequence[str]) -> Callable[[int], str]:
        """The worker of each track; "": there is none."""
        there = tuple(workers)
        return lambda track: _owner_of(self._run, track, there)

    def first_k(self, track: int) -> int:
        """The scan that a track needs to begin: the one after its birth."""
        return self._born[track] + 1

    def search(self, _scans: Scans, _tracks: Iterable[int], _first_k: int) -> Iterator[Plan]:
        """No plans: the allocator searches."""
        return iter(())

    def begin(self, track: int, scans: Scans) -> TrackState | None:
        """Its first state, as the scan after its birth says, or a later one where dwells are lost; None without it."""
        first = self.first_k(track)
        ks = sorted(k for k in scans if k >= first) if self._pacing.loses_dwells else [first]
        found = (born_of(self._model, scans[k], track) for k in ks if k in scans)
        return next((state for state in found if state is not None), None)

    def progress(self, scans: Scans) -> str:
        """How near targets are to being found, in words; "": there is a track."""
        newest = [scans[k] for k in sorted(scans)[-TOLD_SCANS:]]
        if not newest or any(roster_of(scan).confirmed.any() for scan in newest):
            return ""
        strongest: Strongest | None = None
        for scan in newest:
            strongest = Strongest.of(detections_of(self._model, scan), strongest)
        return f"{len(newest)} scans without a confirmed track; {strongest or 'nothing was measured'}"

    def judged(self, state: TrackState) -> dict[str, Any]:
        """The fields of a plan that say whether there is a target."""
        judged: dict[str, Any] = {"existence": state.existence, "confirmed": state.confirmed}
        judged |= {"in_doubt": state.in_doubt} | ({"modes": state.modes} if self._model.is_mixture else {})
        return judged


TrackSource = AcquiredTracks | BornTracks


def source_of(run: str, radar: RadarConfig, model: TrackerModel, pacing: Pacing) -> TrackSource:
    """The source of a run's tracks."""
    return BornTracks(run, model, pacing) if radar.is_unknown else AcquiredTracks(run, radar, model)


def follow(
    source: TrackSource,
    model: TrackerModel,
    scans: Iterable[Scan],
    tracks: Collection[int] | None = None,
    states: Mapping[int, TrackState] = MappingProxyType({}),
) -> Iterator[dict[int, TrackState]]:
    """States after each scan, of these tracks as far as they are there, counted from 0; None: of all.

    scans  : all of the run in their order; with `states`, the scans after them
    states : of these tracks, after an earlier scan; the other tracks begin with the acquisition, or are born
    """
    followed = dict(states)
    for scan in scans:
        newest, seen = {scan.k: scan}, detections_of(model, scan)
        there = [m for m in source.alive(newest, scan.k) if tracks is None or m in tracks]
        begun = {m: state for m in there if m not in followed and (state := source.begin(m, newest)) is not None}
        followed = {
            m: state if state.k == scan.k else observe(model_in(model, scan), coast(model, state, scan.k), seen)
            for m, state in sorted((followed | begun).items())
            if m in there
        }
        yield followed
