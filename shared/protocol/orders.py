"""Commands to a running radar: what each may ask for, and which orders are in force in a dwell.

An order is a command that the recorder has granted, with the first dwell that is radiated under it. What is in force in
a dwell is a function of the orders and of that dwell alone: orders that are over may be left out of the list.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from cogradar.shared.protocol.fields import Index
from cogradar.shared.protocol.roster import Compared
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.scenario.tables import BIN_RULES, OBJECTIVES, POWER_RULES

MAX_ORDERS = 80  # of a run that are in force, or will be
MAX_LOOKS = 0.5  # of the power, for all looks of a dwell that were asked for
LEAST_POWER = 0.01
MAX_LOOK_DWELLS = 100_000
MAX_PAUSE_DWELLS = 2**31 - 1
PRIORITIES = (0.1, 10.0)  # the least and the most
ACCURACIES_KM = (1e-3, 100.0)
SETTINGS = {"strategy": tuple(POWER_RULES), "rule": tuple(BIN_RULES), "objective": tuple(OBJECTIVES)}
Bearing = Annotated[float, Field(ge=-90.0, le=90.0)]  # degrees from boresight, to the side of positive y


def nu_of(bearing_deg: float) -> float:
    """Spatial frequency nu = 0.5 sin(bearing) of a bearing from boresight in degrees."""
    return 0.5 * math.sin(math.radians(bearing_deg))


class PowerLimit(Compared):
    """Transmit with at most this share of the array's power, until another limit is set; 1 is all of it."""

    kind: Literal["power"] = "power"
    share: Annotated[float, Field(ge=LEAST_POWER, le=1.0)]


class SectorSearch(Compared):
    """Search a sector never, once, or twice in each sweep. Where two sectors overlap, the later one counts.

    In a blanked sector no beam of the search and none of a track is steered: tracks there coast.
    """

    kind: Literal["sector"] = "sector"
    from_deg: Bearing
    to_deg: Bearing
    search: Literal["blank", "normal", "double"]

    @model_validator(mode="after")
    def _is_wide(self) -> Self:
        if self.from_deg >= self.to_deg:
            raise ValueError("from_deg must be below to_deg")
        return self

    @property
    def nus(self) -> tuple[float, float]:
        """Its spatial frequencies, from and to."""
        return nu_of(self.from_deg), nu_of(self.to_deg)

    @property
    def times(self) -> int:
        """Visits of each of its bins in a sweep."""
        return {"blank": 0, "normal": 1, "double": 2}[self.search]

    def contains(self, other: "SectorSearch") -> bool:
        """Whether another sector lies within this one."""
        return self.from_deg <= other.from_deg and other.to_deg <= self.to_deg

    def meets(self, other: "SectorSearch") -> bool:
        """Whether they have a direction in common."""
        return self.from_deg <= other.to_deg and other.from_deg <= self.to_deg


class Look(Compared):
    """One more beam of the search in this direction, for some dwells, with a share of the power."""

    kind: Literal["look"] = "look"
    bearing_deg: Bearing
    dwells: Annotated[int, Field(ge=1, le=MAX_LOOK_DWELLS)]
    share: Annotated[float, Field(ge=LEAST_POWER, le=MAX_LOOKS)]

    @property
    def nu(self) -> float:
        """Its spatial frequency."""
        return nu_of(self.bearing_deg)


class DropTrack(Compared):
    """End a track. A target that is detected again begins another one."""

    kind: Literal["drop"] = "drop"
    track: Index


class Priority(Compared):
    """Want so many times the signal-to-noise ratio of a track that the radar would, until it is set again; 1: as much.

    What the track takes, the others lack. The order ends with its track.
    """

    kind: Literal["priority"] = "priority"
    track: Index
    weight: Annotated[float, Field(ge=PRIORITIES[0], le=PRIORITIES[1])]


class Accuracy(Compared):
    """Know a track's place across the line of sight to this standard deviation in km, until it is asked again.

    It has the power that this takes, no more and no less, as long as there is so much. The order ends with its track.
    """

    kind: Literal["accuracy"] = "accuracy"
    track: Index
    km: Annotated[float, Field(ge=ACCURACIES_KM[0], le=ACCURACIES_KM[1])] | None  # None: as without the order


class Setting(Compared):
    """Set the run's strategy, the action-selection policy or the objective of allocation, until it is set again."""

    kind: Literal["set"] = "set"
    key: Literal["strategy", "rule", "objective"]
    value: Annotated[str, Field(max_length=40)]

    @model_validator(mode="after")
    def _is_named(self) -> Self:
        if self.value not in SETTINGS[self.key]:
            raise ValueError(f"{self.key} must be one of {', '.join(SETTINGS[self.key])}")
        return self


