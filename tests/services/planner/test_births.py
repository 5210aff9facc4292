"""What a planner keeps of tracks that begin and end: no more than of those there are."""

import gc

import numpy as np

from cogradar.services.planner.core import PlannerCore
from cogradar.services.planner.owned_track import OwnedTrack
from cogradar.shared.protocol.messages import Message
from cogradar.shared.tracking.model import TrackState
from tests.services.births import HERE, roster, scan, start_of
from tests.services.loop import checkpoint

DWELLS, LIFE, EVERY = 40, 3, 8


def test_nothing_is_kept_of_tracks_that_have_ended() -> None:
    """One begins with each dwell, and lives for three."""
    core, start, n_plan = PlannerCore("p"), start_of(DWELLS), 0
    before = _counted()
    core.handle(checkpoint(start))
    for k in range(DWELLS):
        alive = dict.fromkeys(range(max(k - LIFE, 0), k), HERE)
        here = roster(alive, born=[k - 1] if k else [], born_k=k - 1)
        n_plan += sum(isinstance(answer, Message) for answer in core.handle(scan(k, here)))
        if k % EVERY == EVERY - 1:
            list(core.handle(checkpoint(start, k + 1, k + 1)))
    states, tracks = np.subtract(_counted(), before)
    assert n_plan >= LIFE * (DWELLS - LIFE)
    assert tracks == LIFE
    assert states <= 2 * LIFE


def _counted() -> tuple[int, int]:
    gc.collect()
    kinds = [type(one) for one in gc.get_objects()]
    return kinds.count(TrackState), kinds.count(OwnedTrack)
