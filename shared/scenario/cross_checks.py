"""Checks of values against each other, all of them in one table. They need not wait until all others are right."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cogradar.shared.scenario.combinations import KEYS, UNKNOWN, check_combination
from cogradar.shared.scenario.faults import Fault, Loc
from cogradar.shared.scenario.limits import ALERTS, MAX_PLANNER_BYTES, SECONDS_PER_HOUR, beliefs_bytes, tree_bytes
from cogradar.shared.scenario.tables import MOST_TRACKS, with_defaults
from cogradar.shared.signal.array import angle_bin, spatial_frequency

OF_UNKNOWN = ("max_tracks", "search", "initiation")  # keys of `[radar]` that are for those alone
APART = {"bins": 1, "steered": 2}  # bins between targets that start together, by `radar.receiver.cells`


def at_start(targets: Sequence[Mapping[str, Any]]) -> dict[int, list[float]]:
    """Index and state [x, vx, y, vy] of the targets that are there when a run begins; of valid or decoded tables."""
    found = {}
    for m, target in enumerate(targets):
        if target.get("born_s", 0.0) > 0.0:
            continue
        if target.get("trajectory") is None:
            found[m] = target.get("state", [])
            continue
        t, x, y = np.array(target["trajectory"], dtype=np.float64).T
        place = [float(np.interp(0.0, t, values)) for values in (x, y)]
        if t[0] <= 0.0 <= t[-1] and place[0] >= 0.0:
            found[m] = [place[0], 0.0, place[1], 0.0]
    return found


def check_tracks(tracks: int | str, n_start: int, n_target: int) -> None:
    """Raise ValueError if the radar is told a number of tracks that is not that of the targets at the start."""
    if tracks not in {n_start, UNKNOWN}:
        some = " that are there at the start" if n_start < n_target else ""
        raise ValueError(f"radar.tracks = {tracks}: must be the number of world.targets{some}, {n_start}")


def check_ranges(low_km: float, high_km: float) -> None:
    """Raise ValueError unless the ranges at which targets may be found are some."""
    if high_km <= low_km:
        raise ValueError(f"range_max_km = {high_km:g} must be above range_min_km = {low_km:g}")


def check_apart(states: Mapping[int, Sequence[float]], n_bin: int, cells: str, tracks: int | str) -> None:
    """Raise ValueError if two targets start too near to each other; by index, [x, vx, y, vy] in km and km/s.

    Bins hold one target each; in neighbouring steered cells each target is heard in both. Tracks of an unknown number
    are not acquired all at once: their targets may be anywhere.
    """
    if tracks == UNKNOWN:
        return
    apart = APART[cells]
    bins = angle_bin(spatial_frequency(np.array(list(states.values()), dtype=np.float64).reshape(-1, 4)), n_bin)
    numbers = [m + 1 for m in states]
    for m, bin_ in enumerate(bins):
        near = np.flatnonzero(np.abs(bins[:m] - bin_) < apart)
        if near.size:
            one = bins[near[0]]
            where = f"the same angle bin {bin_}" if apart == 1 else f"angle bins {one} and {bin_}"
            must = "in two" if apart == 1 else f'{apart} bins apart with receiver.cells = "{cells}"'
            pair = f"#{numbers[near[0]]} and #{numbers[m]}"
            raise ValueError(f"world.targets {pair} start in {where} of {n_bin}, must start {must}")


def check_memory(n_sim: int, n_bin: int, n_particle: int, tracks: int) -> None:
    """Raise ValueError if a planner that owns every track would need too much memory."""
    tree, beliefs = tree_bytes(n_sim, n_bin), beliefs_bytes(n_particle, tracks)
    if tree + beliefs > MAX_PLANNER_BYTES:
        raise ValueError(
            f"a planner would need {tree / 1e9:.2f} GB for its search tree (planner.n_sim = {n_sim},"
            f" array.n_bin = {n_bin}) and {beliefs / 1e9:.2f} GB for the beliefs (belief.n_particle = {n_particle},"
            f" tracks = {tracks}), must be at most {MAX_PLANNER_BYTES / 1e9:g} GB together"
        )


def check_false_tracks(per_hour: float, dt_s: float) -> None:
    """Raise ValueError for more false tracks than the search has detections of noise."""
    most = ALERTS * SECONDS_PER_HOUR / dt_s
    if per_hour > most:
        raise ValueError(
            f"false_tracks_per_hour = {per_hour:g}: must be at most {most:g}, as the search has {ALERTS:g} detections"
            f" of noise in a dwell of motion.dt_s = {dt_s:g} s"
        )


def check_known(radar: Mapping[str, Any]) -> None:
    """Raise ValueError for keys that tracks of a known number have no use for; of a valid or decoded table."""
    given = [name for name in OF_UNKNOWN if radar.get(name) is not None]
    if given and radar["tracks"] != UNKNOWN:
        raise ValueError(f'tracks = {radar["tracks"]}: {" and ".join(given)} must be left out, need tracks = "unknown"')


def _at_start(targets: Any) -> dict[int, list[float]]:
    """Of decoded tables that may be wrong: KeyError if it cannot be said."""
    try:
        return at_start(targets)
    except ValueError as error:
        raise KeyError("targets") from error


def _most_tracks(radar: Mapping[str, Any]) -> int:
    """As many tracks as there are, or as there may be at once."""
    tracks = radar["tracks"]
    most: int = (radar.get("max_tracks") or MOST_TRACKS) if tracks == UNKNOWN else tracks
    return most


LENGTH, ANY = "#", "*"  # of a list, whatever is wrong within; any entry of it
# Check, its table, keys of what its arguments are made of.
_TABLE: tuple[tuple[Callable[..., None], str, tuple[str, ...]], ...] = (
    (
        lambda tracks, targets: check_tracks(tracks, len(_at_start(targets)), len(targets)),
        "",
        ("radar.tracks", f"world.targets.{LENGTH}"),
    ),
    (check_ranges, "radar.acquisition", ("radar.acquisition.range_min_km", "radar.acquisition.range_max_km")),
    (
        lambda targets, n_bin, cells, tracks: check_apart(_at_start(targets), n_bin, cells, tracks),
        "",
        (f"world.targets.{ANY}.state", "radar.array.n_bin", "radar.receiver.cells", "radar.tracks"),
    ),
    (
        lambda n_sim, n_bin, n_particle, radar: check_memory(n_sim, n_bin, n_particle, _most_tracks(radar)),
        "radar",
        ("radar.planner.n_sim", "radar.array.n_bin", "radar.belief.n_particle", f"radar.{LENGTH}"),
    ),
    (
        lambda *given: check_combination(given[-1]),
        "radar",
        ("radar.fidelity", *(f"radar.{key}" for key in KEYS), f"radar.{LENGTH}"),
    ),
    (lambda _, radar: check_known(radar), "radar", ("radar.tracks", f"radar.{LENGTH}")),
    (check_false_tracks, "radar.initiation", ("radar.initiation.false_tracks_per_hour", "radar.motion.dt_s")),
)


def cross_faults(tables: dict[str, Any], known: Sequence[Fault] = ()) -> list[Fault]:
    """What is wrong with values of a document together; those with a fault of their own are left out."""
    wrong = [fault.loc for fault in known if fault.value]
    found = []
    if isinstance(tables.get("radar"), dict):
        tables = tables | {"radar": with_defaults(tables["radar"])}
    for check, table, keys in _TABLE:
        paths = [key.split(".") for key in keys]
        if any(_overlap(path, loc) for path in paths for loc in wrong):
            continue
        try:
            check(*(_at(tables, path) for path in paths))
        except (AttributeError, KeyError, TypeError, IndexError):  # missing, or no table, which has a line already
            continue
        except ValueError as error:
            found.append(Fault(table.split(".") if table else [], "", str(error)))
    return found


def _overlap(path: Loc, loc: Loc) -> bool:
    return all(a in {b, ANY} for a, b in zip(path, loc, strict=False))


def _at(tables: Any, path: Sequence[str]) -> Any:
    for key in path:
        if key in {LENGTH, ANY}:
            break
        tables = tables[key]
    return tables
