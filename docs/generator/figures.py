"""Draws figures of the pages from the tables beside them, docs/tables: `python -m docs.generator.figures`.

A picture holds the digest of its tables, so that a test finds one that is older than its table.
"""

import csv
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cogradar.services.analysis.drawing.looks import FAINT, INK, STYLE, TARGETS

DOCS = Path(__file__).resolve().parents[1]
FIGURES, TABLES = DOCS / "figures", DOCS / "tables"
Row = dict[str, str]

FIDELITIES = {"paper": TARGETS[0], "robust": TARGETS[1]}
RULES = ("mean", "pomcp", "mode", "exact", "oracle (knows the truth)")
# What is added from the first to the last row of power-aware beams in a table.
PARTS = {
    "joint looks, as published": "beyond-sweep-published-1",
    "joint looks, robust": "beyond-sweep-looks-1",
    "joint looks, target that turns": "beyond-sweep-turn-1",
    "range cells": "beyond-sweep-fidelity-1",
    "urgency, too little power": "beyond-sweep-starved-1",
}
KILLS = "reliability-kills"
_OF_SPANS = {"killed": "#D55E00", "track": "#0072B2", "coast": "#E69F00", "missed": "#DDDDDD"}
POLICIES, SCALE = "decisions-sweep-policies-2", "scaling-scale-1"
SPENT = ("emulator", "planner", "allocator", "queues", "transport")  # columns of SCALE
_OF_PARTS = dict(zip(SPENT, ("#009E73", "#0072B2", "#D55E00", "#CC79A7", "#999999"), strict=True))


