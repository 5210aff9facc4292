"""POMCP: Monte Carlo tree search over histories, for any problem given as a black-box generator.

Silver & Veness 2010, "Monte-Carlo Planning in Large POMDPs". The belief update is not here: a search starts from
states that the problem samples from its belief, and its tree is dropped with the decision.

Symbols: h history (a node), a action, ha edge, o observation, hao next node; N(h), N(ha) visits, Q(ha) mean return;
gamma discount; c exploration constant.

A problem is a NamedTuple of scalars and arrays, declared in an importable module, for which `implement` registers the
generic functions below; they are chosen by the problem's type, in Python and in the compiled search alike.
"""

from collections.abc import Callable
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from shared.jit import kernel

ROOT = 0
UNEXPANDED = -1  # a node that no simulation has descended into has no edges yet
FREE = -1  # slot of the hash table
_GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)  # Fibonacci hashing; as int64


@singledispatch
def sample_state(problem: Any, rng: np.random.Generator) -> Any:
    """A state drawn from the belief at the root."""
    raise NotImplementedError


@singledispatch
def step(problem: Any, state: Any, action: int, rng: np.random.Generator) -> tuple[Any, int, float, bool]:
    """Generator G(s, a): next state, observation (an integer in 0 .. 2^31 - 1), reward, whether the episode ends."""
    raise NotImplementedError


@singledispatch
def random_action(problem: Any, rng: np.random.Generator) -> int:
    """Action of the rollout policy; need not be one of the search's legal actions."""
    raise NotImplementedError


@singledispatch
def mean_rollout(problem: Any, n_level: int, gamma: float) -> float:
    """Exact expected return of n_level levels of the rollout policy, for problems where it is the same in all states."""
    raise NotImplementedError


def implement(problem: type, *functions: Callable[..., Any]) -> None:
    """Register a problem's versions of the generic functions, each named like its generic one."""
    generics = {generic.__name__: generic for generic in (sample_state, step, random_action, mean_rollout)}
    for function in functions:
        generic = generics[function.__name__]
        generic.register(problem)(function)
        overload(generic, strict=False)(_chooser(problem, function))


def _chooser(problem: type, function: Callable[..., Any]) -> Callable[..., Any]:
    def choose(argument: Any, *_: Any) -> Callable[..., Any] | None:
        chosen = isinstance(argument, types.BaseNamedTuple) and argument.instance_class is problem
        return function if chosen else None

    return choose


class SearchSettings(NamedTuple):
    """How to search."""

    n_sim: int  # simulations
    depth: int  # levels of actions in the tree
    rollout_depth: int  # levels of the rollout below the tree
    rollout_mean: bool  # leaves get `mean_rollout` instead of a random rollout
    gamma: float  # discount, 0 <= gamma < 1
    ucb_c: float  # exploration constant, in units of the return


class SearchResult(NamedTuple):
    """The decision, and what the root knows of every legal action."""

    action: int
    value: NDArray[np.float64]  # (n_action,) Q(ha), 0 if never tried
    visits: NDArray[np.int64]  # (n_action,) N(ha)
    n_node: int
    max_depth: int  # most actions taken inside the tree in one simulation


