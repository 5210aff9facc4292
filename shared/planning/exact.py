"""The depth-2 value of every bin, over all particles and all levels of the echo: what the search estimates.

    Q(a) = P(b' = a) + gamma sum_o max_a' P(b'' = a', o | a)

Symbols: s state, A the motion without noise; b', b'' the bins of A s and of A^2 s; a, a' the bins looked at; o what a
look into a says: nothing, or a detection of level q, with P(q | u) at u = |alpha|/sigma_hat of A s if b' = a. A look
does not move a target, so that it is worth its own reward and what it tells of the next.

What the search simulates besides, noise of the motion over two dwells, is left out: it moves a bin's border by metres.
"""

from functools import lru_cache
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import exp
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.planning.radar_pomdp import RadarPomdp
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.echo_laws import LAWS
from cogradar.shared.signal.radar_equation import strength
from cogradar.shared.tracking.motion import advance
from cogradar.shared.tracking.sensor import STEP, level_of, log_level_probability, log_miss_probability

MOST_U = 64.0  # echoes that are stronger are taken as this strong: their levels are one, and tell nothing of the range
_NODES_PER_UNIT = 32  # of u: linear interpolation of P errs by |d2 P/du2| / (8 * 32^2), 1e-4
_NEGLIGIBLE = 1e-9  # probability of a level that is left out
_MARGIN = 5.0  # in r, beyond MOST_U: exp(-25)
_FLUCTUATION = 4.6  # of r, over u: exp(-4.6^2), 1e-9


class LevelTable(NamedTuple):
    """What a look at a target tells, at nodes of u equally spaced over 0 .. MOST_U."""

    miss: NDArray[np.float64]  # (n_node,) P(nothing | u)
    first: NDArray[np.int64]  # (n_node,) lowest level that is not negligible
    chance: NDArray[np.float64]  # (n_node, n_band) P(q | u) of the levels first, first + 1 ..
    n_level: int  # levels 0 .. n_level - 1


class Values(NamedTuple):
    """Of the bins `first_bin`, first_bin + 1 .. in which particles are expected; n of them. No other bin is better."""

    first_bin: int
    q: NDArray[np.float64]  # (n,) Q(a)
    share: NDArray[np.float64]  # (n,) P(b' = a)
    detected: NDArray[np.float64]  # (n,) P(b' = a and a look into a detects it)
    elsewhere: float  # Q of any other bin

    def of(self, bin_: int) -> float:
        """Q of any bin."""
        i = bin_ - self.first_bin
        return float(self.q[i]) if 0 <= i < self.q.size else self.elsewhere


def values_of(problem: RadarPomdp, gamma: float) -> Values:
    """Depth-2 values of the belief of a problem, (n, 4); no random numbers.

    Time and memory: O(n + pairs * n_level + box). A pair (b', b'') occurs if it has particles, so that there are n at
    most. The box of all pairs, (bins of b') x (bins of b''), has n_bin^2 at most, and is only counted.
    """
    table = level_table(2.0 * problem.least**2, list(LAWS)[problem.law])
    return Values(*depth_two_values(problem, table, gamma))


@lru_cache(maxsize=16)
def level_table(threshold: float, rcs: str = "known") -> LevelTable:
    """The table of a receiver with this threshold lambda; 2049 nodes, each with a band of some eight levels.

    Levels of a fluctuating echo spread over all that there are. If the RCS is not known, there is but one.
    """
    u = np.arange(int(MOST_U * _NODES_PER_UNIT) + 1) / _NODES_PER_UNIT
    miss = exp(log_miss_probability(threshold, u, rcs))
    if not LAWS[rcs].tells_range:
        return LevelTable(miss, np.zeros(u.size, np.int64), 1.0 - miss[:, np.newaxis], 1)
    lowest, most = level_of(sqrt(0.5 * threshold)), _FLUCTUATION * MOST_U if LAWS[rcs].fluctuates else MOST_U + _MARGIN
    n_level = ceil(most / STEP)
    chance = np.zeros((n_level, u.size))
    for level in range(lowest, n_level):
        chance[level] = exp(log_level_probability(level, threshold, u, rcs))
    counts = chance > _NEGLIGIBLE
    first = np.argmax(counts, axis=0)
    band = np.minimum(first[:, np.newaxis] + np.arange(int(counts.sum(axis=0).max())), n_level - 1)
    kept = np.where(np.diff(band, axis=1, prepend=-1) > 0, np.take_along_axis(chance.T, band, axis=1), 0.0)
    return LevelTable(miss, first, np.ascontiguousarray(kept), n_level)


