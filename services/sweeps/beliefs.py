"""The decisions of runs one by one: is the most probable bin provably the best, and what does each rule give away?

A run is played by search, its beliefs are worked out again from its scans, and each rule decides on every one of them.
What a choice gives away is the exact depth-2 value of the best bin less that of the chosen one. The results are kept in
a JSON file, so that an interrupted command goes on.
"""

import json
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from functools import partial
from pathlib import Path
from typing import Any

from services.analysis.stored_run import StoredRun
from services.campaigns.campaign import POLL_S
from services.campaigns.pool import Pool, interrupts_ignored
from services.errors import BadInput, check_stop
from services.metrics.answers import answer
from services.metrics.store import in_memory
from services.planner.decision import problem_after
from services.runs import in_process
from services.sweeps.decisions import SEARCH, SETTINGS, STRATEGY, Plan, Rows, Setting, variant
from shared.numerics.seeds import Purpose, generator, radar_seed
from shared.planning.exact import values_of
from shared.planning.greedy import is_greedy_optimal
from shared.planning.rules import chosen_bin
from shared.protocol.build import build
from shared.protocol.messages import Plan as PlanMessage
from shared.protocol.messages import RunStart
from shared.scenario.tables import BIN_RULES, marked
from shared.tracking.model import TrackerModel
from shared.wire.codec import decode

Counts = dict[str, Any]  # of one run


def starts(plan: Plan) -> dict[str, RunStart]:
    """The runs by the name under which their counts are kept, seed by seed."""
    return {
        " ".join(map(str, (*setting, seed))): RunStart.of(
            variant(plan.scenario, setting, SEARCH), STRATEGY, seed, plan.dwells
        )
        for seed in range(1, plan.belief_runs + 1)
        for setting in SETTINGS
    }


def count(start: RunStart) -> Counts:
    """Play a run, and look at its decisions: how many there are, how many the bounds leave open, losses in Q by rule.

    Losses are sums over all decisions, and over those that the bound for depth 2 leaves open.
    """
    store = in_memory()
    in_process.play(start, store=store)
    stored = StoredRun(partial(answer, store), start.run)
    radar = stored.scenario.radar
    model = TrackerModel.of(radar, start.strategy, radar_seed(start.seed))
    searched = _searched_bins(stored)
    counts: Counts = {"decisions": 0, "open": 0, "open_any": 0}
    counts |= {"loss": dict.fromkeys(BIN_RULES, 0.0), "loss_open": dict.fromkeys(BIN_RULES, 0.0)}
    for states in stored.states():
        for track, state in states.items():
            if (state.k, track) not in searched:
                continue
            problem = problem_after(model, state)
            values = values_of(problem, radar.planner.gamma)
            is_open, is_open_any = (
                not is_greedy_optimal(values.share, values.detected, radar.planner.gamma, depth)
                for depth in (2, math.inf)
            )
            counts["decisions"] += 1
            counts["open"] += is_open
            counts["open_any"] += is_open_any
            for rule in BIN_RULES:
                bin_ = searched[state.k, track]
                if rule != SEARCH:
                    rng = generator(model.seed, Purpose.SEARCH, track, state.k)
                    bin_ = chosen_bin(problem, radar.planner.model_copy(update={"rule": rule}), rng).bin
                loss = float(values.q.max()) - values.of(bin_)
                counts["loss"][rule] += loss
                counts["loss_open"][rule] += loss * is_open
    return counts


def _searched_bins(stored: StoredRun) -> dict[tuple[int, int], int]:
    """What the planners asked for, by dwell and track."""
    plans = [decode(payload) for _, payloads in stored.messages("plan") for payload in payloads]
    asked = [plan for plan in plans if isinstance(plan, PlanMessage) and plan.status == "tracking"]
    return {(plan.k, plan.target): int(plan.bins[0]) for plan in asked}


def play(
    plan: Plan, file: Path, pool: Pool, *, report: Callable[[str], None], stop: threading.Event
) -> dict[str, Counts]:
    """The counts of all runs: those that the file has, and the others, played now. Raises BadInput, Interrupted."""
    asked, kept = starts(plan), read(file)
    header = {"scenario": plan.scenario, "dwells": plan.dwells, "program": build()}
    if kept and kept["of"] != header:
        raise BadInput(f"{file}: holds decisions of another scenario or program; remove it, or name another store")
    runs: dict[str, Counts] = kept.get("runs", {})
    missing = {name: start for name, start in asked.items() if name not in runs}
    if not missing:
        return runs
    with pool.open(len(missing)) as executor:
        with interrupts_ignored():
            names = {executor.submit(count, start): name for name, start in missing.items()}
        waiting = set(names)
        while waiting:
            report(f"decisions looked into: {len(asked) - len(waiting)} of {len(asked)} runs")
            done, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
            check_stop(stop, "; go on with --resume")
            for future in done:
                runs[names[future]] = future.result()
                _write(file, {"of": header, "runs": runs})
    return runs


def _write(file: Path, document: dict[str, Any]) -> None:
    """Write a file whole or not at all: who is killed here finds what was counted before."""
    part = file.with_name(f".{file.name}.part")
    part.write_text(json.dumps(document, indent=1), encoding="utf-8")
    part.replace(file)


def read(file: Path) -> dict[str, Any]:
    """What a file holds, nothing if it is not there. Raises BadInput."""
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise BadInput(f"{file}: {error}") from None
    return found


def rows(runs: dict[str, Counts], settings: Sequence[Setting] = SETTINGS) -> Rows:
    """A row per setting and rule: share of decisions that the bounds leave open, mean loss in Q."""
    found = []
    for setting in sorted(settings):
        mine = [counts for name, counts in runs.items() if name.split()[:3] == [str(value) for value in setting]]
        n, n_open = (sum(counts[key] for counts in mine) for key in ("decisions", "open"))
        for rule in BIN_RULES if n else ():
            loss, loss_open = (sum(counts[key][rule] for counts in mine) for key in ("loss", "loss_open"))
            found.append(
                {**setting._asdict(), "rule": rule, "name": marked(rule, rule), "runs": len(mine), "decisions": n}
                | {"open": n_open / n, "open_any": sum(counts["open_any"] for counts in mine) / n}
                | {"loss": 1e3 * loss / n, "loss_open": 1e3 * loss_open / n_open if n_open else None}
            )
    return found
