"""The air picture of a dwell, as other systems are told it: messages of a run in, pictures out."""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from cogradar.services.skies.place import Place, dwell_s
from cogradar.shared.protocol.fields import Covariance, Index, State, UtcSeconds
from cogradar.shared.protocol.messages import Message, Plan, Scan, Waveform
from cogradar.shared.scenario.scenario import Scenario, SiteSection
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.response import strongest_of_each
from cogradar.shared.wire.codec import Parts

Floats = NDArray[np.float64]
KEPT_TIMES = 512  # dwells whose waveform may still come
WAIT_S = 0.05  # for plans of a dwell that are on their way when its waveform is there
METRES = 1e3  # in a km


class TrackReport(Message):
    """What a picture takes of a plan, each field as checked as there: half of the time is left."""

    model_config = ConfigDict(extra="ignore")

    k: Index
    t: Index
    target: Index
    status: Literal["searching", "tracking", "ended"]
    estimate: State
    covariance: Covariance
    detected: bool
    existence: Annotated[float | None, Field(ge=0, le=1)] = None
    confirmed: bool | None = None


class DwellReport(Message):
    """What a picture takes of a scan whose detections are not wanted."""

    model_config = ConfigDict(extra="ignore")

    k: Index
    utc_s: UtcSeconds | None = None


PARTS: Parts = {Plan: TrackReport}
WITHOUT_PLOTS: Parts = {**PARTS, Scan: DwellReport}


class Track(NamedTuple):
    """A track at the time of its picture. Its height is not measured; the covariance has what that leaves unknown."""

    number: int  # from 1; of an unknown number of targets never used again in the run
    latitude: float  # degrees, WGS 84
    longitude: float
    east_km: float  # from the radar along the ground, by distance and azimuth
    north_km: float
    velocity: tuple[float, float]  # to the east and to the north, m/s
    covariance: Floats  # (4, 4) of east, its velocity, north, its velocity; m and m/s
    confirmed: bool
    existence: float | None  # probability that there is a target; None: targets are announced
    seen_s: float  # since it was detected last, or since it began

    @property
    def speed(self) -> float:
        """Over the ground, m/s."""
        return float(np.hypot(*self.velocity))

    @property
    def course_deg(self) -> float:
        """Of the velocity, clockwise from north."""
        return float(np.degrees(np.arctan2(*self.velocity)) % 360.0)


class Plot(NamedTuple):
    """A detection with a measured range; of the rows of one echo the strongest, as trackers take it."""

    range_km: float  # centre of the range cell, from the array to the target
    azimuth_deg: float  # clockwise from north


class Picture(NamedTuple):
    """All tracks after a dwell. A track that is no more in the next picture has ended."""

    run: str
    t: int  # dwell
    utc_s: float  # since 1970, of the dwell
    period_s: float  # between dwells, in the time of the run
    site: SiteSection
    is_simulated: bool
    tracks: tuple[Track, ...]  # by number
    plots: tuple[Plot, ...] = ()  # of the dwell, if they are wanted
    is_last: bool = False  # of its run
    is_timed: bool = False  # `utc_s` is of the dwell; else of when it was heard
    k: int = -1  # dwell, as commands count
    is_paused: bool = False

    def without_tracks(self) -> "Picture":
        """The picture after the end of the run, or of the feed."""
        return self._replace(tracks=(), plots=(), is_last=True)


class Wanted(NamedTuple):
    """What pictures are to have."""

    tentative: bool = False  # tracks that are not confirmed, too
    plots: bool = False
    site: SiteSection | None = None  # in place of the scenario's


TRACKS_ALONE = Wanted()


