"""Results of a sweep: one row per variant and strategy; of one or two axes also a figure.

Each row has the lowest P_D of a target and the largest position RMSE of a target, which may be another one, over the
last dwells of the runs, with the report's intervals over runs. `lost` counts the lost tracks of all targets. Whole runs
have rows of their own.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cogradar.services.analysis.drawing.figures import save
from cogradar.services.analysis.drawing.looks import STYLE, Look, looks
from cogradar.services.analysis.export.whole import made
from cogradar.services.analysis.pages import first_run, write_into
from cogradar.services.analysis.report import report
from cogradar.services.analysis.report_tables import (
    ALL_TARGETS,
    CONFIRMATION,
    DETECTION,
    DWELLS,
    ERRORS,
    IN_BIN,
    OVERALL,
    STRATEGY,
)
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store
from cogradar.services.runs.run import PICTURE
from cogradar.services.sweeps.grid import Axis, Variant
from cogradar.shared.scenario.tables import marked
from cogradar.shared.scoring.errors import FLIGHTS
from cogradar.shared.scoring.figures import Discovery

KEPT = ("runs", "first_dwell", "last_dwell", "target", "in_bin")
WITH_INTERVAL = ("p_d", "position_rmse_km")
PICTURE_INTERVALS = tuple(
    name + end for name in ("gospa_km", "completeness", "spuriousness") for end in ("", "_low", "_high")
)
COUNTED = ("swaps", "false_tracks_per_hour")
NEES_OF_FLIGHTS = ("nees", "nees_straight", "nees_below_1_g", "nees_1_3_g", "nees_over_3_g")  # in the order of FLIGHTS
LABELS = {"p_d": "lowest $P_D$ of a target", "position_rmse_km": "largest RMSE of one (km)"}
MAX_DRAWN = 2  # axes of a figure
COLUMN_INCHES, ROW_INCHES = 2.6, 2.0
Rows = list[dict[str, Any]]


def rows(store: Store, axes: Sequence[Axis], variants: Sequence[Variant]) -> Rows:
    """A row per variant and strategy, in the order of the grid; None for what no complete run tells."""
    counts = store.read("SELECT scenario, strategy, COUNT(*) AS n FROM run WHERE status = 'failed' GROUP BY 1, 2")
    failed = {(row["scenario"], row["strategy"]): row["n"] for row in counts}
    played = store.read("SELECT strategy FROM run GROUP BY strategy ORDER BY MIN(place)")
    found = _reports(store)
    return [
        {axis.name: typed(value) for axis, value in zip(axes, variant.values, strict=True)}
        | {"scenario": variant.scenario.name, "strategy": row["strategy"]}
        | _worst(found.get(variant.scenario.name), row["strategy"])
        | _pictured(found.get(variant.scenario.name), row["strategy"], (*PICTURE, *PICTURE_INTERVALS))
        | {"failed": failed.get((variant.scenario.name, row["strategy"]), 0)}
        for variant in variants
        for row in played
    ]


def _reports(store: Store) -> dict[str, dict[str, Any]]:
    """The report of each scenario of which a run is complete."""
    try:
        return {one.scenario: report(store, one) for one in experiments(store, Selection.of({"run": "all"}))}
    except BadInput:  # no run at all is
        return {}


def _extremes(of_targets: Rows) -> tuple[dict[str, Any], dict[str, Any]]:
    """The row of the target detected least, and of the one with the largest known error."""
    known = [row for row in of_targets if row["position_rmse_km"] is not None] or of_targets
    seen = [row for row in of_targets if row["p_d"] is not None] or of_targets
    return min(seen, key=lambda row: row["p_d"] or 0.0), max(known, key=lambda row: row["position_rmse_km"] or 0.0)


def _worst(variant: dict[str, Any] | None, strategy: str) -> dict[str, Any]:
    """The lowest P_D and the largest error among the targets of a strategy's runs."""
    names = [*KEPT, *(name + end for name in WITH_INTERVAL for end in ("", "_low", "_high"))]
    if variant is None or strategy not in variant["runs"]:
        return dict.fromkeys([*names, "largest", "lost"]) | {"runs": 0}
    of_targets = [row for row in variant["last"] if row["strategy"] == strategy]
    worst, largest = _extremes(of_targets)
    (overall,) = [row for row in variant["overall"] if row["strategy"] == strategy]
    errors = {name: largest[name] for name in names if name.startswith("position_rmse_km")}
    errors |= {"largest": largest["target"]}
    return {name: worst[name] for name in names} | errors | {"lost": overall["lost"]}


