"""Variants of a sweep compared with those that have one value of an axis, on the same seeds.

The target is the one that the baseline detects least in the last dwells. A difference is the variant's value minus the
baseline's, with a 95 % interval over the seeds that both played.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

from cogradar.services.analysis.report import Sample, differences, last_dwells, sample_of
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput
from cogradar.services.metrics.experiments import Experiment, experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store
from cogradar.services.sweeps.grid import Axis, Variant
from cogradar.services.sweeps.results import Rows, axis_columns, with_labels

ENDS = ("", "_low", "_high")
ALL_DWELLS = ("p_d", "position_rmse_km")
NAMES = tuple(f"{name}_difference{end}" for name in (*ALL_DWELLS, "p_d_last") for end in ENDS)


def compared(found: Rows, store: Store, variants: Sequence[Variant], place: int, value: str) -> Rows:
    """The rows of a sweep with their differences to the baseline.

    None for the baseline itself, and where runs are missing or have other numbers of dwells or targets.
    """
    targets = {(row["scenario"], row["strategy"]): row["target"] for row in found}
    partners = {variant.values: variant.scenario.name for variant in variants}
    of_variant = {variant.scenario.name: variant.values for variant in variants}
    try:
        played = {one.scenario: one for one in experiments(store, Selection.of({"run": "all"}))}
    except BadInput:  # no run is complete
        played = {}

    @cache
    def sample(scenario: str, strategy: str) -> Sample:
        return sample_of(store, played[scenario], strategy)

    rows = []
    for row in found:
        own, strategy = row["scenario"], row["strategy"]
        values = of_variant[own]
        base = partners[(*values[:place], value, *values[place + 1 :])]
        is_pair = own != base and _are_alike(played.get(own), played.get(base), strategy)
        pair = {"baseline": sample(base, strategy), "variant": sample(own, strategy)} if is_pair else {}
        rows.append(row | _difference(pair, targets[base, strategy]))
    return rows


def _are_alike(one: Experiment | None, other: Experiment | None, strategy: str) -> bool:
    if one is None or other is None or not {strategy} <= set(one.strategies) & set(other.strategies):
        return False
    sizes = [(each.dwells, each.of(strategy)[0]["n_target"]) for each in (one, other)]
    return sizes[0] == sizes[1]


def _difference(pair: dict[str, Sample], target: int | None) -> dict[str, Any]:
    """The columns of a row about a target, counted from 1."""
    unknown = {"pairs": None, "compared_target": None} | dict.fromkeys(NAMES)
    if not pair or target is None:
        return unknown
    dwells = pair["baseline"].detected.shape[1]
    windows = (1, dwells), last_dwells(dwells)
    found = [row for window in windows for row in differences(pair, window) if row["target"] == target]
    if not found:  # no seed that both played
        return unknown
    whole, last = found
    row = {"pairs": whole["runs"], "compared_target": target}
    row |= {f"{name}_difference{end}": whole[name + end] for name in ALL_DWELLS for end in ENDS}
    return row | {f"p_d_last_difference{end}": last[f"p_d{end}"] for end in ENDS}


def table(found: Rows, axes: Sequence[Axis], place: int, value: str) -> Table:
    """The differences in P_D; those in RMSE are in the rows only."""

    def columns(heading: str, name: str) -> list[Column]:
        low_high = f"{{{name}_difference_low:+z.4f}} {{{name}_difference_high:+z.4f}}"
        return [Column(heading, f"{{{name}_difference:+z.4f}}"), Column("95 %", low_high)]

    head = [Column("strategy", "{strategy}", left=True), Column("pairs", "{pairs}")]
    head += [Column("target", "{compared_target}"), *columns("P_D", "p_d"), *columns("last dwells", "p_d_last")]
    shown = [row for row in with_labels(found, axes) if row["pairs"] is not None]
    title = f"Minus {axes[place].name} = {value}, on the same seeds"
    return Table(title, [*axis_columns(axes), *head], shown, "axis_0")
