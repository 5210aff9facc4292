"""The radar's decision problem for `pomdp-py`: its classes around the functions of `cogradar.shared.planning`.

Belief and generator are the radar's own, in Python. The search is PO-UCT of pomdp-py (Silver & Veness 2010), which has
one depth for tree and rollouts: `max_depth` + 1 levels in all.
"""

import time
from typing import Any, NamedTuple

import numpy as np
import pomdp_py
from numpy.typing import NDArray

from cogradar.shared.planning.pomcp import SearchSettings
from cogradar.shared.planning.problem import random_action, sample_state, step
from cogradar.shared.planning.radar_pomdp import RadarPomdp


class Found(NamedTuple):
    """A decision."""

    bin: int
    value: float  # that the search expects of it
    seconds: float  # of CPU


class _State(pomdp_py.State):  # type: ignore[misc] # pomdp-py has no types
    def __init__(self, values: tuple[float, ...]) -> None:
        self.values = values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _State) and self.values == other.values

    def __hash__(self) -> int:
        return hash(self.values)


class _Look(pomdp_py.Action):  # type: ignore[misc]
    def __init__(self, bin_: int) -> None:
        self.bin = bin_

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Look) and self.bin == other.bin

    def __hash__(self) -> int:
        return self.bin


class _Heard(pomdp_py.Observation):  # type: ignore[misc]
    def __init__(self, number: int) -> None:
        self.number = number

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Heard) and self.number == other.number

    def __hash__(self) -> int:
        return self.number


class _Belief(pomdp_py.GenerativeDistribution):  # type: ignore[misc]
    def __init__(self, problem: RadarPomdp, rng: np.random.Generator) -> None:
        self._problem, self._rng = problem, rng

    def random(self) -> _State:
        return _State(sample_state(self._problem, self._rng))


class _Generator(pomdp_py.BlackboxModel):  # type: ignore[misc]
    def __init__(self, problem: RadarPomdp, rng: np.random.Generator) -> None:
        self._problem, self._rng = problem, rng

    def sample(self, state: _State, action: _Look) -> tuple[_State, _Heard, float, int]:
        following, observation, reward, _ = step(self._problem, state.values, action.bin, self._rng)
        return _State(following), _Heard(observation), reward, 1  # level


class _Policy(pomdp_py.RolloutPolicy):  # type: ignore[misc]
    """The legal looks in the tree, any look in a rollout."""

    def __init__(self, problem: RadarPomdp, looks: list[_Look], rng: np.random.Generator) -> None:
        self._problem, self._looks, self._rng = problem, looks, rng

    def get_all_actions(self, *_: Any, **__: Any) -> list[_Look]:
        return self._looks

    def rollout(self, *_: Any, **__: Any) -> _Look:
        return _Look(random_action(self._problem, self._rng))


def decide(
    problem: RadarPomdp, actions: NDArray[np.int64], settings: SearchSettings, rng: np.random.Generator
) -> Found:
    """The decision of pomdp-py after as many simulations, over as many levels; actions (n_action,)."""
    began = time.thread_time()
    policy = _Policy(problem, [_Look(int(bin_)) for bin_ in actions], rng)
    agent = pomdp_py.Agent(_Belief(problem, rng), policy, blackbox_model=_Generator(problem, rng))
    planner = pomdp_py.POUCT(
        max_depth=settings.depth + settings.rollout_depth - 1,
        planning_time=-1.0,
        num_sims=settings.n_sim,
        discount_factor=settings.gamma,
        exploration_const=settings.ucb_c,
        rollout_policy=policy,
    )
    look = planner.plan(agent)
    return Found(look.bin, float(agent.tree[look].value), time.thread_time() - began)