class Pictures:
    """One run: plans and waveforms in, a picture after each dwell out.

    The waveform of a dwell answers all plans that were there in time. A track whose plan is missing coasts.
    """

    def __init__(self, run: str, scenario: Scenario, site: SiteSection, wanted: Wanted = TRACKS_ALONE) -> None:
        self.run = run
        self._scenario, self._site, self._place = scenario, site, Place.of(site)
        self._wanted = wanted
        self._scan_rows = ScanRows.of(scenario.radar)
        self._plots: tuple[int, tuple[Plot, ...]] = (-1, ())  # of the newest scan, with its dwell
        self._measured_s: dict[int, float] = {}  # when dwells were measured, of those that no waveform has answered
        self._plans: dict[int, Plan | TrackReport] = {}  # newest of each track
        self._seen_k: dict[int, int] = {}  # when it was detected last, or began
        self._waiting: Waveform | None = None
        self._behind: set[int] = set()  # tracks whose plan that waveform waits for
        self._k, self._since_s = -1, 0.0  # dwell of the newest waveform, and when it came
        self._t, self._t_k = 0, -1  # newest dwell t that a plan told, and its k

    @property
    def due_s(self) -> float | None:
        """When the picture that waits for plans is due without them; None: none waits."""
        return None if self._waiting is None else self._since_s + WAIT_S

    def take(self, message: Message, now_s: float, utc_s: float) -> list[Picture]:
        """The pictures that a message completes.

        now_s : of the clock of `due_s`
        utc_s : time of pictures of dwells whose time neither the front end nor the site says
        """
        found = list[Picture]()
        if isinstance(message, Plan | TrackReport) and message.run == self.run:
            self._add(message)
        elif isinstance(message, Scan | DwellReport) and message.run == self.run:
            if message.k > self._k:
                if message.utc_s is not None:
                    self._measured_s[message.k] = message.utc_s
                    self._measured_s.pop(message.k - KEPT_TIMES, None)
                if self._wanted.plots and isinstance(message, Scan):
                    self._plots = message.k, self._plots_of(message)
        elif isinstance(message, Waveform) and message.run == self.run:
            if message.k <= self._k:
                return []  # redelivered
            found = self._complete(utc_s)
            self._waiting, self._k, self._since_s = message, message.k, now_s
            self._behind = {n for n, plan in self._plans.items() if plan.k < message.k}
        if self._waiting is not None and not self._behind:
            found += self._complete(utc_s)
        return found

    def late(self, now_s: float, utc_s: float) -> list[Picture]:
        """The picture that has waited for long enough."""
        return self._complete(utc_s) if self.due_s is not None and now_s >= self.due_s else []

    def _add(self, plan: Plan | TrackReport) -> None:
        before = self._plans.get(plan.target)
        if before is not None and plan.k <= before.k:
            return
        if plan.k > self._t_k:
            self._t, self._t_k = plan.t, plan.k
        if plan.k >= self._k or plan.status != "tracking":
            self._behind.discard(plan.target)
        if plan.status != "tracking":
            self._plans.pop(plan.target, None)
            return
        self._plans[plan.target] = plan
        if plan.detected or before is None:
            self._seen_k[plan.target] = plan.k

    def _complete(self, utc_s: float) -> list[Picture]:
        waveform, self._waiting = self._waiting, None
        if waveform is None:
            return []
        if waveform.roster is not None:
            alive = set(waveform.roster.ids.tolist())
            self._plans = {n: plan for n, plan in self._plans.items() if n in alive}
        self._seen_k = {n: k for n, k in self._seen_k.items() if n in self._plans}
        unknown, dt_s = self._scenario.radar.is_unknown, self._scenario.radar.motion.dt_s
        t = waveform.k + 1 if unknown else self._t + max(0, waveform.k - self._t_k) * waveform.tracking
        told_s = self._measured_s.get(waveform.k)
        self._measured_s = {k: at_s for k, at_s in self._measured_s.items() if k > waveform.k}
        stated_s = dwell_s(self._site, t, dt_s) if told_s is None else told_s
        shown = [
            self._plans[n]
            for n in sorted(self._plans)
            if self._wanted.tentative or self._plans[n].confirmed is not False
        ]
        picture = Picture(
            run=self.run,
            t=t,
            utc_s=utc_s if stated_s is None else stated_s,
            is_timed=stated_s is not None,
            k=waveform.k,
            is_paused=waveform.isotropic == 0.0 and not waveform.factor.any(),
            period_s=dt_s,
            site=self._site,
            is_simulated=self._scenario.world is not None,
            tracks=self._tracks(shown, waveform.k, dt_s),
            plots=self._plots[1] if self._plots[0] == waveform.k else (),
        )
        return [picture]

    def _plots_of(self, scan: Scan) -> tuple[Plot, ...]:
        seen = self._scan_rows.read(vars(scan))
        at = np.flatnonzero(seen.is_over() & (seen.ranges_km > 0.0))
        columns = seen.statistic[at], seen.nus[at], seen.ranges_km[at]
        at = at[np.sort(strongest_of_each(self._scan_rows.response, *columns))]
        azimuths = (self._place.boresight + np.degrees(np.arcsin(np.clip(2.0 * seen.nu_hats[at], -1.0, 1.0)))) % 360.0
        return tuple(map(Plot, seen.ranges_km[at].tolist(), azimuths.tolist()))

    def _tracks(self, plans: Sequence[Plan | TrackReport], k: int, dt_s: float) -> tuple[Track, ...]:
        if not plans:
            return ()
        states, covariances = (np.array([getattr(plan, name) for plan in plans]) for name in ("estimate", "covariance"))
        steps = np.zeros((len(plans), 4, 4)) + np.eye(4)
        steps[:, 0, 1] = steps[:, 2, 3] = [max(0, k - plan.k) * dt_s for plan in plans]
        states = np.einsum("nij,nj->ni", steps, states)
        at = self._place.positions(states[:, 0], states[:, 2])
        turns = _turns(np.radians(at.azimuths))
        # At the radar x is along the boresight; a track's velocity is turned by the azimuth of x where the track is.
        placed = np.einsum("ij,nj->ni", _turns(np.radians([self._place.boresight]))[0], states)
        moving = METRES * np.einsum("nij,nj->ni", turns, states)
        spread = METRES**2 * turns @ steps @ covariances @ steps.transpose(0, 2, 1) @ turns.transpose(0, 2, 1)
        return tuple(
            Track(
                number=plan.target + 1,
                latitude=float(at.latitudes[i]),
                longitude=float(at.longitudes[i]),
                east_km=float(placed[i, 0]),
                north_km=float(placed[i, 2]),
                velocity=(float(moving[i, 1]), float(moving[i, 3])),
                covariance=spread[i],
                confirmed=plan.confirmed is not False,
                existence=plan.existence,
                seen_s=(k - self._seen_k[plan.target]) * dt_s,
            )
            for i, plan in enumerate(plans)
        )


def _turns(azimuths: Floats) -> Floats:
    """(n, 4, 4), from [x, vx, y, vy] to east, its velocity, north, its velocity, if x has these azimuths, rad."""
    sin, cos = np.sin(azimuths), np.cos(azimuths)
    found = np.zeros((len(azimuths), 4, 4))
    for i in (0, 1):
        found[:, i, i], found[:, i, 2 + i], found[:, 2 + i, i], found[:, 2 + i, 2 + i] = sin, cos, cos, -sin
    return found