class Pause(Compared):
    """Radiate nothing, for some dwells or until transmission is resumed. Dwells go on, and nothing is measured."""

    kind: Literal["pause"] = "pause"
    dwells: Annotated[int, Field(ge=1, le=MAX_PAUSE_DWELLS)] | None = None  # None: until it is resumed


class Resume(Compared):
    """End a pause."""

    kind: Literal["resume"] = "resume"


class EndRun(Compared):
    """End the run, complete with the dwells before."""

    kind: Literal["end"] = "end"


OF_TRACK = Priority | Accuracy  # orders that end with their track

Action = Annotated[
    PowerLimit | SectorSearch | Look | DropTrack | Priority | Accuracy | Setting | Pause | Resume | EndRun,
    Field(discriminator="kind"),
]


class Order(Compared):
    """A granted command."""

    n: Annotated[int, Field(ge=1, le=2**31 - 1)]  # its number in the run
    k: Index  # the first dwell that is radiated under it
    action: Action


Orders = Annotated[list[Order], Field(max_length=MAX_ORDERS)]
Settings = Annotated[list[Setting], Field(min_length=1, max_length=len(SETTINGS))]


def in_force(orders: Iterable[Order], k: int) -> list[Order]:
    """What shapes dwell k, in the order in which it took effect; neither drops nor the end of the run.

    A newer power limit replaces the older one, and a pause the pause before. A setting replaces the one of the same
    key, a priority or an accuracy the one of the same track, and a sector the sectors that it contains. What is
    replaced for good, and what changes nothing, is not in force. A priority or an accuracy may be of a track that is
    not there (`of_tracks`).
    """
    begun = sorted((order for order in orders if order.k <= k), key=lambda order: (order.k, order.n))
    limits = [order for order in begun if isinstance(order.action, PowerLimit)][-1:]
    looks = [order for order in begun if isinstance(order.action, Look) and k < order.k + order.action.dwells]
    pauses = [order for order in begun if isinstance(order.action, Pause | Resume)][-1:]
    settings = {order.action.key: order for order in begun if isinstance(order.action, Setting)}
    wanted = {(order.action.kind, order.action.track): order for order in begun if isinstance(order.action, OF_TRACK)}
    found = {order.n for order in [*looks, *settings.values(), *_sectors(begun)]}
    found |= {order.n for order in wanted.values() if not _withdraws(order.action)}
    found |= {order.n for order in pauses if isinstance(order.action, Pause) and _lasts(order, order.action, k)}
    found |= {order.n for order in limits if isinstance(order.action, PowerLimit) and order.action.share < 1.0}
    return [order for order in begun if order.n in found]


def _withdraws(action: Action) -> bool:
    """Whether a track is asked for as without orders."""
    return (isinstance(action, Priority) and action.weight == 1.0) or (
        isinstance(action, Accuracy) and action.km is None
    )


def _lasts(order: Order, pause: Pause, k: int) -> bool:
    return pause.dwells is None or k < order.k + pause.dwells


def is_over(order: Order, orders: Sequence[Order], k: int) -> bool:
    """Whether an order cannot shape dwell k or a later one, for those kinds that `in_force` knows."""
    return order.k <= k and order not in in_force(orders, k)


def _sectors(begun: Iterable[Order]) -> list[Order]:
    """Of orders as they took effect the sectors that count: none that a later one contains, or that changes nothing."""
    kept: list[tuple[Order, SectorSearch]] = []
    for order in begun:
        if isinstance(sector := order.action, SectorSearch):
            kept = [(other, earlier) for other, earlier in kept if not sector.contains(earlier)] + [(order, sector)]
    counting: list[tuple[Order, SectorSearch]] = []
    for order, sector in kept:
        if sector.times != 1 or any(sector.meets(earlier) for _, earlier in counting):
            counting.append((order, sector))
    return [order for order, _ in counting]


def power_share(orders: Iterable[Order]) -> float:
    """Share of the array's power that orders in force allow."""
    return min((order.action.share for order in orders if isinstance(order.action, PowerLimit)), default=1.0)


def of_tracks(orders: Iterable[Order], born_ks: Mapping[int, int] | None) -> list[Order]:
    """Orders, but for tracks that are not there, or were not in the roster of the dwell before the order's.

    Like a drop: it must not matter which process still knows the order when a later track begins.

    born_ks : dwell with whose scan each track began, of those that are there; None: all are, and always were
    """
    return [
        order
        for order in orders
        if born_ks is None or not isinstance(order.action, OF_TRACK) or _was_there(order, order.action.track, born_ks)
    ]


