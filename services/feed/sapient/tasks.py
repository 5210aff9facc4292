"""What a SAPIENT task asks for, as an action of `cogradar command`; or why the radar cannot do it.

Each function raises ValueError, whose text is for the node that sent the task. Bearings are from boresight, degrees.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cogradar.services.feed.picture import Picture, Track
from cogradar.services.skies.place import Place
from cogradar.shared.protocol.orders import Accuracy, Action, Look, Pause, Priority, Resume, SectorSearch
from cogradar.shared.protocol.words.orders import action_of, parsed, text_of
from cogradar.shared.scenario.scenario import SiteSection

MODE, PAUSED = "search and track", "pause"  # modes of the radar
LOOK_S = 10.0  # of a look without an end
LOOK_SHARE = 0.2  # of the power
FOLLOW_WEIGHT = 4.0  # of the priority of a track
TAKEN = ("look_at", "follow", "mode_change", "request")
_REQUESTS = {"stop": "pause", "start": "resume"}  # as the simulator of a node by Dstl has them
_MODES = {PAUSED: "pause", MODE: "resume", "resume": "resume"}
_SEARCHES = {1: "double", 2: "blank"}  # by type of a region: of interest, to be ignored
_RADIANS, _KNOWN_UNITS = {2, 4}, {1, 2, 3, 4}  # of directions: degrees and radians, with m and with km
_TRUE_NORTH, _PLACE_DEGREES, _PLACE_RADIANS = 1, 1, 2


class Wanted(NamedTuple):
    """An action that a task asks for."""

    action: Action
    at: int = 0  # not before this dwell
    until_s: float = math.inf  # UTC, after which it is to be undone; an action with a number of dwells ends by itself
    follows: str = ""  # object with which the task ends; empty: none


def wanted_of(task: Any, picture: Picture, shown: Mapping[str, Track]) -> Wanted:
    """The action of a task that is to be started.

    picture : the newest one, whose clock start and end of the task are compared with
    shown : its tracks by object
    """
    if len(task.region) + task.HasField("command") != 1:
        raise ValueError("a task must have either one region or one command")
    start_s, until_s = (
        getattr(task, name).ToNanoseconds() / 1e9 if task.HasField(name) else default
        for name, default in (("task_start_time", picture.utc_s), ("task_end_time", math.inf))
    )
    start_s = max(start_s, picture.utc_s)
    if until_s <= start_s:
        raise ValueError("task_end_time: must be after task_start_time, and not be over")
    wait = math.ceil((start_s - picture.utc_s) / picture.period_s)
    at = picture.k + wait if wait else 0
    if task.region:
        return _ending(Wanted(_of_region(task.region[0], picture.site), at, until_s))
    dwells = None if until_s == math.inf else max(1, round((until_s - start_s) / picture.period_s))
    action = _of_command(task.command, picture, shown, dwells)
    if isinstance(action, Look | Pause):
        return Wanted(action, at)
    return _ending(Wanted(action, at, until_s, task.command.follow.follow_object_id))


def _ending(wanted: Wanted) -> Wanted:
    """The same, if it can be ended when it is to be."""
    if wanted.until_s != math.inf and undone(wanted.action) is None:
        raise ValueError(f"task_end_time: nothing takes back `{text_of(wanted.action)}`")
    return wanted


def undone(action: Action) -> Action | None:
    """What takes an action back; None: nothing does."""
    match action:
        case SectorSearch():
            return action.model_copy(update={"search": "normal"})
        case Priority():
            return action.model_copy(update={"weight": 1.0})
        case Accuracy():
            return action.model_copy(update={"km": None})
        case Pause():
            return Resume()
        case _:
            return None


def _of_command(command: Any, picture: Picture, shown: Mapping[str, Track], dwells: int | None) -> Action:
    if command.command_parameter:
        raise ValueError("command_parameter: this radar takes none")
    match command.WhichOneof("command"):
        case "look_at":
            told = max(1, round(LOOK_S / picture.period_s)) if dwells is None else dwells
            bearing = _centre(command.look_at, picture.site)
            return action_of({"kind": "look", "bearing_deg": bearing, "dwells": told, "share": LOOK_SHARE})
        case "follow":
            name = command.follow.follow_object_id
            if name not in shown:
                raise ValueError(f"follow: {name[:40]!r} is no object of the newest reports")
            return action_of({"kind": "priority", "track": shown[name].number, "weight": FOLLOW_WEIGHT})
        case "mode_change":
            words = _MODES.get(command.mode_change)
            if words is None:
                raise ValueError(f"mode_change: {command.mode_change[:40]!r}: must be {MODE!r} or {PAUSED!r}")
            return _timed(parsed([words]), dwells)
        case "request":
            words = _REQUESTS.get(command.request.strip().lower(), command.request)
            return _timed(parsed(words.split()), dwells)
        case other:
            raise ValueError(f"{other or 'command'}: this radar takes {', '.join(TAKEN)}, and regions")


def _timed(action: Action, dwells: int | None) -> Action:
    """A pause for as long as its task; other actions as they are."""
    if isinstance(action, Pause) and action.dwells is None and dwells is not None:
        return action_of({"kind": "pause", "dwells": dwells})
    return action


def _of_region(region: Any, site: SiteSection) -> Action:
    search = _SEARCHES.get(region.type)
    if search is None:
        raise ValueError("region: must be an area of interest or one to be ignored")
    if region.class_filter or region.behaviour_filter:
        raise ValueError("region: this radar has no filters of classes and behaviours")
    area = region.region_area
    if search == "blank" and not (area.HasField("range_bearing") and area.range_bearing.range == 0.0):
        raise ValueError("region to be ignored: a sector is blanked at all ranges; give range_bearing without a range")
    low, high = _edges(area, site)
    return action_of({"kind": "sector", "search": search, "from_deg": low, "to_deg": high})


def _centre(area: Any, site: SiteSection) -> float:
    """Bearing of a place or a cone, whose range, elevation and extent a beam lacks."""
    if area.HasField("range_bearing"):
        return _in_view(_azimuth(area.range_bearing) - site.boresight_deg)
    places = area.location_list.locations
    if len(places) != 1:
        raise ValueError(f"look_at: {len(places)} locations: must be one, or range_bearing")
    return _bearings(places, site)[0]


def _edges(area: Any, site: SiteSection) -> tuple[float, float]:
    """From which bearing to which an area is seen."""
    if not area.HasField("range_bearing"):
        places = area.location_list.locations
        if len(places) < 2:
            raise ValueError(f"region_area: {len(places)} locations: must be 2 or more, or range_bearing")
        bearings = _bearings(places, site)
        return min(bearings), max(bearings)
    cone = area.range_bearing
    extent = _degrees(cone.horizontal_extent, cone.coordinate_system)
    if not 0.0 < extent <= 180.0:
        raise ValueError(f"horizontal_extent: {extent:g} degrees: must be above 0, at most 180")
    centre = _turned(_azimuth(cone) - site.boresight_deg)
    return _in_view(centre - 0.5 * extent), _in_view(centre + 0.5 * extent)


def _azimuth(cone: Any) -> float:
    if cone.datum != _TRUE_NORTH:
        raise ValueError("datum: must be RANGE_BEARING_DATUM_TRUE, for azimuths from true north")
    return _degrees(cone.azimuth, cone.coordinate_system)


def _degrees(value: float, units: int) -> float:
    if units not in _KNOWN_UNITS:
        raise ValueError("coordinate_system: must say degrees or radians")
    return math.degrees(value) if units in _RADIANS else value


def _bearings(places: Sequence[Any], site: SiteSection) -> list[float]:
    here, found = Place.of(site), []
    for place in places:
        if place.coordinate_system not in {_PLACE_DEGREES, _PLACE_RADIANS}:
            raise ValueError("coordinate_system of a location: must be latitude and longitude")
        is_radians = place.coordinate_system == _PLACE_RADIANS
        longitude, latitude = (math.degrees(value) if is_radians else value for value in (place.x, place.y))
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
            raise ValueError(f"location: y = {latitude:g}, x = {longitude:g}: must be a latitude and a longitude")
        x, y = here.seen(latitude, longitude)
        found.append(_in_view(math.degrees(math.atan2(y, x))))
    return found


def _turned(bearing: float) -> float:
    """-180 .. 180."""
    return (bearing + 180.0) % 360.0 - 180.0


def _in_view(bearing: float) -> float:
    """A bearing that the array can be steered to, in steps that hide the rounding of angles."""
    bearing = round(_turned(bearing), 4)
    if not abs(bearing) <= 90.0:
        raise ValueError(f"{bearing:g} degrees from boresight: must be -90 .. 90")
    return bearing
