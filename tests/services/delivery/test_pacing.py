"""Lockstep and real time answer the same questions; a rate of 0 is lockstep."""

import math

import pytest

from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS, Lockstep, RealTime, pacing_at


def test_a_rate_of_zero_is_lockstep() -> None:
    assert pacing_at(0.0) == Lockstep()
    assert pacing_at(20.0) == RealTime(0.05)


def test_in_lockstep_no_time_passes_and_nothing_is_due() -> None:
    pacing = Lockstep()
    assert (pacing.seconds(1000), pacing.wait_s(0.5), pacing.next_due_s(None, 3.0)) == (0.0, None, None)
    assert (pacing.rest_s, pacing.most_ahead) == (math.inf, math.inf)
    assert not pacing.may_coast(1_000_000)
    assert pacing.may_transmit(MAX_AHEAD_DWELLS - 1)
    assert not pacing.may_transmit(MAX_AHEAD_DWELLS)
    assert pacing.first_open(9, 4) == 4


@pytest.mark.parametrize(
    ("due_s", "now_s", "expected"),
    [
        (None, 3.0, 3.5),  # the first tick
        (4.0, 3.9, None),  # not due yet
        (4.0, 4.1, 4.5),  # the rate is kept
        (4.0, 4.6, 5.1),  # a whole period late: what is overdue is not made up for
    ],
)
def test_in_real_time_a_dwell_is_due_each_period(due_s: float | None, now_s: float, expected: float | None) -> None:
    assert RealTime(0.5).next_due_s(due_s, now_s) == pytest.approx(expected)


def test_in_real_time_little_is_waited_for() -> None:
    pacing = RealTime(0.5)
    assert not pacing.may_transmit(0)
    assert pacing.first_open(9, 4) == 9
    assert not pacing.may_coast(2)
    assert pacing.may_coast(3)
    assert pacing.wait_s(1.5) == 0.75
    assert pacing.rest_s == 2.0
    assert RealTime(7.0).rest_s == 7.0  # the searches share a period
