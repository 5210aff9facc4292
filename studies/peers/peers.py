"""The radar's decision side by side: its own search, the search of `pomdp-py`, and no search at all.

All decide on the same beliefs, with the same legal bins, generator, exploration constant, discount and numbers of
simulations. The horizon is two looks, so that the exact value of every bin is known. The beliefs are from runs.
In each of them the most probable bin is not proved to be the best (`studies.decisions.greedy`): elsewhere a search has
no use.
"""

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput, MissingLibrary, check_stop
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner.decision import problem_after
from cogradar.services.runs import in_process
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.planning.exact import Values, values_of
from cogradar.shared.planning.pomcp import SearchSettings, search
from cogradar.shared.planning.radar_pomdp import RadarPomdp, legal_actions
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.errors import bootstrap_interval
from cogradar.shared.tracking.model import TrackerModel
from studies.decisions.greedy import is_greedy_optimal

SETTINGS = ("radar.echo.amplitude_db=54", "radar.motion.sigma_s_km_s2=0.03")  # where most decisions are open
LEVELS = 2  # of looks
Solver = Callable[[RadarPomdp, NDArray[np.int64], SearchSettings, np.random.Generator], tuple[int, float, float]]


class Case(NamedTuple):
    """A decision that is open."""

    problem: RadarPomdp
    actions: NDArray[np.int64]  # (n_action,) legal bins
    values: Values


def own(
    problem: RadarPomdp, actions: NDArray[np.int64], settings: SearchSettings, rng: np.random.Generator
) -> tuple[int, float, float]:
    """Bin, value and CPU seconds of the radar's own search."""
    began = time.thread_time()
    found = search(problem, actions, settings, rng)
    seconds = time.thread_time() - began
    return int(found.action), float(found.value[actions == found.action][0]), seconds


def solvers() -> dict[str, Solver]:
    """The searches that are compared. Raises MissingLibrary."""
    try:
        from studies.peers.pomdp_py_adapter import decide
    except ImportError as missing:
        raise MissingLibrary(f"this study needs pomdp-py ({missing}): pip install pomdp-py") from None
    return {"cogradar": own, "pomdp-py": decide}


def open_cases(scenario: str, runs: int) -> Iterator[Case]:
    """The decisions of runs with these seeds, 1 to `runs`, that the bound leaves open."""
    for seed in range(1, runs + 1):
        store = in_memory()
        start = RunStart.of(load(scenario, SETTINGS), Strategy.POWER_AWARE, seed, None)
        in_process.play(start, store=store)
        stored = StoredRun(partial(answer, store), start.run)
        radar = stored.scenario.radar
        model = TrackerModel.of(radar, start.strategy, radar_seed(seed))
        for states in stored.states():
            for state in states.values():
                problem = problem_after(model, state)
                values = values_of(problem, radar.planner.gamma)
                if not is_greedy_optimal(values.share, values.detected, radar.planner.gamma, LEVELS):
                    dt, widen = problem.motion.dt, radar.planner.widen_bins
                    yield Case(problem, legal_actions(problem.particles, problem.n_bin, dt, widen), values)


def play(
    scenario: str,
    runs: int,
    n_case: int,
    simulations: list[int],
    tell: Callable[[str], None],
    stop: threading.Event,
) -> Table:
    """Let all decide on so many cases, spread over the runs. Raises Interrupted, MissingLibrary."""
    by_name, planner = solvers(), load(scenario).radar.planner
    cases = list(open_cases(scenario, runs))
    if not cases:
        raise BadInput(f"{scenario}: in all decisions the most probable bin is provably the best: nothing to compare")
    chosen = [cases[i] for i in np.linspace(0, len(cases) - 1, min(n_case, len(cases))).astype(int)]
    rows = [_row("most probable bin", None, chosen, [(_mode(one.values), 0.0, 0.0) for one in chosen])]
    for n_sim in simulations:
        settings = SearchSettings(n_sim, LEVELS, 0, False, planner.gamma, planner.ucb_c)
        for name, solver in by_name.items():
            found = []
            for i, one in enumerate(chosen):
                check_stop(stop)
                found.append(solver(one.problem, one.actions, settings, np.random.default_rng((n_sim, i))))
                tell(f"{name}, {n_sim} simulations: {i + 1} of {len(chosen)} decisions")
            rows.append(_row(name, n_sim, chosen, found))
    return table(rows, f"{len(chosen)} of {len(cases)} open decisions of {runs} runs")


def _mode(values: Values) -> int:
    return values.first_bin + int(np.argmax(values.share))


def _row(name: str, n_sim: int | None, cases: list[Case], found: list[tuple[int, float, float]]) -> dict[str, Any]:
    losses = np.array([one.values.q.max() - one.values.of(bin_) for one, (bin_, *_) in zip(cases, found, strict=True)])
    row: dict[str, Any] = dict.fromkeys(("error", "ms", "us")) | {"name": name, "n_sim": n_sim}
    row["best"] = 100.0 * np.mean(losses < 1e-12)
    row["loss"] = 1e3 * losses.mean()
    row["low"], row["high"] = bootstrap_interval(1e3 * losses, np.random.default_rng(3))
    if n_sim is not None:
        errors = [value - one.values.of(bin_) for one, (bin_, value, _) in zip(cases, found, strict=True)]
        row["error"] = 1e3 * np.mean(errors)
        row["ms"] = 1e3 * np.median([seconds for _, _, seconds in found])
        row["us"] = 1e3 * row["ms"] / n_sim
    return row


def table(rows: list[dict[str, Any]], what: str) -> Table:
    """A row for each solver and number of simulations."""
    columns = (
        Column("solver", "{name}", left=True),
        Column("simulations", "{n_sim}"),
        Column("best bin", "{best:.0f} %"),
        Column("loss in Q, 1e-3", "{loss:.2f} [{low:.2f}, {high:.2f}]"),
        Column("value less exact, 1e-3", "{error:+.1f}"),
        Column("CPU ms", "{ms:.1f}"),
        Column("µs a simulation", "{us:.2f}"),
    )
    return Table(f"The same decisions by another library: {what}", columns, rows)
