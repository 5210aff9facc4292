"""What can be chosen by name: one dictionary each, name -> where its implementation is, "module:attribute".

These are the built-in ones; `plugins` finds them, and a user's own (docs/howto/extending.md). Addresses, not the things
themselves: the names are checked by those who must not load a solver, or must not know the world.
"""

from collections import ChainMap
from typing import Any

POWER_RULES = {  # how the transmit power is spread: a run's strategy
    "orthogonal": "cogradar.shared.power.rules:orthogonal",
    "uniform": "cogradar.shared.power.rules:uniform",
    "power-aware": "cogradar.shared.power.rules:power_aware",
}
OBJECTIVES = {  # what power-aware beams are to achieve: `radar.allocation.objective`
    "max-min": "cogradar.shared.power.rules:max_min",
    "detections": "cogradar.shared.power.looks:detections",
    "urgency": "cogradar.shared.power.urgency:urgency",
}
OF_CELLS = ("detections", "urgency")  # those that choose among the cells of a track, first what joint looks mean
BIN_RULES = {  # which bin a track asks for next: `radar.planner.rule`
    "pomcp": "cogradar.shared.planning.rules:pomcp",
    "mode": "cogradar.shared.planning.rules:mode",
    "mean": "cogradar.shared.planning.rules:mean",
    "exact": "cogradar.shared.planning.rules:exact",
}
TRUE_RULES = {  # ... by those that know the truth, which is possible only where the world and planners are one process
    "oracle": "cogradar.services.runs.oracle:true_bin",
}
RULES = ChainMap(TRUE_RULES, BIN_RULES)  # in their order, those that know the truth last
BELIEFS = {  # how a track keeps its belief: `radar.belief.filter`
    "likelihood": "cogradar.shared.tracking.filters:PARTICLES",
    "published": "cogradar.shared.tracking.filters:PARTICLES",
    "gaussian": "cogradar.shared.tracking.filters:MIXTURE",
}
DISTURBANCES = {  # what the world draws: `world.disturbance.model`
    "ar6-t": "cogradar.shared.world.disturbance:AR6_T",
    "ar3-t": "cogradar.shared.world.disturbance:AR3_T",
    "compound-ar6": "cogradar.shared.world.disturbance:COMPOUND_AR6",
    "white": "cogradar.shared.world.disturbance:WHITE",
    "recorded": "cogradar.shared.world.disturbance:RECORDED",
}
FROM_FILE = "recorded"  # the disturbance that is cut out of a file
SIGNALS = {  # what one look has to do with another: `world.signal`
    "cells": "cogradar.shared.world.cell_scene:CellScene",
    "array": "cogradar.shared.world.array_scene:ArrayScene",
}

REACQUIRE_BELOW = 1e-4  # `belief.reacquire_below`, of "paper" only with joint looks
_ANY_BEAMS = {"antennas": "sum", "beams": "optimal"}
# What `radar.fidelity` means for the keys that a scenario leaves out. Value "paper" is the published algorithm. Value
# "robust" has this project's cures for lost tracks (docs/explanation/departures.md). Value "best" steers its looks and
# measures directions. Value "best-range" also measures ranges.
FIDELITY: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {
        "belief": {"n_particle": 12_000, "filter": "published", "kernel_bandwidth": 0.0, "reacquire_below": 0.0},
        "planner": {"rule": "pomcp", "looks": "single", "wide_looks": False},
        "allocation": {"objective": "max-min", **_ANY_BEAMS},
        "receiver": {"cells": "bins", "monopulse": False, "range_cell_km": 0.0},
        "assumes": {"rcs": "known", "height_max_km": 0.0},
    },
    "robust": {
        # Four times as many particles take 3 % off the RMSE of `paper-best`, and nothing off the P_D (16 runs).
        "belief": {
            "n_particle": 3_000,
            "filter": "likelihood",
            "kernel_bandwidth": 0.3,
            "reacquire_below": REACQUIRE_BELOW,
        },
        "planner": {"rule": "pomcp", "looks": "single", "wide_looks": False},
        "allocation": {"objective": "max-min", **_ANY_BEAMS},
        "receiver": {"cells": "bins", "monopulse": False, "range_cell_km": 0.0},
        "assumes": {"rcs": "known", "height_max_km": 0.0},
    },
}
_BEST = FIDELITY["robust"] | {
    "planner": FIDELITY["robust"]["planner"] | {"looks": "joint"},
    "allocation": {"objective": "detections", **_ANY_BEAMS},
    "receiver": {"cells": "steered", "monopulse": True, "range_cell_km": 0.0},
}
FIDELITY |= {
    "best": _BEST,
    "best-range": _BEST
    | {"receiver": _BEST["receiver"] | {"range_cell_km": 0.5}, "assumes": {"rcs": "unknown", "height_max_km": 0.0}},
}

