"""Checks of values against each other, all of them in one table. They need not wait until all others are right."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cogradar.shared.scenario.combinations import KEYS, UNKNOWN, check_combination
from cogradar.shared.scenario.faults import Fault, Loc
from cogradar.shared.scenario.limits import (
    ALERTS,
    MAX_CELLS,
    MAX_MESSAGE_BYTES,
    MAX_PLANNER_BYTES,
    MIXTURE_STATES,
    SECONDS_PER_HOUR,
    beliefs_bytes,
    tree_bytes,
    waveform_bytes,
)
from cogradar.shared.scenario.tables import MOST_TRACKS, with_defaults
from cogradar.shared.signal.array import angle_bin, in_plane, spatial_frequency

FEWEST_RANGE_CELLS = 16  # that tell the noise of others
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
        t, x, y = np.array(target["trajectory"], dtype=np.float64).T[:3]
        place = [float(np.interp(0.0, t, values)) for values in (x, y)]
        if t[0] <= 0.0 <= t[-1] and place[0] >= 0.0:
            found[m] = [place[0], 0.0, place[1], 0.0]
    return found


def measured_at_start(targets: Sequence[Mapping[str, Any]]) -> dict[int, list[float]]:
    """The same where the array measures them, with their heights: `array.in_plane`. KeyError if one has no state."""
    found = at_start(targets)
    for m, state in found.items():
        if not state:
            raise KeyError("state")
        height, rows = targets[m].get("height_km", 0.0), targets[m].get("trajectory")
        columns = np.array([[]] if rows is None else rows).T
        if len(columns) > 3:
            height = np.interp(0.0, columns[0], columns[3])
        found[m] = in_plane(state, height).tolist()
    return found


def check_tracks(tracks: int | str, n_start: int, n_target: int) -> None:
    """Raise ValueError if the radar is told a number of tracks that differs from the number of targets at the start."""
    if tracks not in {n_start, UNKNOWN}:
        some = " that are there at the start" if n_start < n_target else ""
        raise ValueError(f"radar.tracks = {tracks}: must be the number of world.targets{some}, {n_start}")


def check_ranges(low_km: float, high_km: float) -> None:
    """Raise ValueError unless the ranges at which targets may be found are some."""
    if high_km <= low_km:
        raise ValueError(f"range_max_km = {high_km:g} must be above range_min_km = {low_km:g}")


def check_apart(states: Mapping[int, Sequence[float]], n_bin: int, cells: str, tracks: int | str) -> None:
    """Raise ValueError if two targets start too near to each other; by index, where the array measures them.

    Bins hold one target each; in neighbouring steered cells each target is heard in both. Tracks of an unknown number
    are not acquired all at once: their targets may be anywhere.
    """
    if tracks == UNKNOWN:
        return
    apart = APART[cells]
    bins = angle_bin(spatial_frequency(np.array(list(states.values()), dtype=np.float64).reshape(-1, 4)), n_bin)
    numbers = [m + 1 for m in states]
    for m, bin_ in enumerate(bins):
        off = np.abs(bins[:m] - bin_)
        near = np.flatnonzero(np.minimum(off, n_bin - 1 - off) < apart)
        if near.size:
            one = bins[near[0]]
            where = f"the same angle bin {bin_}" if one == bin_ and apart == 1 else f"angle bins {one} and {bin_}"
            must = "in two" if apart == 1 else f'{apart} bins apart with receiver.cells = "{cells}"'
            must += ": bins at both ends are one direction" if abs(one - bin_) > apart else ""
            pair = f"#{numbers[near[0]]} and #{numbers[m]}"
            raise ValueError(f"world.targets {pair} start in {where} of {n_bin}, must start {must}")


def check_elements(dead: Sequence[int], n: int) -> None:
    """Raise ValueError if a dead antenna has a number beyond the last one."""
    if beyond := [i for i in dead if i > n]:
        raise ValueError(f"must be antennas 1 .. {n}, not {beyond[0]}")


def check_element_errors(errors: Sequence[Any], n: int) -> None:
    """Raise ValueError unless each antenna has an error, or none has."""
    if errors and len(errors) != n:
        raise ValueError(f"has {len(errors)} rows, must have one of each antenna, {n}")


def check_noise(noise: str, range_cell_km: float, low_km: float, high_km: float, signal: str | None) -> None:
    """Raise ValueError if a look's noise is to be estimated from other range cells, and there are too few."""
    if noise != "range-cells":
        return
    n = (high_km - low_km) / range_cell_km if range_cell_km > 0.0 else 1.0
    if n < FEWEST_RANGE_CELLS:
        raise ValueError(
            f'noise = "{noise}": needs {FEWEST_RANGE_CELLS} range cells between radar.acquisition.range_min_km and'
            f" range_max_km, has {int(n)}: set a smaller radar.receiver.range_cell_km above 0"
        )
    if signal == "cells":
        raise ValueError(f'noise = "{noise}": needs world.signal = "array"; in cells each look has a noise of its own')


def check_memory(n_sim: int, n_bin: int, n_particle: int | None, tracks: int) -> None:
    """Raise ValueError if a planner that owns every track would need too much memory.

    n_particle : None, if beliefs are of Gaussians
    """
    tree, beliefs = tree_bytes(n_sim, n_bin), beliefs_bytes(n_particle or MIXTURE_STATES, tracks)
    each = "Gaussians" if n_particle is None else f"belief.n_particle = {n_particle}"
    if tree + beliefs > MAX_PLANNER_BYTES:
        raise ValueError(
            f"a planner would need {tree / 1e9:.2f} GB for its search tree (planner.n_sim = {n_sim},"
            f" array.n_bin = {n_bin}) and {beliefs / 1e9:.2f} GB for the beliefs ({each},"
            f" tracks = {tracks}), must be at most {MAX_PLANNER_BYTES / 1e9:g} GB together"
        )


