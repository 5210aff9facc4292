"""Where the power does not suffice for all: the looks after which most is known of the targets some dwells later.

Symbols: i cell, m its track; p_i chance that the target is there; V_m what a look at the track's cells adds to the
probability of its most probable bin some dwells later, if it finds the target that is there (`Plan.worth`); f(g_i w_i)
probability of detection (`shared.power.joint`).

    maximise  sum_i v_i f(g_i w_i),  v_i = V_m p_i / sum_{i of m} p_i,   subject to  sum_i w_i = P,  w_i >= 0

It is one step of lookahead over the beliefs. f is convex where power is scarce, so that few looks are bright and the
other tracks dark: those that are known well enough, and those whose look is too dear for what it would tell. The latter
would be dark for ever, hence turns; and a look into the cell of a stronger echo tells of the wrong target.
"""

import numpy as np
from numpy.typing import NDArray

from shared.power.looks import emitted
from shared.power.rules import Emission, Requests
from shared.power.wide import sure_powers
from shared.scenario.radar_config import RadarConfig

TURN = 10  # dwells: of so many, one has a look for one track in turn, which is dark for TURN * M dwells at most
MOST = 0.9  # of the power, for the track whose turn it is
LEAST = 1e-4  # worth of any look: somebody is lit even if all is known


def urgency(radar: RadarConfig, requests: Requests) -> Emission:
    """A few bright looks, those that tell most of where the targets will be some dwells later.

    Of tracks whose first cells are one, only that of the strongest echo is lit: its echo is what the others would find,
    and they would follow the wrong target from then on. They coast until their cells are apart, but for their turns:
    nobody is dark for ever.
    """
    found = requests.worths / np.maximum(requests.chances.sum(axis=1), LEAST)
    worths = np.maximum(found[:, np.newaxis] * requests.chances, LEAST)
    tracks = _apart(requests, radar.array.n_bin)
    turn, is_turn = divmod(requests.k, TURN)
    given = None
    if is_turn == 0:
        track = turn % requests.gains.size
        given = track, min(float(sure_powers(radar, requests.gains)[track]), MOST * radar.array.power)
    return emitted(radar, requests, worths, tracks, given)


def _apart(requests: Requests, n_bin: int) -> NDArray[np.int64]:
    """Tracks, (n,), without those whose first cell is that of one with a stronger echo."""
    first, chosen = requests.nus[:, 0] * (n_bin - 1), list[int]()
    for m in np.argsort(-requests.gains, kind="stable").tolist():
        if all(abs(first[m] - first[other]) >= 0.5 for other in chosen):
            chosen.append(m)
    return np.sort(np.array(chosen))