# What the keys mean that a scenario leaves out if the number of tracks is unknown.
IF_UNKNOWN: dict[str, dict[str, Any]] = {
    "search": {"share": "auto", "beams": "auto", "pattern": "swept"},
    "motion": {"modes": "mixture"},
    "initiation": {"false_tracks_per_hour": 1.0},
}
MOST_TRACKS = 100  # `radar.max_tracks`
LEFT_OUT = ("receiver", "assumes")  # tables of `FIDELITY` that a file need not have


def with_defaults(radar: dict[str, Any]) -> dict[str, Any]:
    """The table `[radar]` of a scenario with what the keys mean that it leaves out; what is no table stays as it is."""
    filled, fidelity = dict(radar), radar.get("fidelity")
    known = fidelity if isinstance(fidelity, str) and fidelity in FIDELITY else "robust"  # else: one error, not six
    for section, defaults in FIDELITY[known].items():
        given = filled.get(section, {} if section in LEFT_OUT else None)
        if isinstance(given, dict):
            filled[section] = defaults | given
    planner, allocation, belief = (radar.get(section) for section in ("planner", "allocation", "belief"))
    if isinstance(planner, dict) and isinstance(allocation, dict) and isinstance(belief, dict):
        if allocation.get("objective") in OF_CELLS:
            filled["planner"] = filled["planner"] | {"looks": "joint"} | planner
        if filled["planner"].get("looks") == "joint":
            filled["planner"] = filled["planner"] | {"wide_looks": True} | planner
            filled["allocation"] = filled["allocation"] | {"objective": OF_CELLS[0]} | allocation
            filled["belief"] = filled["belief"] | {"reacquire_below": REACQUIRE_BELOW} | belief
    if radar.get("tracks") == "unknown":
        filled = {"max_tracks": MOST_TRACKS} | filled
        for section, defaults in IF_UNKNOWN.items():
            given = filled.get(section, {})
            if isinstance(given, dict):
                filled[section] = defaults | given
        receiver = filled.get("receiver")
        if isinstance(belief, dict) and isinstance(receiver, dict) and _measures_places(receiver):
            filled["belief"] = filled["belief"] | {"filter": "gaussian"} | belief
    return filled


def _measures_places(receiver: dict[str, Any]) -> bool:
    """Whether directions and ranges of detections are measured."""
    measured = receiver.get("monopulse"), receiver.get("range_cell_km")
    return receiver.get("cells") == "steered" and all(map(bool, measured))


# What is said of `radar.motion.modes`.
MODES = "nearly constant velocity; or that mixed with turns, which is meant if the number of tracks is unknown"
KNOWS_TRUTH = " (knows the truth)"


def marked(text: str, rule: str, most: int | None = None) -> str:
    """A text about runs with this action-selection policy; it says so if the policy knows the truth. At most so
    long."""
    if rule not in TRUE_RULES:
        return text[:most]
    return text.removesuffix(KNOWS_TRUTH)[: None if most is None else most - len(KNOWS_TRUTH)] + KNOWS_TRUTH