def _was_there(order: Order, track: int, born_ks: Mapping[int, int]) -> bool:
    """Whether a track that is there was in the roster of the dwell before the order's."""
    return born_ks.get(track, order.k) + 1 < order.k


def priorities(orders: Iterable[Order]) -> dict[int, float]:
    """How many times the signal-to-noise ratio is wanted of a track, by orders in force; 1 of those that it lacks."""
    return {order.action.track: order.action.weight for order in orders if isinstance(order.action, Priority)}


def accuracies(orders: Iterable[Order]) -> dict[int, float]:
    """To how many km tracks are to be known across the line of sight, by orders in force."""
    asked = [order.action for order in orders if isinstance(order.action, Accuracy)]
    return {action.track: action.km for action in asked if action.km is not None}


def settings_of(orders: Iterable[Order]) -> list[Setting] | None:
    """The settings among orders in force; None: there are none."""
    return [order.action for order in orders if isinstance(order.action, Setting)] or None


def under(radar: RadarConfig, strategy: Strategy, settings: Iterable[Setting] | None) -> tuple[RadarConfig, Strategy]:
    """Radar and strategy of a dwell with these settings; both as they are without any."""
    values = {setting.key: setting.value for setting in settings or ()}
    sections: dict[str, Any] = {}
    if "rule" in values:
        sections["planner"] = radar.planner.model_copy(update={"rule": values["rule"]})
    if "objective" in values:
        sections["allocation"] = radar.allocation.model_copy(update={"objective": values["objective"]})
    return radar.model_copy(update=sections) if sections else radar, Strategy(values.get("strategy", strategy))


PAUSED = "transmission is paused"  # why nothing is measured meanwhile


def is_paused(orders: Iterable[Order]) -> bool:
    """Whether orders in force let nothing be radiated."""
    return any(isinstance(order.action, Pause) for order in orders)


def is_paused_for_some(orders: Iterable[Order]) -> bool:
    """Whether orders in force let nothing be radiated for a number of dwells."""
    return any(isinstance(order.action, Pause) and order.action.dwells is not None for order in orders)


def searches(orders: Iterable[Order], nus: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.int64]:
    """How often each direction is searched in a sweep under orders in force: 0, 1 or 2; (n,) -> (n,).

    Never nearer to a blanked sector than `margin` in nu. Both ends of the field of view, nu = -0.5 and 0.5, are one
    direction of the array: a beam at one of them has a main lobe at the other.
    """
    sectors = [order.action for order in orders if isinstance(order.action, SectorSearch)]
    if not sectors:
        return np.ones(nus.shape, np.int64)
    times = _told(sectors, nus)
    edges = np.unique([-0.5, 0.5, *(edge for sector in sectors for edge in sector.nus)])
    is_blank = _told(sectors, 0.5 * (edges[:-1] + edges[1:])) == 0
    for low, high in zip(edges[:-1][is_blank].tolist(), edges[1:][is_blank].tolist(), strict=True):
        for turn in (-1.0, 0.0, 1.0):
            times[(low - margin < nus + turn) & (nus + turn < high + margin)] = 0
    is_end = np.abs(nus) == 0.5
    times[is_end] = np.where(_told(sectors, -nus[is_end]) == 0, 0, times[is_end])
    return times


def _told(sectors: Sequence[SectorSearch], nus: NDArray[np.float64]) -> NDArray[np.int64]:
    """Visits of each direction by the sectors as they are written."""
    times = np.ones(nus.shape, np.int64)
    for sector in sectors:
        low, high = sector.nus
        times[(low <= nus) & (nus <= high)] = sector.times
    return times


def looks(orders: Iterable[Order]) -> list[Look]:
    """The looks among orders in force, none of them into a blanked sector."""
    orders = list(orders)
    asked = [order.action for order in orders if isinstance(order.action, Look)]
    if not asked:
        return []
    times = searches(orders, np.array([look.nu for look in asked]))
    return [look for look, n in zip(asked, times.tolist(), strict=True) if n]


def dropped(orders: Iterable[Order], k: int, born_ks: Mapping[int, int]) -> dict[int, int]:
    """Tracks that end before dwell k, each with the number of its order.

    An order ends only a track that is in the roster of the dwell before its own. In lockstep it therefore acts in its
    own dwell or never, although some process may know it later. Where dwells may be lost it acts in the first one that
    is made.

    born_ks : dwell with whose scan each track began, of the tracks in the roster of dwell k - 1
    """
    return {
        action.track: order.n
        for order in orders
        if isinstance(action := order.action, DropTrack) and order.k <= k and _was_there(order, action.track, born_ks)
    }


def ends(orders: Iterable[Order], k: int) -> bool:
    """Whether the run ends before dwell k."""
    return any(isinstance(order.action, EndRun) and order.k <= k for order in orders)
