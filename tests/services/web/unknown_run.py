"""A run by hand in which nobody tells the radar how many targets there are."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cogradar.shared.protocol.messages import Message, Scan, Truth, Waveform
from cogradar.shared.protocol.roster import Roster
from tests.services.births import FAR, HERE, THERE, end, plan, roster, scan, start_of, truth, waveform

DWELLS = 12
LATE = (8, 9)  # dwells of a waveform with a late plan of the first track, the second time as no newer one had come


class Life(NamedTuple):
    """A track: it is in the scans of dwells born_k + 1 .. last_k, confirmed from a dwell on; None: it never is."""

    state: Sequence[float]
    born_k: int
    confirmed_k: int | None
    last_k: int


# The first target is there throughout, the second in dwells k = 5 .. 9, and the second track is of nothing.
LIVES = (Life(HERE, 0, 2, DWELLS - 1), Life(FAR, 2, None, 4), Life(THERE, 5, 7, 9))
TARGETS = {0: (HERE, range(DWELLS)), 1: (THERE, range(5, 10))}


def _alive(k: int) -> dict[int, Life]:
    return {m: life for m, life in enumerate(LIVES) if life.born_k < k <= life.last_k}


def _is_confirmed(life: Life, k: int) -> bool:
    return life.confirmed_k is not None and life.confirmed_k <= k


def _roster(k: int) -> Roster:
    alive = _alive(k)
    states = {m: life.state for m, life in alive.items()}
    born = [m for m, life in alive.items() if life.born_k == k - 1]
    found = roster(states, [m for m, life in alive.items() if _is_confirmed(life, k - 1)], born)
    begun = sum(life.born_k < k for life in LIVES)
    return found.model_copy(
        update={"born_k": np.array([life.born_k for life in alive.values()], np.int32), "next_id": begun}
    )


def _dwell(k: int) -> list[Message]:
    here = _roster(k)
    there = {m: state for m, (state, ks) in TARGETS.items() if k in ks}
    over = [life.state for life in _alive(k).values() if life.state is not FAR]
    said = [scan(k, here, over), truth(k, there)]
    for m, life in _alive(k).items():
        status = "ended" if k == life.last_k < DWELLS - 1 else "tracking"
        judged: dict[str, Any] = {"confirmed": _is_confirmed(life, k), "covariance": np.diag([0.01, 1e-6, 0.01, 1e-6])}
        judged |= {"existence": 0.9 if _is_confirmed(life, k) else 0.4}
        said.append(plan(k, m, life.state, status=status, detected=life.state is not FAR, **judged))
    return [*said, waveform(k, _roster(k + 1) if k + 1 < DWELLS else here)]


def sent() -> list[Message]:
    """Every message."""
    return [start_of(DWELLS), *(message for k in range(DWELLS) for message in _dwell(k)), end(DWELLS)]


def late(message: Message) -> Message:
    """A message of the same run in real time: a plan was late, and then a waveform."""
    match message:
        case Waveform(k=k) if k == LATE[0] - 2:
            return message.model_copy(update={"late": np.array([1, 0], np.int32)})
        case Scan(t=t, k=k) | Truth(t=t, k=k) if t == LATE[1]:
            return message.model_copy(update={"waveform_k": k - 2})
    return message