def rows(table: str) -> list[Row]:
    """A table of a page, all columns."""
    with (TABLES / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def rules() -> Figure:
    """The lowest P_D of a target by rule with its interval, a panel for each way in which targets fly."""
    found = rows(POLICIES)
    flights = list(dict.fromkeys(row["sigma_s_km_s2"] for row in found))
    figure = Figure(figsize=(7.2, 2.6), layout="constrained")
    panels = figure.subplots(1, len(flights), sharey=True)
    for axes, sigma in zip(panels, flights, strict=True):
        for row in (row for row in found if row["sigma_s_km_s2"] == sigma):
            look = FIDELITIES[row["fidelity"]]
            y = RULES.index(row["rule"]) + (0.12 if row["fidelity"] == "paper" else -0.12)
            middle, low, high = (float(row[f"P_D{end}"]) for end in ("", ", 95 %, runs, low", ", 95 %, runs, high"))
            axes.plot([low, high], [y, y], color=look.colour, linewidth=1.3)
            axes.plot(middle, y, "o", color=look.colour, markersize=3.5)
        axes.set_title(f"$\\sigma_s$ = {sigma} km/s²")
        axes.set_xlim(0.0, 1.02)
        axes.set_xlabel("lowest $P_D$ of a target")
    panels[0].set_yticks(range(len(RULES)), [rule.partition(" (")[0] for rule in RULES])
    handles = [
        Line2D([], [], color=look.colour, marker="o", markersize=3.5, label=name) for name, look in FIDELITIES.items()
    ]
    title = f"mean and 95 % interval over {found[0]['runs']} runs"
    figure.legend(handles=handles, title=title, loc="outside upper center", ncols=2)
    return figure


def parts() -> Figure:
    """What each part buys: the least detected target and the largest error, without the part and with it."""
    figure = Figure(figsize=(7.2, 0.9 + 0.42 * len(PARTS)), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    values = (("P_D", "lowest $P_D$ of a target, last dwells"), ("RMSE km", "largest RMSE of one, km"))
    for axes, (column, label) in zip(panels, values, strict=True):
        for y, table in enumerate(reversed(PARTS.values())):
            kept = [row for row in rows(table) if row["strategy"] == "power-aware"]
            before, after = (float(row[column]) for row in (kept[0], kept[-1]))
            axes.plot([before, after], [y, y], color=FAINT, linewidth=1.6, zorder=1)
            axes.plot(before, y, "o", color=INK, mfc="white", markersize=5)
            axes.plot(after, y, "o", color=TARGETS[1].colour, markersize=5)
        axes.set_xlabel(label)
    panels[1].set_xscale("log")
    panels[0].set_yticks(range(len(PARTS)), list(reversed(PARTS)))
    handles = [
        Line2D([], [], color=INK, marker="o", mfc="white", linestyle="none", label="without it"),
        Line2D([], [], color=TARGETS[1].colour, marker="o", linestyle="none", label="with it"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def dwell() -> Figure:
    """Where the time of a dwell goes, stacked; what is left of the dwell is said by none of the processes."""
    found = rows(SCALE)
    figure = Figure(figsize=(7.2, 0.9 + 0.4 * len(found)), layout="constrained")
    axes = figure.subplots()
    axes.set_axisbelow(True)
    axes.grid(visible=False, axis="y")
    for y, row in enumerate(reversed(found)):
        whole, left = float(row["dwell"]), 0.0
        for part in SPENT:
            share = 100.0 * float(row[part]) / whole
            axes.barh(y, share, left=left, color=_OF_PARTS[part], height=0.62, label=part if y == 0 else None)
            left += share
        axes.text(101.0, y, f"{whole:.0f} ms", va="center", color=INK)
    named = [f"{row['targets']} targets, {row['planners']} planner{'s' * (row['planners'] != '1')}" for row in found]
    axes.set_yticks(range(len(found)), named[::-1])
    axes.set_xlim(0.0, 110.0)
    axes.set_xlabel("share of a dwell, %")
    figure.legend(loc="outside upper center", ncols=len(SPENT))
    return figure


def kills() -> Figure:
    """A run in real time whose processes are killed: when, and which tracks had no plan."""
    found = [row for row in rows(KILLS) if row["seed"] == "1"]
    roles = sorted({row["of"].rpartition("-")[0] for row in found if row["what"] == "killed"})
    tracks = [row["of"] for row in found if row["what"] == "track"]
    figure = Figure(figsize=(7.2, 0.9 + 0.17 * (len(roles) + len(tracks))), layout="constrained")
    axes = figure.subplots()
    for row in found:
        first, last = float(row["first dwell"]), float(row["last dwell"])
        if row["what"] == "killed":
            y = len(tracks) + roles.index(row["of"].rpartition("-")[0])
            axes.plot(first, y, "x", color=_OF_SPANS["killed"], markersize=5)
            axes.axvline(first, color=FAINT, linewidth=0.4, zorder=0)
        elif row["what"] == "missed":
            axes.axvspan(first - 0.5, last + 0.5, color=_OF_SPANS["missed"], linewidth=0, zorder=0)
        else:
            width = 3.0 if row["what"] == "track" else 6.0
            y = tracks.index(row["of"])
            axes.hlines(y, first - 0.5, last + 0.5, color=_OF_SPANS[row["what"]], linewidth=width)
    axes.set_yticks(range(len(tracks) + len(roles)), [*(f"track {track}" for track in tracks), *roles], size=6.5)
    axes.grid(visible=False)
    axes.set_xlabel("dwell $k$")
    handles = [
        Line2D([], [], color=_OF_SPANS["killed"], marker="x", linestyle="none", label="process killed"),
        Line2D([], [], color=_OF_SPANS["track"], linewidth=3.0, label="track"),
        Line2D([], [], color=_OF_SPANS["coast"], linewidth=6.0, label="track without a plan"),
        Line2D([], [], color=_OF_SPANS["missed"], linewidth=6.0, label="no dwell"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


class Drawing(NamedTuple):
    """A figure of a page, and the tables that it shows."""

    page: str
    draw: Callable[[], Figure]
    tables: tuple[str, ...]

    @property
    def source(self) -> str:
        """Digest of its tables."""
        found = hashlib.sha256()
        for table in self.tables:
            found.update((TABLES / f"{table}.csv").read_bytes())
        return found.hexdigest()


DRAWINGS = {
    "rules": Drawing("decisions.md", rules, (POLICIES,)),
    "parts": Drawing("beyond.md", parts, tuple(PARTS.values())),
    "kills": Drawing("reliability.md", kills, (KILLS,)),
    "dwell": Drawing("scaling.md", dwell, (SCALE,)),
}


def main() -> None:
    """Draw all of them."""
    with mpl.rc_context(STYLE):
        for name, drawing in DRAWINGS.items():
            drawing.draw().savefig(FIGURES / f"{name}.png", metadata={"Software": None, "Source": drawing.source})


if __name__ == "__main__":
    main()