@kernel
def search(
    problem: Any, actions: NDArray[np.int64], settings: SearchSettings, rng: np.random.Generator
) -> SearchResult:
    """Best action from the belief of `problem` after n_sim simulations of PO-UCT.

        a = argmax_a Q(ha) + c sqrt(log N(h) / N(ha)),  untried actions first            (Silver & Veness 2010, Alg. 1)

    actions : (n_action,) legal actions. They belong to the history, not to the sampled state: if each particle tried
              only what suits it, Q(a) at the root would be an average over the particles that favour a.
    returns : the action of largest mean return among those tried; ties go to the more visited, then the first

    A new node is valued by a rollout over all levels that are left, depth + rollout_depth in total. Untried actions
    come in random order (a random permutation, from a random place in it), or those first in the list would win.
    Cost O(n_sim depth n_action) time; memory is bounded by n_sim nodes.
    """
    n_action = actions.size
    horizon = settings.depth + settings.rollout_depth
    leaf_value = np.zeros(settings.depth + 1)
    if settings.rollout_mean:
        for d in range(1, settings.depth + 1):
            leaf_value[d] = mean_rollout(problem, horizon - d, settings.gamma)

    # Nodes: number of descents, first edge, place where the untried actions begin. Edges, one per action, in blocks
    # that are handed out at a node's first descent; nine of ten nodes never have one.
    n_descent = np.zeros(settings.n_sim + 1, dtype=np.int64)
    first_edge = np.full(settings.n_sim + 1, UNEXPANDED, dtype=np.int64)
    offset = np.empty(settings.n_sim + 1, dtype=np.int64)
    visits = np.empty(settings.n_sim * n_action, dtype=np.int64)
    value = np.empty(settings.n_sim * n_action)
    exploration = np.empty(settings.n_sim * n_action)  # 1/sqrt(N(ha)), kept so that choosing needs no root
    n_node, n_edge, max_depth = 1, 0, 0

    # One hash table for all (edge, observation) -> node; at most half full.
    n_slot = 16
    while n_slot < 2 * (settings.n_sim + 1):
        n_slot *= 2
    slot_key = np.full(n_slot, FREE, dtype=np.int64)
    slot_node = np.empty(n_slot, dtype=np.int64)

    order = rng.permutation(n_action)
    path_edge = np.empty(settings.depth, dtype=np.int64)
    path_reward = np.empty(settings.depth)

    for _ in range(settings.n_sim):
        state = sample_state(problem, rng)
        node, length, tail = ROOT, 0, 0.0

        # Descend.
        while length < settings.depth:
            if first_edge[node] == UNEXPANDED:
                first_edge[node] = n_edge
                offset[node] = int(rng.random() * n_action)
                visits[n_edge : n_edge + n_action] = 0
                value[n_edge : n_edge + n_action] = 0.0
                n_edge += n_action
            first = first_edge[node]
            tried = n_descent[node]
            if tried < n_action:
                choice = order[(offset[node] + tried) % n_action]
            else:
                choice = _best_bound(value, exploration, first, n_action, settings.ucb_c * np.sqrt(np.log(tried)))
            n_descent[node] += 1
            state, observation, reward, terminal = step(problem, state, actions[choice], rng)
            path_edge[length] = first + choice
            path_reward[length] = reward
            length += 1
            if terminal:
                break

            # Next node, made if it is new.
            key = ((first + choice) << 31) | observation
            slot = ((key * _GOLDEN) >> 20) & (n_slot - 1)
            while slot_key[slot] != FREE and slot_key[slot] != key:
                slot = (slot + 1) & (n_slot - 1)
            known = slot_key[slot] == key
            if known:
                node = slot_node[slot]
            else:
                slot_key[slot] = key
                slot_node[slot] = n_node
                node = n_node
                n_node += 1

            # Value a leaf: a new node, or one at the tree's depth.
            if not known or length == settings.depth:
                if settings.rollout_mean:
                    tail = leaf_value[length]
                else:
                    tail = _rollout(problem, state, horizon - length, settings.gamma, rng)
                break
        max_depth = max(max_depth, length)

        # Back up.
        for d in range(length - 1, -1, -1):
            edge = path_edge[d]
            tail = path_reward[d] + settings.gamma * tail
            visits[edge] += 1
            value[edge] += (tail - value[edge]) / visits[edge]
            exploration[edge] = 1.0 / np.sqrt(visits[edge])

    root = first_edge[ROOT]
    root_visits, root_value = visits[root : root + n_action].copy(), value[root : root + n_action].copy()
    best = -1
    for i in range(n_action):
        if root_visits[i] > 0 and (
            best < 0
            or root_value[i] > root_value[best]
            or (root_value[i] == root_value[best] and root_visits[i] > root_visits[best])
        ):
            best = i
    return SearchResult(actions[best], root_value, root_visits, n_node, max_depth)


@kernel
def _best_bound(
    value: NDArray[np.float64], exploration: NDArray[np.float64], first: int, n_action: int, scale: float
) -> int:
    """Action of the largest upper confidence bound, Q(ha) + scale / sqrt(N(ha)), the first among equals."""
    best, bound = 0, -np.inf
    for i in range(n_action):
        candidate = value[first + i] + scale * exploration[first + i]
        if candidate > bound:
            best, bound = i, candidate
    return best


@kernel
def _rollout(problem: Any, state: Any, n_level: int, gamma: float, rng: np.random.Generator) -> float:
    """Discounted return of n_level levels of the rollout policy from a state."""
    total, discount = 0.0, 1.0
    for _ in range(n_level):
        state, _observation, reward, terminal = step(problem, state, random_action(problem, rng), rng)
        total += discount * reward
        discount *= gamma
        if terminal:
            break
    return total
