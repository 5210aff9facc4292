"""When the most probable bin is provably the best one, whatever a search would find.

Symbols: p_j chance that the target is in bin j at the next dwell, bin 1 the most probable one; d_j chance that a look
into j detects it there; gamma discount; H levels of looks; V value of what is left, H - 1 levels, of a belief.
"""

from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray


def worth_of_telling(gamma: float, depth: float) -> float:
    """Most that one look can be worth by what it tells: gamma + gamma^2 + .. of the H - 1 looks after it.

    depth : H >= 1; math.inf for any horizon, gamma / (1 - gamma)
    """
    later = 0.0 if depth == inf else gamma ** (depth - 1)
    return gamma * (1.0 - later) / (1.0 - gamma)


def is_greedy_optimal(share: ArrayLike, detected: ArrayLike, gamma: float, depth: float = 2) -> bool:
    """Whether no bin can be worth more than the most probable one: p_1 - p_j >= g p_j d_j for every other bin j.

        g = `worth_of_telling(gamma, depth)`

    share    : (n,) p_j; bins that are left out have p_j = 0, and are never better
    detected : (n,) p_j d_j
    False means that this does not tell.

    Proof. Looks do not move targets, and a reward is at most 1 and depends on state and look only. Let B be the belief
    predicted for the next dwell but one. Let B_o be the part of it that goes with what the look says, o. These are
    measures, with sum_o B_o = B, whichever bin is looked at. V of a measure is the best expected sum of the later
    rewards, with three properties:

        (i)   V(B) <= sum_o V(B_o): a radar that is told o may still look as if it were not;
        (ii)  V(B_o) <= V(B) for B_o <= B: every plan of looks is worth more, or as much, under the larger measure;
        (iii) gamma V(B_o) <= g B_o(all states): no more than every later reward.

    The target is not in j, or is not detected there: nothing, o = 0. Else it is, with probability p_j d_j. Hence

        Q(1) = p_1 + gamma sum_o V(B_o) >= p_1 + gamma V(B)                                                     by (i),
        Q(j) = p_j + gamma V(B_0) + gamma sum_{o > 0} V(B_o) <= p_j + gamma V(B) + g p_j d_j         by (ii) and (iii),

    where B_o is of 1 in the first line and of j in the second. So Q(j) > Q(1) only if p_1 - p_j < g p_j d_j.
    A rollout that is worth the same in all states adds the same to both. QED
    """
    p, told = np.asarray(share, dtype=np.float64), worth_of_telling(gamma, depth) * np.asarray(detected)
    best = int(np.argmax(p))
    others: NDArray[np.bool_] = np.arange(p.size) != best
    return bool(np.all(p[best] - p[others] >= told[others]))


def enough(gamma: float, depth: float = 2) -> float:
    """The chance p_1 from which the most probable bin is the best, whatever the other bins are.

        p_1 >= (1 + g) / (2 + g);   depth 2: (1 + gamma) / (2 + gamma), any horizon: 1 / (2 - gamma)

    Since p_j <= 1 - p_1 and d_j <= 1: p_1 - p_j - g p_j d_j >= p_1 - (1 + g)(1 - p_1), which is then not negative.
    """
    g = worth_of_telling(gamma, depth)
    return (1.0 + g) / (2.0 + g)
