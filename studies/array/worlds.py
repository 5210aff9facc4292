"""The paper's first figure in two worlds: the runs of a sweep over `world.signal`, side by side."""

from contextlib import closing
from pathlib import Path

import matplotlib as mpl

from cogradar.services.analysis.drawing.figures import accuracy, save
from cogradar.services.analysis.drawing.looks import STYLE
from cogradar.services.analysis.results import Results, read_results
from cogradar.services.errors import BadInput
from cogradar.services.metrics import client
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection


def draw(store: str, name: Path) -> list[Path]:
    """P_D and errors of each target against time, a line per world and strategy; returns the files. Raises BadInput."""
    with closing(client.open_store(store)) as opened:
        found = [read_results(opened, one) for one in experiments(opened, Selection.of({"run": "all"}))]
    merged = merge(found, store)
    name.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        return save(accuracy(merged), name)


def merge(found: list[Results], store: str = "store") -> Results:
    """The results of the worlds as one, whose strategies are called by their world. Raises BadInput."""
    signals = [results.scenario.simulated.signal for results in found]
    if len(set(signals)) < max(len(signals), 2) or len({results.dwells for results in found}) > 1:
        raise BadInput(f"{store}: must have runs with world.signal = cells and array, of as many dwells")
    runs = {
        f"{signal}, {strategy}": runs
        for signal, results in sorted(zip(signals, found, strict=True), key=lambda one: one[0], reverse=True)
        for strategy, runs in results.runs.items()
    }
    return Results(found[0].scenario, found[0].dwells, runs)
