"""Slow, obvious versions of the search and the planning problem, and small problems with known answers, for the tests.

A finite problem is a table, so that one compiled search serves all of them and the exact solution needs no sampling.
"""

from dataclasses import dataclass, field
from math import log, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.planning.pomcp import SearchSettings
from cogradar.shared.planning.problem import implement, mean_rollout, random_action, sample_state, step

Array = NDArray[np.float64]


class Finite(NamedTuple):
    """A finite POMDP."""

    belief: Array  # (S,)
    transition: Array  # (A, S, S), P(s' | a, s)
    observation: Array  # (A, S, O), P(o | a, s')
    reward: Array  # (A, S, S), of (a, s, s')
    ends: NDArray[np.bool_]  # (S,) whether arriving in s' ends the episode
    level_mean: float  # expected reward of a random action, where it is the same in all states


@kernel
def draw(p: Array, rng: np.random.Generator) -> int:
    """Index with these probabilities."""
    u = rng.random()
    for i in range(p.size - 1):
        u -= p[i]
        if u < 0.0:
            return i
    return int(p.size - 1)


def _sample_state(problem: Finite, rng: np.random.Generator) -> int:
    return draw(problem.belief, rng)


def _step(problem: Finite, state: int, action: int, rng: np.random.Generator) -> tuple[int, int, float, bool]:
    following = draw(problem.transition[action, state], rng)
    observation = draw(problem.observation[action, following], rng)
    return following, observation, problem.reward[action, state, following], problem.ends[following]


def _random_action(problem: Finite, rng: np.random.Generator) -> int:
    return int(rng.random() * problem.transition.shape[0])


def _mean_rollout(problem: Finite, n_level: int, gamma: float) -> float:
    total, discount = 0.0, 1.0
    for _ in range(n_level):
        total += discount * problem.level_mean
        discount *= gamma
    return total


for _name, _function in (
    ("sample_state", _sample_state),
    ("step", _step),
    ("random_action", _random_action),
    ("mean_rollout", _mean_rollout),
):
    _function.__name__ = _name
    implement(Finite, _function)


# Problems.


def tracking(belief: tuple[float, float, float] = (0.5, 0.3, 0.2)) -> Finite:
    """The radar with three bins: a target that wanders, seen with probability 0.8 in the bin looked at."""
    walk = np.array([[0.7, 0.3, 0.0], [0.2, 0.6, 0.2], [0.0, 0.3, 0.7]])
    seen = 0.8 * np.eye(3)
    reward = np.broadcast_to(np.eye(3)[:, None, :], (3, 3, 3))
    return finite(belief, np.array([walk] * 3), np.stack([1.0 - seen, seen], axis=2), reward, level_mean=1.0 / 3.0)


LISTEN, OPEN_LEFT, OPEN_RIGHT = 0, 1, 2


def tiger(p_left: float = 0.5) -> Finite:
    """The tiger behind one of two doors: listening costs 1 and is right with 0.85; a door pays 10 or -100, then anew.

    Kaelbling, Littman & Cassandra 1998, "Planning and acting in partially observable stochastic domains", section 5.
    """
    anew = np.full((2, 2), 0.5)
    growl = np.array([[0.85, 0.15], [0.15, 0.85]])
    reward = np.array([[-1.0, -1.0], [-100.0, 10.0], [10.0, -100.0]])
    return finite(
        (p_left, 1.0 - p_left), np.array([np.eye(2), anew, anew]), np.array([growl, anew, anew]), reward[:, :, None]
    )


def bandit(p_win: Array) -> Finite:
    """One arm per action, which wins 1 with its own probability; nothing is seen."""
    lose_win = np.stack([1.0 - p_win, p_win], axis=1)[:, None, :]
    return finite((1.0, 0.0), lose_win, np.ones((1, 1, 1)), np.array([0.0, 1.0])[None, None, :])


def chain(n_state: int, n_action: int = 2) -> Finite:
    """The step taken from level d is worth d + 1, whatever the action: a return tells how many levels it spans."""
    onwards = np.eye(n_state, k=1)
    onwards[-1, -1] = 1.0
    worth = np.arange(1.0, n_state + 1.0)[None, :, None]
    return finite(np.eye(n_state)[0], np.array([onwards] * n_action), np.ones((1, 1, 1)), worth)


def finite(
    belief: Any, transition: Array, observation: Array, reward: Array, *, ends: Any = False, level_mean: float = 0.0
) -> Finite:
    """A problem from tables that may leave out the axes on which they do not depend."""
    n_action = transition.shape[0]
    n_state = transition.shape[2]
    shape = (n_action, n_state, n_state)
    return Finite(
        np.array(belief, dtype=np.float64),
        np.broadcast_to(transition, shape).copy(),
        np.broadcast_to(observation, (n_action, n_state, observation.shape[2])).copy(),
        np.broadcast_to(reward, shape).copy(),
        np.broadcast_to(np.asarray(ends), (n_state,)).copy(),
        level_mean,
    )


# Exact solution. A belief is kept without normalisation, so that values are expectations and nothing is divided.


