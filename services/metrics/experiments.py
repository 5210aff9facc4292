"""The experiments of a store: runs of one scenario document and number of dwells, which may be compared."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput, Damaged
from cogradar.services.metrics.selection import Run, Selection, distinct, refuse
from cogradar.services.metrics.store import Store
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import TRUE_RULES

BROKEN = ("failed", "stopped")  # status of a run that ended before its time


@dataclass(frozen=True)
class Experiment:
    """Runs with truth, each pair of strategy and seed once, in the order of their seeds."""

    label: str  # tells it from the others of its store: name of the scenario, with more if that is not enough
    scenario: str
    title: str  # of the scenario; of a variant of a sweep, its values
    alone: bool  # nothing of another scenario is in its store, and its title need not be shown
    document: str  # JSON
    dwells: int
    complete: tuple[Run, ...]
    failed: tuple[Run, ...]

    @property
    def is_unknown(self) -> bool:
        """Whether the radar was not told how many targets there are."""
        return self.complete[0]["n_track"] is None

    @property
    def was_ended(self) -> bool:
        """Whether runs ended before their last dwell: the number of dwells does not say how to repeat them."""
        return any(run["dwells"] != self.dwells for run in self.complete)

    @property
    def strategies(self) -> list[str]:
        """Strategies of the complete runs, those that this program knows first."""
        names = {run["strategy"] for run in self.complete}
        return [*(known.value for known in Strategy if known in names), *sorted(names - set(Strategy))]

    def of(self, strategy: str) -> list[Run]:
        """The complete runs of a strategy."""
        return [run for run in self.complete if run["strategy"] == strategy]

    def scores(self, store: Store, strategy: str, columns: str) -> NDArray[np.float64]:
        """Columns of the scores of a strategy's runs, (n_run, dwells, n_target, n_column). Raises BadInput."""
        tables = []
        for run in self.of(strategy):
            rows = store.numbers(f"SELECT {columns} FROM score WHERE run = ? ORDER BY t, target", [run["run"]]).T
            if len(rows) != self.dwells * run["n_target"]:
                raise BadInput(f"{run['run']} lacks dwells, which were lost in real time{_instead(store, run)}")
            tables.append(rows)
        return np.array(tables).reshape(len(tables), self.dwells, self.of(strategy)[0]["n_target"], -1)


def experiments(store: Store, selection: Selection, left_out: Callable[[Damaged], None] = refuse) -> list[Experiment]:
    """The experiments with complete runs that a selection allows. Raises BadInput if there is none.

    left_out : gets what is damaged of each run that is left out; if no other one is there, it is raised
    """
    damaged = list[Damaged]()
    chosen = distinct(store, selection, damaged.append)
    listed = [run for run in chosen if run["status"] in BROKEN and run["has_truth"] and run["dwells"] != NO_END]
    runs = [run for run in chosen if run in listed or not _obstacle(run)]
    (documents,) = store.read("SELECT COUNT(DISTINCT document) AS n FROM run")
    found = []
    for number, dwells in dict.fromkeys((run["experiment"], _dwells(run)) for run in runs):
        mine = [run for run in runs if (run["experiment"], _dwells(run)) == (number, dwells)]
        mine.sort(key=lambda run: (run["seed"], run["run"]))
        complete, failed = (tuple(run for run in mine if run["status"] in kinds) for kinds in (("complete",), BROKEN))
        try:
            row = store.whole_row(complete[0]["run"]) if complete else None
        except Damaged as of_document:  # which no other run has then
            damaged.append(of_document)
            continue
        if row is not None:
            document = json.loads(row["document"])
            name, title = mine[0]["scenario"], document["title"]
            alone = documents["n"] == 1 and document["radar"]["planner"]["rule"] not in TRUE_RULES
            found.append(Experiment(name, name, title, alone, row["document"], dwells, complete, failed))
    for error in damaged:
        (left_out if found else refuse)(error)
    if not found:
        of = ", ".join(f"{name} = {value}" for name, value in selection.filters.items())
        last = chosen[-1] if chosen else None
        why = f": run {last['run']} {_obstacle(last)}{_instead(store, last)}" if last is not None else ""
        raise BadInput(f"no complete run with truth in this store{f', of {of}' if of else ''}{why}")
    return _labelled(_labelled(found, lambda e: f"{e.label}-{e.dwells}"), lambda e: f"{e.label}-{_short(e.document)}")


def _dwells(run: Run) -> int:
    """The number of dwells of a run; of one that was ended before its last, those that it has."""
    return int(run["t"] if run["status"] == "complete" else run["dwells"])


def _obstacle(run: Run) -> str:
    """Why a run is not reported on, as what is said of it; "": it is."""
    if run["status"] in BROKEN:
        return f"{run['status']} at dwell {run['t']}, {run['reason']}"
    if run["status"] != "complete":
        return "goes on" if run["status"] == "running" else f"is {run['status']}"
    if not run["has_truth"]:
        return "has no truth"
    if not _dwells(run):
        return "has no dwell of tracking"
    return f"has lost its dwells before {run['oldest_t']}, which were cut" if run["oldest_t"] > 1 else ""


def _instead(store: Store, run: Run) -> str:
    """What shows a run that cannot be reported on."""
    return f"; `cogradar query summary --run {run['run']} --store {store.journal.path}` has the dwells that are there"


def _labelled(found: list[Experiment], longer: Callable[[Experiment], str]) -> list[Experiment]:
    """Experiments whose labels are not unique with longer ones."""
    times = Counter(experiment.label for experiment in found)
    return [replace(e, label=longer(e)) if times[e.label] > 1 else e for e in found]


def _short(document: str) -> str:
    return hashlib.sha256(document.encode()).hexdigest()[:6]
