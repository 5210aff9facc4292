"""The decisions of a run one by one: is the most probable bin provably the best, and what does each policy lose?

Runs are played with POMCP. Their beliefs are computed again from the scans, and every policy decides on each of them.
The loss of a decision is the exact depth-2 value of the best bin minus the value of the chosen one. The bound of
`studies.decisions.greedy` leaves a decision open where it does not prove the most probable bin the best.
"""

import math
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.campaigns.pool import LocalPool, n_core
from cogradar.services.errors import check_stop
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner.decision import problem_after
from cogradar.services.runs import in_process
from cogradar.services.sweeps.grid import Axis, Variant, axis, variants
from cogradar.services.sweeps.results import axis_columns, typed, with_labels
from cogradar.shared.numerics.seeds import Purpose, generator, radar_seed
from cogradar.shared.planning.exact import values_of
from cogradar.shared.planning.rules import chosen_bin
from cogradar.shared.protocol.messages import Plan, RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import BIN_RULES
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.codec import decode
from studies.decisions.greedy import is_greedy_optimal

SEARCH = "pomcp"
HORIZONS = {"open": 2, "open_any": math.inf}  # looks for which the bound has to hold
OVER = (
    "radar.echo.amplitude_db=60,57,54",  # of radar and world: the world's is the radar's unless it is set
    "radar.fidelity=paper,robust",
    "radar.motion.sigma_s_km_s2=0.004,0.03",
)


class Decisions(NamedTuple):
    """Sums over the decisions of a run."""

    n: int
    open: Counter[str]  # by HORIZONS
    loss: Counter[str]  # by policy
    loss_open: Counter[str]  # of the decisions that are open for two looks


def play(scenario: str, over: Sequence[str], runs: int, tell: Callable[[str], None], stop: threading.Event) -> Table:
    """Play some seeds of each combination and judge their decisions. Raises Interrupted."""
    axes = [axis(text) for text in over]
    grid = variants(scenario, [f"radar.planner.rule={SEARCH}"], axes)
    starts = [
        RunStart.of(one.scenario, Strategy.POWER_AWARE, seed, None) for one in grid for seed in range(1, runs + 1)
    ]
    found = []
    with LocalPool(n_core()).open(len(starts)) as executor:
        waiting = [executor.submit(judged, start) for start in starts]
        for n, future in enumerate(waiting, 1):
            found.append(future.result())
            check_stop(stop)
            tell(f"{n} of {len(starts)} runs")
    return table(axes, grid, [found[i : i + runs] for i in range(0, len(found), runs)])


def judged(start: RunStart) -> Decisions:
    """Play a run and judge its decisions."""
    store = in_memory()
    in_process.play(start, store=store)
    return decisions(StoredRun(partial(answer, store), start.run))


def decisions(stored: StoredRun) -> Decisions:
    """Judge the decisions of a run that was played with POMCP."""
    radar, start = stored.scenario.radar, stored.start
    model = TrackerModel.of(radar, start.strategy, radar_seed(start.seed))
    searched, found = _searched_bins(stored), Decisions(0, Counter(), Counter(), Counter())
    for track, state in (item for states in stored.states() for item in states.items()):
        if (state.k, track) not in searched:
            continue
        problem = problem_after(model, state)
        values = values_of(problem, radar.planner.gamma)
        is_open = {
            name: not is_greedy_optimal(values.share, values.detected, radar.planner.gamma, depth)
            for name, depth in HORIZONS.items()
        }
        loss = dict.fromkeys(BIN_RULES, 0.0)
        for policy in BIN_RULES:
            bin_ = searched[state.k, track]
            if policy != SEARCH:
                rng = generator(model.seed, Purpose.SEARCH, track, state.k)
                planner = radar.planner.model_copy(update={"rule": policy})
                bin_ = chosen_bin(problem, radar.model_copy(update={"planner": planner}), rng).bin
            loss[policy] = float(values.q.max()) - values.of(bin_)
        found = found._replace(n=found.n + 1)
        found.open.update(is_open)
        found.loss.update(loss)
        found.loss_open.update(loss if is_open["open"] else {})
    return found


def _searched_bins(stored: StoredRun) -> dict[tuple[int, int], int]:
    """The bins that the planners asked for, by dwell and track."""
    plans = [decode(payload) for _, payloads in stored.messages("plan") for payload in payloads]
    asked = [plan for plan in plans if isinstance(plan, Plan) and plan.status == "tracking"]
    return {(plan.k, plan.target): int(plan.bins[0]) for plan in asked}


def table(axes: Sequence[Axis], grid: Sequence[Variant], found: Sequence[Sequence[Decisions]]) -> Table:
    """A row per combination and policy: means over the decisions of all its runs."""
    rows: list[dict[str, Any]] = []
    for variant, runs in zip(grid, found, strict=True):
        n, n_open = sum(one.n for one in runs), sum(one.open["open"] for one in runs)
        values = {axis.name: typed(value) for axis, value in zip(axes, variant.values, strict=True)}
        for policy in BIN_RULES:
            loss, loss_open = (sum(counted[policy] for counted in of) for of in _losses(runs))
            row = values | {"policy": policy, "runs": len(runs), "decisions": n}
            row |= {name: 100.0 * sum(one.open[name] for one in runs) / n for name in HORIZONS}
            rows.append(row | {"loss": 1e3 * loss / n, "loss_open": 1e3 * loss_open / n_open if n_open else None})
    columns = (
        *(*axis_columns(axes), Column("policy", "{policy}", left=True), Column("runs", "{runs}")),
        *(Column("decisions", "{decisions}"), Column("open, 2 looks", "{open:.2f} %")),
        *(Column("open, any horizon", "{open_any:.2f} %"), Column("loss in Q, 1e-3", "{loss:.3f}")),
        Column("loss of open ones", "{loss_open:.2f}"),
    )
    return Table("Decisions on the beliefs that POMCP met", columns, with_labels(rows, axes), "axis_0")


def _losses(runs: Sequence[Decisions]) -> tuple[list[Counter[str]], list[Counter[str]]]:
    return [one.loss for one in runs], [one.loss_open for one in runs]
