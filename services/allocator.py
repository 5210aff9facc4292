"""Allocator: waits for every track's plan of dwell k, splits the power, says what to radiate at dwell k+1."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from services.early import Early
from services.unstored import Unstored
from shared.allocation import Allocation, allocate
from shared.array import bin_centres
from shared.messages import Checkpoint, Event, Message, Plan, Refused, Waveform
from shared.scenario import Scenario, Strategy
from shared.waveform import beam_factor

if TYPE_CHECKING:
    from shared.allocation_sdp import ReducedProgram

MIN_RANGE_KM = 1e-3  # a target on top of the array needs no power; keeps delta = 1/R^4 finite


@dataclass
class _Barrier:
    """One run's plans, collected per dwell until all tracks have spoken."""

    scenario: Scenario
    strategy: Strategy
    unstored: Unstored
    plans: defaultdict[int, dict[int, Plan]] = field(default_factory=lambda: defaultdict(dict))


class AllocatorCore:
    """Plans k in, waveform k out once all are there. A plan heard twice counts once.

    A waveform is a function of its dwell's plans alone: an allocator that comes back needs no more than those of the
    dwells that are not in the store yet, which their planners keep.
    """

    def __init__(self) -> None:
        self._barriers: dict[str, _Barrier] = {}
        self._early = Early()

    def handle(self, event: Event) -> Sequence[Message]:
        """Collect, and answer when a dwell is complete."""
        match event:
            case Checkpoint(ended=True):
                self._barriers.pop(event.run, None)
                self._early.forget(event.run)
            case Checkpoint() if event.run in self._barriers:
                barrier = self._barriers[event.run]
                for k in [k for k in barrier.plans if k < event.k]:
                    del barrier.plans[k]
                return barrier.unstored.checkpoint(event.k)
            case Checkpoint():
                scenario = Scenario.model_validate(event.scenario)
                self._barriers[event.run] = _Barrier(scenario, event.strategy, Unstored(event.k))
                return self._early.replay(event.run, self.handle)
            case Plan() if event.run in self._barriers:
                return _collect(self._barriers[event.run], event)
            case Plan():
                self._early.keep(event)
            case _:
                pass
        return ()


def _collect(barrier: _Barrier, plan: Plan) -> Sequence[Message]:
    n_target, n_bin = barrier.scenario.n_target, barrier.scenario.array.n_bin
    if plan.target >= n_target or plan.bin >= n_bin:
        raise Refused(f"plan of track {plan.target} for bin {plan.bin}: {n_target} tracks and {n_bin} bins exist")
    if plan.k < barrier.unstored.k:
        return ()
    plans = barrier.plans[plan.k]
    if plan.target in plans:
        return ()
    plans[plan.target] = plan
    if len(plans) < n_target:
        return ()
    answer = waveform(barrier.scenario, barrier.strategy, [plans[m] for m in sorted(plans)])
    return barrier.unstored.add(plan.k, (answer,))


def waveform(scenario: Scenario, strategy: Strategy, plans: Sequence[Plan]) -> Waveform:
    """Waveform that serves the plans of one dwell, tracks in order, under the run's strategy."""
    array = scenario.array
    beams = np.array([plan.bin for plan in plans], dtype=np.int32)
    tracking = all(plan.status == "tracking" for plan in plans)
    isotropic, factor, shares, status = 0.0, np.empty((array.n_tx, 0), np.complex128), np.zeros(len(plans)), "fixed"
    nus = bin_centres(array.n_bin)[beams]
    if not tracking:
        isotropic, status = array.power, "acquisition"
    elif strategy is Strategy.ORTHOGONAL:
        isotropic = array.power
    elif strategy is Strategy.UNIFORM:
        shares = np.full(len(plans), array.power / len(plans))
        factor = beam_factor(nus, shares, array.n_tx)
    else:
        nearest = np.maximum([plan.range_km for plan in plans], MIN_RANGE_KM)
        allocation = _solve(scenario, nus, nearest**-4.0)
        factor, shares, status = allocation.factor, allocation.shares, allocation.status
    return Waveform.model_validate(
        {
            "run": plans[0].run,
            "k": plans[0].k,
            "tracking": tracking,
            "isotropic": isotropic,
            "factor": factor.astype(np.complex64),
            "beams": beams if tracking else np.full(len(plans), -1, dtype=np.int32),
            "shares": shares,
            "status": status,
        }
    )


def _solve(scenario: Scenario, nus: NDArray[np.float64], expected_power: NDArray[np.float64]) -> Allocation:
    array = scenario.array
    if scenario.allocation.solver == "sdp":
        return _program(nus.size).allocate(nus, expected_power, array.power, array.n_tx)
    return allocate(nus, expected_power, array.power, array.n_tx)


@cache
def _program(n_beam: int) -> "ReducedProgram":
    """The semidefinite program for so many beams, compiled once."""
    from shared.allocation_sdp import ReducedProgram  # cvxpy: a second of import, for those who ask for it

    return ReducedProgram(n_beam)
