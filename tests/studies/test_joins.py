"""What planners that join cost a run: read off its time stamps."""

import threading

import pytest

from cogradar.services import kernels
from cogradar.services.errors import RunFailed
from cogradar.shared.wire.timestamps import Sent
from studies.processes.timestamps import RunTimestamps
from studies.scaling import joins
from tests.services.tables import assert_shown_whole


def test_the_longest_dwells_are_told_in_medians_of_those_before() -> None:
    dwells, joined_at, first = 60, 40, 100  # dwells of the acquisition are none
    lasting = [0.01] * first + [0.03 if t == 20 else 0.04 if t == 45 else 0.01 for t in range(dwells)]
    begun = [sum(lasting[: k + 1]) for k in range(len(lasting))]
    sent = [Sent("scan", "r", k, 0, at, 10) for k, at in enumerate(begun)]
    again = [Sent("scan", "r", k, 0, at + 5.0, 10) for k, at in enumerate(begun)]  # redelivered: no dwell
    plans = [Sent("plan", "r", k, item, begun[k], 10) for k in (150, len(begun) - 2) for item in range(3)]
    found = joins.summary(
        {
            "emulator-0": RunTimestamps(0.0, [], [*sent, *again]),
            "planner-0": RunTimestamps(0.0, [], [plans[0], plans[1], plans[2], plans[3]]),
            "planner-1": RunTimestamps(0.0, [], plans[4:]),
        },
        *(3, dwells, joined_at),
    )
    assert found.dwell_ms == pytest.approx(10.0)
    assert found.before == pytest.approx(3.0)
    assert found.meanwhile == pytest.approx(4.0)
    assert found.moved == pytest.approx(2 / 3)
    assert_shown_whole([joins.table([found])])


@pytest.mark.nightly
@pytest.mark.zenoh
def test_planners_join_a_run_and_take_their_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels.compile_all(lambda _: None)
    monkeypatch.setattr(joins, "REPEATS", 1)
    monkeypatch.setattr(joins, "DWELLS", {30: 100})
    monkeypatch.setattr(joins, "JOINED_AT", {30: 15})
    monkeypatch.setattr(joins, "JOINING", 2)
    (found,) = joins.measure(lambda _: None, threading.Event())
    assert found.moved > 0.3


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_run_that_is_over_before_is_no_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels.compile_all(lambda _: None)
    monkeypatch.setattr(joins, "DWELLS", {3: 30})
    monkeypatch.setattr(joins, "JOINED_AT", {3: 29})
    monkeypatch.setattr(joins, "JOINING", 1)
    with pytest.raises(RunFailed, match="was over before planners could join it"):
        joins.measure(lambda _: None, threading.Event())
