"""Sweeps: one scenario with every combination of some values, as one campaign.

All variants are played with the same seeds (common random numbers), so that what differs between them is the setting.
Each has a scenario name of its own, NAME-1, NAME-2 and so on, by which `query`, `report` and `figures` choose it. Its
title is its values, which `report` and `figures` show.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from services.errors import BadInput
from shared.scenario.files import load
from shared.scenario.scenario import MAX_TITLE, Scenario
from shared.scenario.tables import marked

MAX_AXES = 2
MAX_VARIANTS = 1000
MAX_NAME = 20 - len(f"-{MAX_VARIANTS}")  # characters of the scenario's own name in that of a variant
OVER = "must be KEY=VALUE,VALUE,... such as radar.array.n_tx=16,32,64"


@dataclass(frozen=True)
class Axis:
    """A key and its values, as they were typed."""

    key: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Variant:
    """One combination of values."""

    values: tuple[str, ...]  # one per axis
    scenario: Scenario


def axis(text: str) -> Axis:
    """From KEY=VALUE,VALUE,...; a comma within brackets or quotes is the value's own. Raises BadInput."""
    key, equals, values = text.partition("=")
    found = tuple(value.strip() for value in _split(values))
    if not equals or not key.strip() or not all(found):
        raise BadInput(f"--over {text}: {OVER}")
    if len(set(found)) < len(found):
        raise BadInput(f"--over {text}: each value once")
    return Axis(key.strip(), found)


def variants(name_or_path: str, settings: Sequence[str], axes: Sequence[Axis]) -> list[Variant]:
    """Every combination, the last key's values changing first. Raises BadInput, ScenarioError."""
    if not 1 <= len(axes) <= MAX_AXES:
        raise BadInput(f"--over: given {len(axes)} times, must be once or twice; {OVER}")
    if len({axis.key for axis in axes}) < len(axes):
        raise BadInput("--over: each key once")
    if refused := {"name", "title", "extends"} & {axis.key for axis in axes}:
        raise BadInput(f"--over {min(refused)}: not a setting that a sweep can change")
    combinations = list(product(*(axis.values for axis in axes)))
    if len(combinations) > MAX_VARIANTS:
        raise BadInput(f"--over: {len(combinations)} combinations, must be at most {MAX_VARIANTS}")
    base = load(name_or_path, settings).name[:MAX_NAME].rstrip("-")
    found = []
    for i, values in enumerate(combinations, 1):
        chosen = [f"{axis.key}={value}" for axis, value in zip(axes, values, strict=True)]
        loaded = load(name_or_path, [*settings, f"name={base}-{i}"], chosen)
        title = ", ".join(f"{axis.key} = {value}" for axis, value in zip(axes, values, strict=True))
        title = marked(title, loaded.radar.planner.rule, MAX_TITLE)
        found.append(Variant(values, loaded.model_copy(update={"title": title})))
    return found


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
