"""The figure of all tracks and targets together: how far the picture of a radar is from the truth."""

import json

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cogradar.services.analysis.drawing.looks import looks
from cogradar.services.analysis.results import Results
from cogradar.services.metrics.store import Store

PARTS = ("GOSPA", "localisation", "missed", "false")  # the squares of the last three add up to the square of the first
_SQUARES = "AVG(localisation_km2 + missed_km2 + false_km2), AVG(localisation_km2), AVG(missed_km2), AVG(false_km2)"


def gospa(store: Store, results: Results) -> Figure:
    """GOSPA and its three parts against time, a panel each: root mean square over the runs of a strategy."""
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    panels = figure.subplots(len(PARTS), 1, sharex=True, squeeze=False)[:, 0]
    for strategy, look in looks(list(results.runs)).items():
        t, parts = _parts(store, results.runs[strategy].names)
        for axes, values in zip(panels, parts, strict=True):
            label = f"{strategy} ({len(results.runs[strategy].seeds)})" if axes is panels[0] else None
            axes.plot(t, values, color=look.colour, linestyle=look.line, label=label)
    for axes, name in zip(panels, PARTS, strict=True):
        axes.set_ylabel(f"{name}, km")
        axes.set_ylim(bottom=0.0)
    panels[-1].set_xlabel("dwell $t$")
    panels[-1].set_xlim(0, results.dwells)
    over = "" if results.is_single else "root mean square over the runs; "
    title = f"{over}$p = 2$, $c = 5$ km; localisation, missed and false add up in squares"
    figure.legend(title=title, loc="outside upper center", ncols=3)
    return figure


def _parts(store: Store, runs: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Dwells, (T,), and PARTS in km, (4, T)."""
    found = store.numbers(
        f"SELECT t, {_SQUARES} FROM picture WHERE run IN (SELECT value FROM json_each(?)) GROUP BY t ORDER BY t",
        [json.dumps(runs)],
    )
    return found[0], np.sqrt(found[1:])