@kernel
def depth_two_values(
    problem: RadarPomdp, table: LevelTable, gamma: float
) -> tuple[int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """The fields of `Values`.

    Particles are sorted by their pair of bins (a, a'), counted at the nodes of u, and only then is every node that
    occurs spread over its levels. This takes a pass over the particles, and a few over a small table.
    """
    n = problem.particles.shape[0]
    now, then, position = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32), np.empty(n)
    _advance_twice(problem, now, then, position)
    first, first_next = now.min(), then.min()
    n_action, n_next = now.max() - first + 1, then.max() - first_next + 1

    # start[c] .. start[c + 1] are the places of the particles of pair c = (a, a').
    start = np.zeros(n_action * n_next + 1, dtype=np.int64)
    for i in range(n):
        now[i] = (now[i] - first) * n_next + then[i] - first_next
        start[now[i] + 1] += 1
    for c in range(n_action * n_next):
        start[c + 1] += start[c]
    place, ordered = start.copy(), np.empty(n)
    for i in range(n):
        ordered[place[now[i]]] = position[i]
        place[now[i]] += 1

    next_share = np.zeros(n_next)
    for c in range(n_action * n_next):
        next_share[c % n_next] += start[c + 1] - start[c]
    q, share, detected = np.empty(n_action), np.empty(n_action), np.empty(n_action)
    at_node = np.zeros(table.miss.size)
    by_level, missed = np.empty((table.n_level, n_next)), np.empty(n_next)
    for a in range(n_action):
        n_pair = 0  # of those with a that occur; no other has a level
        missed[:] = next_share
        for b in range(n_next):
            c = a * n_next + b
            if start[c] < start[c + 1]:
                by_level[:, n_pair] = 0.0
                missed[b] -= _spread(ordered[start[c] : start[c + 1]], table, at_node, by_level[:, n_pair])
                n_pair += 1
        told = missed.max()
        if n_pair:
            for level in range(table.n_level):
                told += by_level[level, :n_pair].max()
        share[a] = (start[(a + 1) * n_next] - start[a * n_next]) / n
        detected[a] = 1.0 - missed.sum() / n
        q[a] = share[a] + gamma * told / n
    return first, q, share, detected, gamma * next_share.max() / n


@kernel
def _advance_twice(
    problem: RadarPomdp, now: NDArray[np.int32], then: NDArray[np.int32], position: NDArray[np.float64]
) -> None:
    """Bins b' and b'', and u of A s in nodes of the table, of every particle; (n,) each, in place."""
    particles, dt, n_bin = problem.particles, problem.motion.dt, problem.n_bin
    for i in range(particles.shape[0]):
        x, vx, y, vy = particles[i, 0], particles[i, 1], particles[i, 2], particles[i, 3]
        x, vx, y, vy = advance(x, vx, y, vy, dt, 0.0, 0.0)
        now[i] = bin_of(x, y, n_bin)
        u = strength(problem.gain, x * x + y * y, problem.tells_range)
        position[i] = min(u, MOST_U) * _NODES_PER_UNIT
        x, vx, y, vy = advance(x, vx, y, vy, dt, 0.0, 0.0)
        then[i] = bin_of(x, y, n_bin)


@kernel
def _spread(
    positions: NDArray[np.float64], table: LevelTable, at_node: NDArray[np.float64], by_level: NDArray[np.float64]
) -> float:
    """Add the particles at these positions to `by_level`, (n_level,); returns how many of them are detected.

    at_node : (n_node,) zeros, which it is left as
    """
    last, low, high = at_node.size - 2, at_node.size, 0
    for position in positions:
        node = min(int(position), last)
        low, high = min(low, node), max(high, node + 1)
        at_node[node + 1] += position - node
        at_node[node] += 1.0 - (position - node)
    hits = 0.0
    for node in range(low, high + 1):
        weight, at_node[node] = at_node[node], 0.0
        hits += weight * (1.0 - table.miss[node])
        for i in range(table.chance.shape[1]):
            by_level[min(table.first[node] + i, table.n_level - 1)] += weight * table.chance[node, i]
    return hits
