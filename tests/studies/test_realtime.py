"""The highest rate in real time, on real processes. Its search is tested with those runs."""

import threading

import pytest

from studies.processes import realtime


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_rate_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"N_TARGET": (3,), "N_PLANNER": (1,), "BUDGET_S": 1.0}.items():
        monkeypatch.setattr(realtime, name, value)
    (cell,) = realtime.bench(lambda _: None, threading.Event())
    assert cell.lockstep_hz > 0.0
    assert cell.best is None or 0.0 < cell.best.achieved_hz <= 1.1 * cell.best.rate_hz
