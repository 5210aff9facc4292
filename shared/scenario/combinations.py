"""Which settings of a radar work together. `cogradar check` refuses all others and names the nearest supported ones.

A supported combination is a row of `RADARS` with a row of `LOOKS`. Keys that no row names go with everything.
"""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from cogradar.shared.scenario.plugins.names import is_own
from cogradar.shared.scenario.tables import BIN_RULES, OF_CELLS, RULES

Allowed = Mapping[str, Collection[Any]]  # key of `[radar]` -> its values

UNKNOWN = "unknown"  # number of tracks
A_NUMBER, A_WIDTH, YOUR_OWN = "the number of targets", "a width above 0", "your own"  # any such value of a key
_ANY_RULE, _RULE, _OF_CELLS = (*RULES, YOUR_OWN), (*BIN_RULES, YOUR_OWN), (*OF_CELLS, YOUR_OWN)
_PARTICLES = ("likelihood", YOUR_OWN)
_BINS: Allowed = {
    "receiver.cells": ("bins",),
    "receiver.monopulse": (False,),
    "receiver.range_cell_km": (0.0,),
    "planner.rule": _ANY_RULE,
    "tracks": (A_NUMBER,),
}
_STEERED: Allowed = {
    "belief.filter": _PARTICLES,
    "receiver.cells": ("steered",),
    "receiver.monopulse": (True, False),
    "planner.rule": _RULE,
}
_MEASURED: Allowed = {
    "belief.filter": ("gaussian",),
    "receiver.monopulse": (True,),
    "receiver.range_cell_km": (A_WIDTH,),
}
RADARS: dict[str, Allowed] = {
    "robust filter": {"belief.filter": _PARTICLES, **_BINS},
    "published filter": {"belief.filter": ("published",), **_BINS},
    "steered cells": {**_STEERED, "receiver.range_cell_km": (0.0,), "tracks": (A_NUMBER,)},
    "range cells": {**_STEERED, "receiver.range_cell_km": (A_WIDTH,), "tracks": (A_NUMBER,)},
    "Gaussian filter": {**_STEERED, **_MEASURED, "tracks": (A_NUMBER, UNKNOWN)},
    "unknown number of targets": {**_STEERED, "receiver.range_cell_km": (0.0, A_WIDTH), "tracks": (UNKNOWN,)},
}
_SINGLE: Allowed = {"planner.looks": ("single",), "planner.wide_looks": (False,)}
_BARRIER: Allowed = {
    "allocation.solver": ("barrier",),
    "allocation.antennas": ("sum", "equal"),
    "allocation.beams": ("optimal", "conventional"),
}
LOOKS: dict[str, Allowed] = {
    "single looks": {**_SINGLE, "allocation.objective": ("max-min",), **_BARRIER},
    "semidefinite program": {
        **_SINGLE,
        "allocation.objective": ("max-min",),
        "allocation.solver": ("sdp",),
        "allocation.antennas": ("sum",),
        "allocation.beams": ("optimal",),
    },
    "single looks for detections": {**_SINGLE, "allocation.objective": _OF_CELLS, **_BARRIER},
    "joint looks": {
        "planner.looks": ("joint",),
        "planner.wide_looks": (True, False),
        "planner.rule": _RULE,
        "allocation.objective": _OF_CELLS,
        **_BARRIER,
    },
}
WHY = {  # what the rows cannot say of themselves
    "published filter": "Rejection is defined for bins.",
    "robust filter": "A bin has one cell for all ranges and no direction within it. Rules that know the truth name a"
    " bin.",
    "unknown number of targets": "Steered cells tell new targets from tracked ones.",
    "Gaussian filter": "Only measured directions and ranges leave a Gaussian belief.",
    "semidefinite program": "It solves max-min only, and its reduced form has no antennas to limit.",
    "joint looks": "max-min gives each track one beam and cannot choose among its cells. A rule that knows the truth"
    " leaves no cells to choose among.",
}
ROWS: dict[str, Allowed] = {
    f"{radar}, {looks}": {**RADARS[radar], **LOOKS[looks]} for radar in RADARS for looks in LOOKS
}
KEYS = tuple(dict.fromkeys(key for row in ROWS.values() for key in row))


class Cure(NamedTuple):
    """The least that makes a combination a supported one."""

    row: str
    changes: Allowed


def cures(radar: Mapping[str, Any]) -> list[Cure]:
    """Fewest changes of keys that lead to a supported combination; none: the table `[radar]` is one.

    The table has its defaults filled in. A number of tracks is changed only if nothing else will do.
    """
    values = {key: _kind(key, _at(radar, key)) for key in KEYS}
    found = [
        Cure(name, {key: allowed for key, allowed in row.items() if values[key] not in allowed})
        for name, row in ROWS.items()
    ]
    costs = [(len(cure.changes), "tracks" in cure.changes) for cure in found]
    nearest = [cure for cure, cost in zip(found, costs, strict=True) if cost == min(costs) and cure.changes]
    return [cure for i, cure in enumerate(nearest) if cure.changes not in [other.changes for other in nearest[:i]]]


def check_combination(radar: Mapping[str, Any]) -> None:
    """Raise ValueError unless the settings are a supported combination."""
    found = cures(radar)
    if found:
        keys = [key for key in KEYS if any(key in cure.changes for cure in found)]
        given = ", ".join(f"{key} = {as_toml(_at(radar, key))}" for key in keys)
        ways = "; or ".join(f'set {_words(cure.changes)} ("{cure.row}")' for cure in found)
        raise ValueError(f"{given}: no supported combination; nearest: {ways}")


def _words(changes: Allowed) -> str:
    return " and ".join(f"{key} = {one_of(allowed)}" for key, allowed in changes.items())


def one_of(allowed: Collection[Any]) -> str:
    """Values of which a key may have one, as a file has them."""
    *most, last = map(as_toml, allowed)
    return f"{', '.join(most)} or {last}" if most else last


def as_toml(value: Any) -> str:
    """A value as a file has it; a kind of values as words."""
    if isinstance(value, str) and value not in {A_NUMBER, A_WIDTH, YOUR_OWN}:
        return f'"{value}"'
    return str(value).lower() if isinstance(value, bool) else f"{value}"


def _at(radar: Mapping[str, Any], key: str) -> Any:
    value: Any = radar
    for part in key.split("."):
        value = value[part]
    return value


def _kind(key: str, value: Any) -> Any:
    if key == "tracks" and value != UNKNOWN:
        return A_NUMBER
    if isinstance(value, str) and is_own(value):
        return YOUR_OWN
    return A_WIDTH if key == "receiver.range_cell_km" and value > 0.0 else value