def _pictured(variant: dict[str, Any] | None, strategy: str, names: Sequence[str]) -> dict[str, Any]:
    """All targets of a strategy's runs together, over all dwells."""
    of_strategies: Rows = [] if variant is None else variant["picture"]
    found = [row for row in of_strategies if row["strategy"] == strategy]
    return {name: found[0][name] if found else None for name in names}


def whole_rows(store: Store, axes: Sequence[Axis], variants: Sequence[Variant]) -> Rows:
    """A row per variant and strategy about all dwells; variants without a complete run are left out."""
    found = _reports(store)
    return [
        {axis.name: typed(value) for axis, value in zip(axes, variant.values, strict=True)}
        | {"strategy": overall["strategy"]}
        | _whole(found[variant.scenario.name], overall)
        for variant in variants
        if variant.scenario.name in found
        for overall in found[variant.scenario.name]["overall"]
    ]


def _whole(variant: dict[str, Any], overall: dict[str, Any]) -> dict[str, Any]:
    """All dwells of a strategy's runs: P_D of the target detected least, the error of the one known least."""
    mine = [row for row in variant["windows"] if row["strategy"] == overall["strategy"]]
    of_targets = [row for row in mine if (row["first_dwell"], row["last_dwell"]) == (1, variant["dwells"])]
    worst, largest = _extremes(of_targets)
    consistency = [row["in_band"] for row in variant["consistency"] if row["strategy"] == overall["strategy"]]
    in_band = min(
        (share for share in consistency if share is not None), default=None
    )  # None: of a target never followed
    names = [name + end for name in WITH_INTERVAL for end in ("", "_low", "_high")]
    chosen = {name: (worst if name.startswith("p_d") else largest)[name] for name in names}
    chosen |= _pictured(variant, overall["strategy"], (*PICTURE_INTERVALS, *COUNTED))
    flights = [row for row in variant["flights"] if row["strategy"] == overall["strategy"]]
    chosen |= {name: row["nees"] for name, row in zip(NEES_OF_FLIGHTS, flights, strict=True)}
    chosen |= {"beyond_99": flights[0]["beyond_99"]}  # of all dwells
    (found,) = [row for row in variant["confirmation"] if row["strategy"] == overall["strategy"]] or [{}]
    chosen |= {name: found.get(name) for name in Discovery._fields}
    return overall | chosen | {"target": worst["target"], "largest": largest["target"], "in_band": in_band}


def whole_table(found: Rows, axes: Sequence[Axis]) -> Table:
    """The rows about all dwells for people."""
    columns = [
        *axis_columns(axes),
        STRATEGY,
        Column("runs", "{runs}"),
        Column("worst", "{target}"),
        *DETECTION[:2],
        Column("largest", "{largest}"),
        *ERRORS[:2],
        *OVERALL,
        *ALL_TARGETS[:2],
        Column("complete", "{completeness:.3f}"),
        Column("spurious", "{spuriousness:.3f}"),
        Column("swaps", "{swaps:.3f}"),
        Column("false tracks/h", "{false_tracks_per_hour:.2f}"),
        Column("least NEES in band", "{in_band:.3f}"),
        *(
            Column(f"NEES {flight.name}", f"{{{name}:.2f}}")
            for name, flight in zip(NEES_OF_FLIGHTS, FLIGHTS, strict=True)
        ),
        Column("beyond 99 %", "{beyond_99:.4f}"),
        *(CONFIRMATION[:3] if any(row["targets"] is not None for row in found) else []),
    ]
    return Table("All dwells", columns, with_labels(found, axes), "axis_0")


def axis_columns(axes: Sequence[Axis]) -> list[Column]:
    """A column per axis: headed by the last part of its keys, by all of them if another axis has the same."""
    short = [" = ".join(dict.fromkeys(key.rpartition(".")[2] for key in axis.keys)) for axis in axes]
    names = [name if short.count(name) == 1 else axis.name for name, axis in zip(short, axes, strict=True)]
    return [Column(name, f"{{axis_{i}}}") for i, name in enumerate(names)]


def with_labels(found: Rows, axes: Sequence[Axis]) -> Rows:
    """Rows with the swept values as people read them."""
    return [row | {f"axis_{i}": labelled(axis, row[axis.name]) for i, axis in enumerate(axes)} for row in found]


def table(found: Rows, axes: Sequence[Axis]) -> Table:
    """The rows for people."""
    shown = with_labels(found, axes)
    spans = sorted({(row["first_dwell"], row["last_dwell"]) for row in found if row["runs"]})
    columns = [
        *axis_columns(axes),
        STRATEGY,
        *([DWELLS] if len(spans) > 1 else []),
        Column("worst", "{target}"),
        *DETECTION[:2],
        IN_BIN,
        Column("largest", "{largest}"),
        *ERRORS[:2],
    ]
    span = f", {spans[0][0]}-{spans[0][1]}" if len(spans) == 1 else ""
    return Table(f"Last dwells{span}", columns, shown, "axis_0")