def check_waveform(n_tx: int, n_bin: int, cells: str, tracks: int) -> None:
    """Raise ValueError if a waveform that lights all that tracks ask for could be longer than a message.

    cells : bins, which several tracks may share, or steered ones
    """
    n_column = MAX_CELLS * tracks if cells == "steered" else min(MAX_CELLS * tracks, n_bin)
    if (n_byte := waveform_bytes(n_tx, n_column, tracks)) > MAX_MESSAGE_BYTES:
        raise ValueError(
            f"a waveform of tracks = {tracks} with array.n_tx = {n_tx} may need {n_byte / 2**20:.1f} MiB, must be at"
            f" most {MAX_MESSAGE_BYTES >> 20} MiB"
        )


def check_false_tracks(per_hour: float, dt_s: float) -> None:
    """Raise ValueError for more false tracks than the search has detections of noise."""
    most = ALERTS * SECONDS_PER_HOUR / dt_s
    if per_hour > most:
        raise ValueError(
            f"false_tracks_per_hour = {per_hour:g}: must be at most {most:g}, as the search has {ALERTS:g} detections"
            f" of noise in a dwell of motion.dt_s = {dt_s:g} s"
        )


def check_dwell_time(v_max_km_s: float, range_max_km: float, dt_s: float) -> None:
    """Raise ValueError if a target may cross the field of view in a dwell: no look would tell anything of the next."""
    if v_max_km_s * dt_s >= range_max_km:
        raise ValueError(
            f"v_max_km_s = {v_max_km_s:g}: in a dwell of motion.dt_s = {dt_s:g} s a target flies"
            f" {v_max_km_s * dt_s:g} km, must be less than range_max_km = {range_max_km:g}: shorten motion.dt_s"
        )


def check_known(radar: Mapping[str, Any]) -> None:
    """Raise ValueError for keys that tracks of a known number have no use for; of a valid or decoded table."""
    given = [name for name in OF_UNKNOWN if radar.get(name) is not None]
    if given and radar["tracks"] != UNKNOWN:
        raise ValueError(f'tracks = {radar["tracks"]}: {" and ".join(given)} must be left out, need tracks = "unknown"')


def _at_start(targets: Any, found: Callable[[Any], dict[int, list[float]]] = at_start) -> dict[int, list[float]]:
    """Of decoded tables that may be wrong: KeyError if it cannot be said."""
    try:
        return found(targets)
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
        lambda n_bin, cells, tracks, targets, *_: check_apart(
            _at_start(targets, measured_at_start), n_bin, cells, tracks
        ),
        "",
        (
            "radar.array.n_bin",
            "radar.receiver.cells",
            "radar.tracks",
            *(f"world.targets.{ANY}.{key}" for key in ("state", "height_km", "trajectory", "born_s")),
        ),
    ),
    (
        lambda n_sim, n_bin, n_particle, radar: check_memory(
            n_sim, n_bin, None if radar["belief"]["filter"] == "gaussian" else n_particle, _most_tracks(radar)
        ),
        "radar",
        ("radar.planner.n_sim", "radar.array.n_bin", "radar.belief.n_particle", f"radar.{LENGTH}"),
    ),
    (
        lambda n_tx, n_bin, cells, radar: check_waveform(n_tx, n_bin, cells, _most_tracks(radar)),
        "radar",
        ("radar.array.n_tx", "radar.array.n_bin", "radar.receiver.cells", f"radar.{LENGTH}"),
    ),
    (
        lambda *given: check_combination(given[-1]),
        "radar",
        ("radar.fidelity", *(f"radar.{key}" for key in KEYS), f"radar.{LENGTH}"),
    ),
    (
        lambda noise, width, low, high, tables: check_noise(
            noise, width, low, high, (tables.get("world") or {}).get("signal", "cells") if tables.get("world") else None
        ),
        "radar.receiver",
        (
            "radar.receiver.noise",
            "radar.receiver.range_cell_km",
            "radar.acquisition.range_min_km",
            "radar.acquisition.range_max_km",
            LENGTH,
        ),
    ),
    (check_elements, "world.array.dead_tx", ("world.array.dead_tx", "radar.array.n_tx")),
    (check_elements, "world.array.dead_rx", ("world.array.dead_rx", "radar.array.n_rx")),
    (check_element_errors, "world.array.tx_errors", (f"world.array.tx_errors.{LENGTH}", "radar.array.n_tx")),
    (check_element_errors, "world.array.rx_errors", (f"world.array.rx_errors.{LENGTH}", "radar.array.n_rx")),
    (lambda _, radar: check_known(radar), "radar", ("radar.tracks", f"radar.{LENGTH}")),
    (
        check_dwell_time,
        "radar.acquisition",
        ("radar.acquisition.v_max_km_s", "radar.acquisition.range_max_km", "radar.motion.dt_s"),
    ),
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
        # Missing, no table, or a number beyond all numbers: it has a line already.
        except (AttributeError, KeyError, TypeError, IndexError, OverflowError):
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
