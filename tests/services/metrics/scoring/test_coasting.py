"""Scores of dwells whose plan of a track did not come: its estimate flies on, and is less sure."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from cogradar.services.metrics.scoring.scorer import Scorer
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import encode, fields
from tests.services.loop import play

LOST = range(20, 26)


def _scores(start: RunStart, sent: Iterable[Message]) -> dict[int, list[dict[str, Any]]]:
    """Rows by dwell k."""
    dwells: dict[int, list[tuple[str, dict[str, object]]]] = {}
    for message in sent:
        if isinstance(message, Scan | Truth | Plan | Waveform):
            dwells.setdefault(message.k, []).append((BY_MESSAGE[type(message)].name, dict(fields(encode(message)))))
    scorer = Scorer(start)
    found = {k: scorer.score(k, sorted(dwells[k], key=lambda item: item[0])) for k in sorted(dwells)}
    return {k: scored.targets for k, scored in found.items() if scored is not None}


def test_an_estimate_without_a_plan_flies_on() -> None:
    start = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 3, 30)
    sent = play(start)
    (track,) = {plan.target for plan in sent if isinstance(plan, Plan)} & {0}
    whole = _scores(start, sent)
    rows = _scores(start, [m for m in sent if not (isinstance(m, Plan) and m.target == track and m.k in LOST)])
    dt = load("smoke").radar.motion.dt_s
    before = next(row for row in rows[LOST[0] - 1] if row["track"] == track + 1)
    for n, k in enumerate(LOST, start=1):
        row = next(row for row in rows[k] if row["track"] == track + 1)
        for axis in "xy":
            flown = before[f"{axis}_hat"] + n * dt * before[f"v{axis}_hat"]
            assert row[f"{axis}_hat"] == pytest.approx(flown, rel=1e-9)
        assert np.isfinite(float(str(row["nees"])))
    assert rows[LOST[-1] + 1] == whole[LOST[-1] + 1]  # a plan is there again