def remarks(store: Store, found: Rows) -> list[str]:
    """What the table does not say: how many runs failed, and so are in none of its numbers."""
    failed = store.read("SELECT run, reason FROM run WHERE status = 'failed' ORDER BY place")
    total = len(failed) + sum(row["runs"] for row in found)
    return [f"{len(failed)} of {total} runs failed, the first: {failed[0]['reason']}"] if failed else []


def first_of(store: Store, scenario: str, settings: Sequence[str], axes: Sequence[Axis], variant: Variant) -> list[str]:
    """How to repeat the first complete run of a variant, if it has one."""
    query = "SELECT * FROM run WHERE scenario = ? AND status = 'complete' ORDER BY place LIMIT 1"
    found = store.read(query, [variant.scenario.name])
    return [first_run(run, scenario, [*settings, *_chosen(axes, variant)]) for run in found]


def _chosen(axes: Sequence[Axis], variant: Variant) -> list[str]:
    return [f"{key}={value}" for axis, value in zip(axes, variant.values, strict=True) for key in axis.keys]


def write(page: Path, name: str, tables: Sequence[Table], remarks: Sequence[str]) -> None:
    """Replace what is between the markers `<!-- sweep NAME -->` and `<!-- /sweep NAME -->`. Raises BadInput."""
    write_into(page, {f"sweep {name}": [*tables, *remarks]})


def draw(found: Rows, axes: Sequence[Axis], folder: Path) -> list[Path]:
    """One column of panels per value of the second axis, a line per strategy; returns the files.

    Of more than two axes there is no figure: the table has a column for each.
    """
    if len(axes) > MAX_DRAWN:
        return []
    columns: list[Any] = list(dict.fromkeys(row[axes[1].name] for row in found)) if len(axes) > 1 else [None]
    drawn = looks(list(dict.fromkeys(row["strategy"] for row in found)))
    with mpl.rc_context(STYLE):
        size = (0.8 + COLUMN_INCHES * max(2, len(columns)), 0.8 + ROW_INCHES * len(WITH_INTERVAL))
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(WITH_INTERVAL), len(columns), sharex=True, sharey="row", squeeze=False)
        for j, value in enumerate(columns):
            here = [row for row in found if value is None or row[axes[1].name] == value]
            for i, name in enumerate(WITH_INTERVAL):
                _panel(grid[i, j], here, axes[0], name, drawn)
            if value is not None:
                grid[0, j].set_title(f"{axes[1].name} = {labelled(axes[1], value)}")
            grid[-1, j].set_xlabel(axes[0].name)
        for i, name in enumerate(WITH_INTERVAL):
            grid[i, 0].set_ylabel(LABELS[name])
        grid[0, 0].set_ylim(-0.03, 1.03)
        handles = [
            Line2D([], [], color=look.colour, linestyle=look.line, marker="o", markersize=3, label=strategy)
            for strategy, look in drawn.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
        made(folder)
        return save(figure, folder / "sweep")


def _panel(panel: Axes, found: Rows, axis: Axis, name: str, drawn: dict[str, Look]) -> None:
    """One metric against the swept value, with its 95 % interval over runs."""
    values = [typed(value) for value in axis.values]
    is_number = all(isinstance(value, float | int) for value in values)
    places = dict(zip(values, values if is_number else range(len(values)), strict=True))
    for strategy, look in drawn.items():
        mine = [row for row in found if row["strategy"] == strategy and row[name] is not None]
        x = [places[row[axis.name]] for row in mine]
        y, low, high = (np.array([row[name + end] for row in mine], dtype=float) for end in ("", "_low", "_high"))
        whiskers = np.nan_to_num(np.abs(np.stack((y - low, high - y)))) if mine else None
        style = {"color": look.colour, "linestyle": look.line, "elinewidth": 0.8, "capsize": 2}
        panel.errorbar(x, y, yerr=whiskers, marker="o", markersize=3, **style)
    panel.set_xticks([places[value] for value in values], [str(labelled(axis, value)) for value in values])


def labelled(axis: Axis, value: Any) -> Any:
    """A swept value for people: an action-selection policy that knows the truth says so."""
    return marked(str(value), str(value)) if "radar.planner.rule" in axis.keys else value


def typed(text: str) -> float | int | str:
    """A number if it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