def action_values(problem: Finite, weight: Array, horizon: int, gamma: float, leaf: float = 0.0) -> Array:
    """Q(b, a) of the optimal policy over `horizon` steps, with `leaf` earned after them; (A,)."""
    values = np.empty(problem.transition.shape[0])
    for a in range(values.size):
        values[a] = np.sum(weight[:, None] * problem.transition[a] * problem.reward[a])
        for o in range(problem.observation.shape[2]):
            values[a] += gamma * value(problem, after(problem, weight, a, o), horizon - 1, gamma, leaf)
    return values


def value(problem: Finite, weight: Array, horizon: int, gamma: float, leaf: float = 0.0) -> float:
    """V(b) of the optimal policy, times the belief's mass."""
    if horizon == 0:
        return float(leaf * weight.sum())
    return float(action_values(problem, weight, horizon, gamma, leaf).max()) if weight.any() else 0.0


def after(problem: Finite, weight: Array, action: int, observation: int) -> Array:
    """Belief after an action and an observation, without what has ended; its mass is their probability."""
    moved = weight @ problem.transition[action]
    return np.asarray(moved * problem.observation[action, :, observation] * ~problem.ends)


def return_variance(problem: Finite, action: int, horizon: int, gamma: float) -> float:
    """Variance of the return of an action that is followed by the optimal policy, by enumeration of all courses."""
    p, g = np.array(_courses(problem, problem.belief, problem.belief, action, horizon, gamma)).T
    return float(p @ g**2 - (p @ g) ** 2)


def _courses(
    problem: Finite, belief: Array, actual: Array, action: int, horizon: int, gamma: float
) -> list[tuple[float, float]]:
    """(probability, return) of each course of events from the states `actual`, for an agent that believes `belief`."""
    courses = []
    n_state, n_observation = belief.size, problem.observation.shape[2]
    for s, s_next, o in np.ndindex(n_state, n_state, n_observation):
        p = actual[s] * problem.transition[action, s, s_next] * problem.observation[action, s_next, o]
        reward = problem.reward[action, s, s_next]
        if p == 0.0:
            continue
        if horizon == 1 or problem.ends[s_next]:
            courses.append((p, reward))
            continue
        learnt = after(problem, belief, action, o)
        best = int(np.argmax(action_values(problem, learnt, horizon - 1, gamma)))
        there = p * np.eye(n_state)[s_next]
        courses += [(q, reward + gamma * g) for q, g in _courses(problem, learnt, there, best, horizon - 1, gamma)]
    return courses


# Search.


@dataclass
class Node:
    """A history: descents, and of each action visits and mean return; None until it is descended into."""

    n: int = 0
    visits: list[int] | None = None
    value: list[float] = field(default_factory=list)
    offset: int = 0
    children: dict[tuple[int, int], "Node"] = field(default_factory=dict)

    def all(self) -> "list[Node]":
        """This node and those below it."""
        return [self] + [node for child in self.children.values() for node in child.all()]


def search_tree(problem: Any, actions: NDArray[np.int64], settings: SearchSettings, rng: np.random.Generator) -> Node:
    """The tree of PO-UCT as objects; draws the same numbers as the kernel in the same order."""
    root, order = Node(), rng.permutation(actions.size)
    for _ in range(settings.n_sim):
        _simulate(problem, actions, settings, sample_state(problem, rng), root, 0, order, rng)
    return root


def _simulate(
    problem: Any,
    actions: NDArray[np.int64],
    settings: SearchSettings,
    state: Any,
    node: Node,
    depth: int,
    order: NDArray[np.int64],
    rng: np.random.Generator,
) -> float:
    if node.visits is None:
        node.visits, node.value = [0] * actions.size, [0.0] * actions.size
        node.offset = int(rng.random() * actions.size)
    if node.n < actions.size:
        choice = int(order[(node.offset + node.n) % actions.size])
    else:
        scale = settings.ucb_c * sqrt(log(node.n))
        bounds = [q + scale * (1.0 / sqrt(n)) for q, n in zip(node.value, node.visits, strict=True)]
        choice = bounds.index(max(bounds))
    node.n += 1
    state, observation, reward, terminal = step(problem, state, int(actions[choice]), rng)
    tail, depth = 0.0, depth + 1
    if not terminal:
        known = (choice, int(observation)) in node.children
        child = node.children.setdefault((choice, int(observation)), Node())
        if known and depth < settings.depth:
            tail = _simulate(problem, actions, settings, state, child, depth, order, rng)
        else:
            n_level = settings.depth + settings.rollout_depth - depth
            tail = rollout(problem, state, n_level, settings, rng)
    total = float(reward + settings.gamma * tail)
    node.visits[choice] += 1
    node.value[choice] += (total - node.value[choice]) / node.visits[choice]
    return total


def rollout(problem: Any, state: Any, n_level: int, settings: SearchSettings, rng: np.random.Generator) -> float:
    """Value of a leaf."""
    if settings.rollout_mean:
        return mean_rollout(problem, n_level, settings.gamma)
    total, discount = 0.0, 1.0
    for _ in range(n_level):
        state, _, reward, terminal = step(problem, state, random_action(problem, rng), rng)
        total += discount * reward
        discount *= settings.gamma
        if terminal:
            break
    return total
