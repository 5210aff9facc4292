"""The decisions of a run one by one: is the most probable bin provably the best, and what does each rule give away?

The beliefs of a run that was played by search are worked out again from its scans, and each rule decides on every one
of them. What a choice gives away is the exact depth-2 value of the best bin less that of the chosen one.
"""

import math

from services.analysis.stored_run import StoredRun
from services.planner.decision import problem_after
from services.sweeps.decisions import SEARCH, Decisions
from shared.numerics.seeds import Purpose, generator, radar_seed
from shared.planning.exact import values_of
from shared.planning.greedy import is_greedy_optimal
from shared.planning.rules import chosen_bin
from shared.protocol.messages import Plan as PlanMessage
from shared.scenario.tables import BIN_RULES
from shared.tracking.model import TrackerModel
from shared.wire.codec import decode


def look_into(stored: StoredRun) -> Decisions:
    """The decisions of a run that was played by search."""
    radar, start = stored.scenario.radar, stored.start
    model = TrackerModel.of(radar, start.strategy, radar_seed(start.seed))
    searched = _searched_bins(stored)
    n = n_open = n_open_any = 0
    losses, losses_open = dict.fromkeys(BIN_RULES, 0.0), dict.fromkeys(BIN_RULES, 0.0)
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
            n, n_open, n_open_any = n + 1, n_open + is_open, n_open_any + is_open_any
            for rule in BIN_RULES:
                bin_ = searched[state.k, track]
                if rule != SEARCH:
                    rng = generator(model.seed, Purpose.SEARCH, track, state.k)
                    bin_ = chosen_bin(problem, radar.planner.model_copy(update={"rule": rule}), rng).bin
                loss = float(values.q.max()) - values.of(bin_)
                losses[rule] += loss
                losses_open[rule] += loss * is_open
    return Decisions(n=n, open=n_open, open_any=n_open_any, loss=losses, loss_open=losses_open)


def _searched_bins(stored: StoredRun) -> dict[tuple[int, int], int]:
    """What the planners asked for, by dwell and track."""
    plans = [decode(payload) for _, payloads in stored.messages("plan") for payload in payloads]
    asked = [plan for plan in plans if isinstance(plan, PlanMessage) and plan.status == "tracking"]
    return {(plan.k, plan.target): int(plan.bins[0]) for plan in asked}
