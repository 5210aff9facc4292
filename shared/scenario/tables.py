"""What can be chosen by name: one dictionary each, name -> where its implementation is, "module:attribute".

An extension is a file of its own and a line here (docs/howto/extending.md). Addresses, not the things themselves: the
names are checked by those who must not load a solver, or must not know the world.
"""

from collections import ChainMap
from functools import cache
from pkgutil import resolve_name
from typing import Any

POWER_RULES = {  # how the transmit power is spread: a run's strategy
    "orthogonal": "shared.power.rules:orthogonal",
    "uniform": "shared.power.rules:uniform",
    "power-aware": "shared.power.rules:power_aware",
}
OBJECTIVES = {  # what power-aware beams are to achieve: `radar.allocation.objective`
    "max-min": "shared.power.rules:max_min",
    "detections": "shared.power.looks:detections",
    "urgency": "shared.power.urgency:urgency",
}
BIN_RULES = {  # which bin a track asks for next: `radar.planner.rule`
    "pomcp": "shared.planning.rules:pomcp",
    "mode": "shared.planning.rules:mode",
    "mean": "shared.planning.rules:mean",
    "exact": "shared.planning.rules:exact",
}
TRUE_RULES = {  # ... by those that know the truth, which is possible only where the world and planners are one process
    "oracle": "services.runs.oracle:true_bin",
}
RULES = ChainMap(TRUE_RULES, BIN_RULES)  # in their order, those that know the truth last
DISTURBANCES = {  # what the world draws: `world.disturbance.model`
    "ar6-t": "shared.world.disturbance:AR6_T",
    "ar3-t": "shared.world.disturbance:AR3_T",
    "compound-ar6": "shared.world.disturbance:COMPOUND_AR6",
    "white": "shared.world.disturbance:WHITE",
}


KNOWS_TRUTH = " (knows the truth)"


def marked(text: str, rule: str, most: int | None = None) -> str:
    """A text about runs with this rule of looking; it says so if the rule knows the truth. At most so long."""
    if rule not in TRUE_RULES:
        return text[:most]
    return text.removesuffix(KNOWS_TRUTH)[: None if most is None else most - len(KNOWS_TRUTH)] + KNOWS_TRUTH


@cache
def implementation(address: str) -> Any:
    """What is at an address of these tables."""
    return resolve_name(address)
