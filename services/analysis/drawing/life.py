"""The life of tracks: when each target of a run was there, when it could be seen, and which track followed it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cogradar.services.analysis.drawing.looks import FAINT, INK, TARGETS
from cogradar.services.analysis.results import Results

ROW_INCHES, MOST_INCHES = 0.16, 12.0


def life(results: Results) -> Figure:
    """A row a target of the first strategy's first run, in the order of coming; a gap is a dwell without a track.

    The tracks of a target change colour where one ends and another takes it over.
    """
    strategy, runs = next(iter(results.runs.items()))
    there, visible, track = runs.true_bin[0] >= 0, runs.visible[0] > 0.0, runs.track[0]  # (T, M)
    come = np.where(there.any(axis=0), there.argmax(axis=0), results.dwells)
    order = [m for m in np.argsort(come, kind="stable").tolist() if there[:, m].any()]
    figure = Figure(figsize=(7.2, min(0.9 + ROW_INCHES * max(len(order), 4), MOST_INCHES)), layout="constrained")
    axes = figure.subplots()
    for y, m in enumerate(order):
        _spans(axes, y, there[:, m], FAINT, 0.5)
        _spans(axes, y, visible[:, m], FAINT, 1.6)
        for i, number in enumerate(dict.fromkeys(track[~np.isnan(track[:, m]), m].tolist())):
            _spans(axes, y, track[:, m] == number, TARGETS[i % len(TARGETS)].colour, 3.2)
    axes.set_yticks(range(len(order)), [str(m + 1) for m in order], size=6.5)
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlim(0, results.dwells)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("dwell $t$")
    axes.set_ylabel("target")
    handles = [
        Line2D([], [], color=FAINT, linewidth=0.5, label="there"),
        Line2D([], [], color=FAINT, linewidth=1.6, label="visible"),
        Line2D([], [], color=TARGETS[0].colour, linewidth=3.2, label="followed, by its first track"),
        Line2D([], [], color=TARGETS[1].colour, linewidth=3.2, label="by another"),
    ]
    legend = figure.legend(
        handles=handles, title=f"{strategy}, seed {runs.seeds[0]}", loc="outside upper center", ncols=4
    )
    legend.get_title().set_color(INK)
    return figure


def _spans(axes: Axes, y: int, is_on: NDArray[np.bool_], colour: str, width: float) -> None:
    """Lines over the dwells, counted from 1, for which it holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_on.astype(np.int8), [0]))))
    axes.hlines([y] * (edges.size // 2), edges[::2] + 0.5, edges[1::2] + 0.5, color=colour, linewidth=width)
