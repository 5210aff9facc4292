"""POMCP: Monte Carlo tree search over histories, for any problem (`cogradar.shared.planning.problem`).

Silver & Veness 2010, "Monte-Carlo Planning in Large POMDPs". The belief update is not here: a search starts from
states that the problem samples from its belief, and its tree is dropped with the decision.

Symbols: h history (a node), a action, ha edge, o observation, hao next node; N(h), N(ha) visits, Q(ha) mean return;
gamma discount; c exploration constant.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.planning.problem import mean_rollout, random_action, sample_state, step

ROOT = 0
UNEXPANDED = -1  # a node that no simulation has descended into has no edges yet
FREE = -1  # slot of the hash table
_SLICE = 250  # simulations between two looks at the clock, some 30 us
OBSERVATION_BITS = 31  # of the key of the hash table; the edge has the rest


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


class Tree(NamedTuple):
    """The search tree in flat arrays, with room for n_sim simulations: each adds at most one node and one block.

    A block holds a node's edges, one per action. A node gets its block when a simulation first descends into it: nine
    of ten nodes never have one, and memory that is reserved but not touched costs nothing.
    """

    n_descent: NDArray[np.int64]  # (n_sim + 1,) N(h)
    block: NDArray[np.int64]  # (n_sim + 1,) of each node, UNEXPANDED without one
    offset: NDArray[np.int64]  # (n_sim + 1,) where in `order` its untried actions begin
    visits: NDArray[np.int32]  # (n_sim, n_action) N(ha), one row per block
    value: NDArray[np.float64]  # (n_sim, n_action) Q(ha)
    leader: NDArray[np.int64]  # (n_sim,) action of each block that had the largest bound when last compared
    rival: NDArray[np.float64]  # (n_sim,) the second largest bound then, less the `scale` of then
    slot_key: NDArray[np.int64]  # (2^k,) hash table of all (edge, observation), at most half full
    slot_node: NDArray[np.int32]  # (2^k,) the node they lead to
    order: NDArray[np.int64]  # (n_action,) a random permutation
    size: NDArray[np.int64]  # (3,) nodes, blocks, most actions taken inside the tree in one simulation


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
    tree = new_tree(settings.n_sim, actions.size, rng)
    simulate(tree, problem, actions, settings, settings.n_sim, rng)
    return best_action(tree, actions)


def search_while(
    problem: Any,
    actions: NDArray[np.int64],
    settings: SearchSettings,
    rng: np.random.Generator,
    has_time: Callable[[], bool],
) -> SearchResult:
    """The same search, cut short as soon as there is no time; `has_time` is asked every 250 simulations.

    With time enough the same numbers come out, simulation by simulation. Without any, the first 250 are made all the
    same: there is always a decision.
    """
    tree, left = new_tree(settings.n_sim, actions.size, rng), settings.n_sim
    while left > 0:
        simulate(tree, problem, actions, settings, min(left, _SLICE), rng)
        left -= _SLICE
        if not has_time():
            break
    return best_action(tree, actions)


@kernel
def new_tree(n_sim: int, n_action: int, rng: np.random.Generator) -> Tree:
    """A root that no simulation has descended into."""
    n_slot = 16
    while n_slot < 2 * (n_sim + 1):
        n_slot *= 2
    return Tree(
        np.zeros(n_sim + 1, dtype=np.int64),
        np.full(n_sim + 1, UNEXPANDED, dtype=np.int64),
        np.empty(n_sim + 1, dtype=np.int64),
        np.empty((n_sim, n_action), dtype=np.int32),
        np.empty((n_sim, n_action)),
        np.empty(n_sim, dtype=np.int64),
        np.empty(n_sim),
        np.full(n_slot, FREE, dtype=np.int64),
        np.empty(n_slot, dtype=np.int32),
        rng.permutation(n_action),
        np.array([1, 0, 0], dtype=np.int64),
    )


@kernel
def simulate(
    tree: Tree, problem: Any, actions: NDArray[np.int64], settings: SearchSettings, n: int, rng: np.random.Generator
) -> None:
    """Run n more simulations, up to settings.n_sim in total: descend to a leaf, value it, back up."""
    # Selection and expansion stand in the loop: in kernels of their own, however inlined, they cost 40 % of a search.
    n_descent, block, offset, visits, value, leader, rival, slot_key, slot_node, order, size = tree
    n_node, n_block, max_depth = size
    n_action, horizon = actions.size, settings.depth + settings.rollout_depth
    leaf_value = _leaf_values(problem, settings)
    spread = 1.0 / np.sqrt(np.maximum(np.arange(settings.n_sim + 1), 1))  # of N(ha): choosing needs no root
    blocks, choices = np.empty((2, settings.depth), dtype=np.int64)  # of the simulation under way, level by level
    rewards = np.empty(settings.depth)

    for _ in range(n):
        state = sample_state(problem, rng)
        node, length, tail = ROOT, 0, 0.0
        while length < settings.depth:
            # Expand: a node gets its edges when it is first descended into.
            if block[node] == UNEXPANDED:
                block[node], offset[node] = n_block, int(rng.random() * n_action)
                visits[n_block], value[n_block] = 0, 0.0
                leader[n_block], rival[n_block] = 0, np.inf
                n_block += 1

            # Select: an untried action as long as there are any, then the one of the largest bound.
            here, n_h = block[node], n_descent[node]
            if n_h < n_action:
                choice = order[(offset[node] + n_h) % n_action]
            else:
                # While the leader is chosen the other bounds grow with `scale` only, and no faster: 1/sqrt(N) <= 1.
                scale, choice = settings.ucb_c * np.sqrt(np.log(n_h)), leader[here]
                if value[here, choice] + scale * spread[visits[here, choice]] <= rival[here] + scale:
                    choice, second = _best_bounds(value[here], visits[here], spread, scale)
                    leader[here], rival[here] = choice, second - scale
            n_descent[node] += 1

            # Step, and go to the node of what is observed; a leaf if it is new or at the tree's depth.
            state, observation, reward, terminal = step(problem, state, actions[choice], rng)
            blocks[length], choices[length], rewards[length] = here, choice, reward
            length += 1
            if terminal:
                break
            key = ((here * n_action + choice) << OBSERVATION_BITS) | observation
            slot = _find(slot_key, key)
            is_new = slot_key[slot] == FREE
            if is_new:
                slot_key[slot], slot_node[slot] = key, n_node
                n_node += 1
            node = slot_node[slot]
            if is_new or length == settings.depth:
                if settings.rollout_mean:
                    tail = leaf_value[length]
                else:
                    tail = _rollout(problem, state, horizon - length, settings.gamma, rng)
                break

        max_depth = max(max_depth, length)
        _back_up(length, blocks, choices, rewards, tail, settings.gamma, visits, value)
    size[0], size[1], size[2] = n_node, n_block, max_depth


@kernel
def _back_up(
    length: int,
    blocks: NDArray[np.int64],
    choices: NDArray[np.int64],
    rewards: NDArray[np.float64],
    tail: float,
    gamma: float,
    visits: NDArray[np.int32],
    value: NDArray[np.float64],
) -> None:
    """Count the visits of one simulation and average its discounted returns; `tail` is the value of its leaf."""
    for d in range(length - 1, -1, -1):
        block, choice = blocks[d], choices[d]
        tail = rewards[d] + gamma * tail
        visits[block, choice] += 1
        value[block, choice] += (tail - value[block, choice]) / visits[block, choice]


@kernel
def best_action(tree: Tree, actions: NDArray[np.int64]) -> SearchResult:
    """The tried action of largest mean return; ties go to the more visited, then the first."""
    visits, value = tree.visits[0].astype(np.int64), tree.value[0].copy()
    best = -1
    for i in range(actions.size):
        if visits[i] > 0 and (best < 0 or (value[i], visits[i]) > (value[best], visits[best])):
            best = i
    return SearchResult(actions[best], value, visits, tree.size[0], tree.size[2])


@kernel
def _leaf_values(problem: Any, settings: SearchSettings) -> NDArray[np.float64]:
    """Exact value of a leaf after d = 1 .. depth steps, if leaves are valued so; (depth + 1,)."""
    values = np.zeros(settings.depth + 1)
    if settings.rollout_mean:
        for d in range(1, settings.depth + 1):
            values[d] = mean_rollout(problem, settings.depth + settings.rollout_depth - d, settings.gamma)
    return values


@kernel
def _find(slot_key: NDArray[np.int64], key: int) -> int:
    """Slot of the key, or the free one where it belongs. No product exceeds 63 bits, so that none overflows."""
    mask = slot_key.size - 1
    edge, observation = key >> OBSERVATION_BITS, key & (2**OBSERVATION_BITS - 1)
    mixed = (edge + observation * 0x9E3779B1) & 0x7FFFFFFF
    slot = (mixed * 0x85EBCA6B >> 31) & mask  # high bits of the product: they depend on all of the key
    while slot_key[slot] != FREE and slot_key[slot] != key:
        slot = (slot + 1) & mask
    return int(slot)


@kernel
def _best_bounds(
    value: NDArray[np.float64], visits: NDArray[np.int32], spread: NDArray[np.float64], scale: float
) -> tuple[int, float]:
    """Action of the largest bound Q(ha) + scale / sqrt(N(ha)), the first among equals, and the next largest bound."""
    best, bound, second = 0, -np.inf, -np.inf
    for i in range(value.size):
        candidate = value[i] + scale * spread[visits[i]]
        if candidate > bound:
            best, bound, second = i, candidate, bound
        elif candidate > second:
            second = candidate
    return best, second


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
