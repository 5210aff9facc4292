"""Sweeps: one scenario with every combination of some values, as one campaign.

All variants are played with the same seeds (common random numbers), so that what differs between them is the setting.
Each has a scenario name of its own, NAME-1, NAME-2 and so on, by which `query`, `report` and `figures` choose it. Its
title is its values, which `report` and `figures` show.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import prod

from cogradar.services.errors import BadInput
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.scenario import MAX_TITLE, Scenario
from cogradar.shared.scenario.tables import marked

MAX_VARIANTS = 1000
MAX_NAME = 20 - len(f"-{MAX_VARIANTS}")  # characters of the scenario's own name in a variant's name
OVER = (
    "must be KEY=VALUE,VALUE,... such as radar.array.n_tx=16,32,64, or KEY,KEY=VALUE,... for keys that change together"
)
FIXED = ("name", "title", "extends")


@dataclass(frozen=True)
class Axis:
    """Keys that take the same value, and their values, as they were typed."""

    keys: tuple[str, ...]  # more than one: linked
    values: tuple[str, ...]

    @property
    def name(self) -> str:
        """All keys, as in --over."""
        return ",".join(self.keys)


@dataclass(frozen=True)
class Variant:
    """One combination of values."""

    values: tuple[str, ...]  # one per axis
    scenario: Scenario


def axis(text: str) -> Axis:
    """From KEY[,KEY]=VALUE,...; a comma within brackets or quotes belongs to the value. Raises BadInput."""
    names, equals, values = text.partition("=")
    keys = tuple(key.strip() for key in names.split(","))
    found = tuple(value.strip() for value in _split(values))
    if not equals or not all(keys) or not all(found):
        raise BadInput(f"--over {text}: {OVER}")
    if len(set(found)) < len(found):
        raise BadInput(f"--over {text}: must have each value once; leave out the second {_repeated(found)}")
    return Axis(keys, found)


def variants(name_or_path: str, settings: Sequence[str], axes: Sequence[Axis]) -> list[Variant]:
    """Every combination, the last axis' values changing first. Raises BadInput, ScenarioError."""
    keys = [key for axis in axes for key in axis.keys]
    if not axes:
        raise BadInput(f"--over: {OVER}")
    if len(set(keys)) < len(keys):
        raise BadInput(f"--over {_repeated(keys)}: must be on one axis only; name each key once")
    if refused := set(FIXED) & set(keys):
        raise BadInput(f"--over {min(refused)}: must be a setting of the radar or the world, not {', '.join(FIXED)}")
    if (n := prod(len(axis.values) for axis in axes)) > MAX_VARIANTS:
        raise BadInput(f"--over: {n} combinations, must be at most {MAX_VARIANTS}; leave out values or split the sweep")
    base = load(name_or_path, settings).name[:MAX_NAME].rstrip("-")
    found = []
    for i, values in enumerate(product(*(axis.values for axis in axes)), 1):
        chosen = [f"{key}={value}" for axis, value in zip(axes, values, strict=True) for key in axis.keys]
        loaded = load(name_or_path, [*settings, f"name={base}-{i}"], chosen)
        title = ", ".join(f"{axis.name} = {value}" for axis, value in zip(axes, values, strict=True))
        title = marked(title, loaded.radar.planner.rule, MAX_TITLE)
        found.append(Variant(values, loaded.model_copy(update={"title": title})))
    return found


def baseline(text: str, axes: Sequence[Axis]) -> tuple[int, str]:
    """The axis, by its place, and the value that KEY=VALUE names. Raises BadInput."""
    key, _, value = text.partition("=")
    for place, axis in enumerate(axes):
        if key in (axis.name, *axis.keys) and value in axis.values:
            return place, value
    known = " or ".join(f"{axis.name}={value}" for axis in axes for value in axis.values)
    raise BadInput(f"--against {text}: must be one value of an axis: {known}")


def _repeated(names: Sequence[str]) -> str:
    return next(name for i, name in enumerate(names) if name in names[:i])


def _split(text: str) -> list[str]:
    """Parts between the commas that are in no brackets and no quotes."""
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        else:
            depth += (character in "[{") - (character in "]}")
        if character == "," and not quote and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts
