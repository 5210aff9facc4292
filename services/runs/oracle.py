"""Policies that know the truth: a planner whose plans are put right on their way out, in process only.

No planner is told where its target is, by a message or otherwise: it answers as if its rule were `mode`, and this,
which stands outside, puts the bin into the plan. Where targets fly does not depend on what is transmitted.
"""

from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput
from cogradar.services.topology import Start
from cogradar.shared.protocol.events import Event
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, RunStart
from cogradar.shared.scenario.plugins.kinds import RULE
from cogradar.shared.scenario.plugins.resolver import resolve
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.matching import associate
from cogradar.shared.signal.array import angle_bin, in_plane, spatial_frequency
from cogradar.shared.wire.runner import Core, Flush
from cogradar.shared.world.targets import Flights


class TrueRule(Protocol):
    """An action-selection policy that knows the truth; `cogradar.shared.scenario.tables.TRUE_RULES` has its name."""

    def __call__(self, state: NDArray[np.float64], n_bin: int) -> int:
        """Bin to look at, given the true state at the next dwell, (4,), as the array measures it (`array.in_plane`)."""


def true_bin(state: NDArray[np.float64], n_bin: int) -> int:
    """The bin in which the target will be: the most that any choice of bins can achieve."""
    return int(angle_bin(spatial_frequency(state), n_bin))


class Foresight:
    """Where the targets of a run will be, and which track is of which; one for all planners of the run."""

    def __init__(self, start: RunStart, front_end: str) -> None:
        """Raises BadInput for a front end whose truth is not known beforehand."""
        scenario = Scenario.model_validate(start.scenario)
        rule = scenario.radar.planner.rule
        if scenario.world is None or front_end != Start.front_end:
            raise BadInput(f"radar.planner.rule = {rule}: knows the truth, so it must be simulated")
        self._rule: TrueRule = resolve(RULE, rule)
        self._is_asked = start.strategy is not Strategy.ORTHOGONAL  # which tests every cell anyway
        self._flights = Flights(scenario.world, scenario.radar.motion.dt_s, start.seed)
        self._n_bin = scenario.radar.array.n_bin
        self._path = [self._flights.start()]  # by clock t, as far as it was asked for; (M, 4) each
        self._n_track = scenario.radar.announced
        self._first: dict[int, Plan] = {}  # of the tracks
        self._targets: list[int] | None = None  # of the tracks, -1: of none

    def corrected(self, plan: Plan) -> list[Plan]:
        """The plan with the bin that the rule looks at; as it is while searching, and of a false track.

        First plans are kept back until all tracks have one, of whatever planner: then it is known whose tracks are.
        """
        if plan.status != "tracking" or not self._is_asked:
            return [plan]
        if self._targets is not None:
            return [self._with_bin(plan, self._targets[plan.target])]
        self._first[plan.target] = plan
        if len(self._first) < self._n_track:
            return []
        plans = [self._first[track] for track in range(self._n_track)]
        estimates, truths = [plan.in_plane[0] for plan in plans], self._states(plans[0].t)
        there = np.flatnonzero(self._flights.present(truths, plans[0].t))
        found = associate(estimates, self._measured(plans[0].t)[there], self._n_bin)  # as they are scored
        self._targets = [int(there[i]) if i >= 0 else -1 for i in found.tolist()]
        return [self._with_bin(plan, target) for plan, target in zip(plans, self._targets, strict=True)]

    def _with_bin(self, plan: Plan, target: int) -> Plan:
        if target < 0:
            return plan
        bin_ = self._rule(self._measured(plan.t + 1)[target], self._n_bin)
        return plan.model_copy(update={"bins": np.array([bin_], dtype=np.int32), "chances": np.ones(1)})

    def _measured(self, t: int) -> NDArray[np.float64]:
        """Where the array measures them."""
        return in_plane(self._states(t), self._flights.heights(t))

    def _states(self, t: int) -> NDArray[np.float64]:
        while len(self._path) <= t:
            self._path.append(self._flights.moved(self._path[-1], len(self._path)))
        return self._path[t]


class KnowingPlanner:
    """A planner core with foresight."""

    def __init__(self, core: Core, foresight: Foresight) -> None:
        self._core, self._foresight = core, foresight

    def handle(self, event: Event) -> Iterator[Message | Flush]:
        """What the core answers, its plans put right."""
        if isinstance(event, Checkpoint):
            radar = event.radar | {"planner": event.radar["planner"] | {"rule": "mode"}}
            event = event.model_copy(update={"radar": radar})
        answers: Iterable[Message | Flush] = self._core.handle(event)
        for answer in answers:
            yield from self._foresight.corrected(answer) if isinstance(answer, Plan) else (answer,)
