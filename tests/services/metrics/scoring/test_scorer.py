"""Scores of single dwells, in which something is late."""

from itertools import groupby
from typing import Any

import numpy as np

from cogradar.services.metrics.scoring.scorer import SCORED, Scorer
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.wire.codec import encode, fields
from tests.services.loop import play, smoke_start

Scored = Plan | Scan | Truth | Waveform
LAST = 6
FAST = np.array([40.0, 0.0, 0.0, 5.0])  # at boresight; two dwells later nu = 0.121, in bin 9 of 16


def _dwell(message: Scored) -> int:
    return message.k


def _best_bins(start: RunStart, sent: list[Scored]) -> dict[tuple[int, int], Any]:
    """By dwell t and target."""
    scorer, found = Scorer(start), {}
    for k, messages in groupby(sorted(sent, key=_dwell), _dwell):
        scored = scorer.score(k, [(BY_MESSAGE[type(m)].name, fields(encode(m))) for m in messages])
        for row in scored.targets if scored is not None else ():
            found[row["t"], row["target"]] = row["best_bin"]
    return found


def test_the_best_bin_of_a_track_whose_plan_is_late_is_where_its_estimate_flies() -> None:
    start = smoke_start(dwells=LAST)
    sent = [message for message in play(start) if isinstance(message, Scored)]
    assert {BY_MESSAGE[type(message)].name for message in sent} == set(SCORED)
    newest = max(map(_dwell, sent))

    def late(message: Message) -> Message | None:
        """Track 1 has no plan of the dwell before the last one, and its plan before that flies fast."""
        if not isinstance(message, Plan) or message.target != 0 or message.k not in {newest - 1, newest - 2}:
            return message
        return message.model_copy(update={"estimate": FAST}) if message.k == newest - 2 else None

    in_time = _best_bins(start, sent)
    of_late = _best_bins(start, [kept for message in sent if isinstance(kept := late(message), Scored)])
    assert of_late[LAST, 1] == 9 != in_time[LAST, 1]
    assert of_late[LAST, 2] == in_time[LAST, 2]
