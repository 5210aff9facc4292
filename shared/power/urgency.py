"""Where the power does not suffice for all: the looks after which most is known of the targets some dwells later.

Symbols: i cell, m its track; p_i chance that the target is there; V_m what a look at the track's cells adds to the
probability of its most probable bin some dwells later, if it finds the target that is there (`Plan.worth`); f(g_i w_i)
probability of detection (`cogradar.shared.power.joint`).

    maximise  sum_i v_i f(g_i w_i),  v_i = V_m p_i / sum_{i of m} p_i,   subject to  sum_i w_i = P,  w_i >= 0

It is one step of lookahead over the beliefs. The function f is convex where power is scarce, so that few looks are
bright and the other tracks dark. Dark are tracks that are known well enough, and tracks whose look is too dear for what
it would tell. The latter would be dark for ever, hence turns. A look into the cell of another echo tells of the wrong
target: a track that is hidden behind another one is dark until they part.
"""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.looks import First, emitted
from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.power.wide import sure_powers, wanted
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import apart

TURN = 10  # dwells: of so many, one has a look for one track in turn, every TURN * M dwells for each
MOST = 0.9  # of the power that is not fixed, for the track whose turn it is
LEAST = 1e-4  # worth of any look: somebody is lit even if all is known


def urgency(radar: RadarConfig, requests: Requests) -> Emission:
    """Concentrate power on the looks with the largest expected information gain some dwells later.

    A cell that is the first one of a track is not asked to be lit for any other; of several tracks with one first cell
    the track with the strongest echo has it. The echo there would be taken for the echo of a target that is somewhere
    else, and the track would follow the wrong target from then on. It is looked at in its other cells, coasts if it has
    none, and its turn is of the first that it has. (Power to spare may widen looks over such a cell; a detection there
    belongs to the track that is nearest.)
    """
    found = requests.worths / np.maximum(requests.chances.sum(axis=1), LEAST)
    worths = np.maximum(found[:, np.newaxis] * requests.chances, LEAST)
    is_open = _open(requests, radar.array.n_bin)
    turn, is_turn = divmod(requests.k, TURN)
    given = None
    if is_turn == 0:
        track = turn % requests.gains.size
        if is_open[track].any():
            most = MOST * (radar.array.power - float(np.where(is_open[:, 0], requests.fixed, 0.0).sum()))
            sure = float(sure_powers(radar, requests.gains / wanted(radar, requests))[track])
            given = First(track, int(np.argmax(is_open[track])), min(sure, most))
    return emitted(radar, requests, worths, is_open, given)


def _open(requests: Requests, n_bin: int) -> NDArray[np.bool_]:
    """Which cells may be lit for each track, (M, C): none that is the first one of another, the stronger of two."""
    is_open = requests.chances > 0.0
    is_open[:, 0] = True
    for m in np.argsort(-requests.gains, kind="stable").tolist():
        if is_open[m, 0]:
            is_same = apart(requests.nus, requests.nus[m, 0]) * (n_bin - 1) < 0.5
            is_same[m] = False
            is_open &= ~is_same
    return is_open
