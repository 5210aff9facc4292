"""When a run is asked for what it lacks: by its own dwells, twice as late each time, later beside others."""

import pytest

from cogradar.services.recorder.retransmit_timer import FIRST, LAST, SHARED, RetransmitTimer


def _asked(timer: RetransmitTimer, ticks: int, *, is_shared: bool = False) -> list[int]:
    """The ticks at which it asks, of so many without news."""
    asked = []
    for tick in range(1, ticks + 1):
        timer.tick()
        if timer.is_over(is_shared=is_shared):
            asked.append(tick)
            timer.ask()
    return asked


def test_it_asks_twice_as_late_each_time_and_then_now_and_then() -> None:
    assert _asked(RetransmitTimer(), 160) == [2, 6, 14, 30, 62, 62 + LAST, 62 + 2 * LAST, 62 + 3 * LAST]
    assert _asked(RetransmitTimer(88), 280) == [88, 176, 264]  # of a slow run in real time


def test_what_comes_of_the_dwell_begins_the_wait_anew() -> None:
    timer = RetransmitTimer()
    assert _asked(timer, 13) == [2, 6]
    timer.hear()
    assert _asked(timer, 13) == [2, 6]


def test_beside_others_the_first_request_is_later_and_the_late_ones_are_not() -> None:
    assert _asked(RetransmitTimer(), 100, is_shared=True) == [SHARED, 2 * SHARED, 3 * SHARED, 5 * SHARED, 9 * SHARED]


@pytest.mark.parametrize("ticks", [5, 8, 14, 15, 20, 30])
def test_a_run_whose_dwells_take_long_is_soon_asked_no_more(ticks: int) -> None:
    """Also if the last request always comes just before the dwell is complete."""
    timer = RetransmitTimer()
    asked = []
    for _ in range(10):
        asked.append(len(_asked(timer, ticks)))
        timer.learn()
    assert asked[0] > 0
    assert sum(asked[-5:]) <= 1, asked


def test_what_came_after_a_request_was_lost_and_makes_nobody_slow() -> None:
    timer = RetransmitTimer()
    for _ in range(20):
        assert _asked(timer, FIRST) == [FIRST]
        timer.learn()


def test_who_was_slow_is_trusted_again_after_some_dwells() -> None:
    timer = RetransmitTimer()
    _asked(timer, 1)
    timer.learn()
    first = []
    for took in (20, 0, 0, 0, 0, 0, 0):
        for _ in range(took):
            timer.tick()
        timer.learn()
        first.append(timer.wait)
    assert first == [LAST, 16, 8, 4, FIRST, FIRST, FIRST]
