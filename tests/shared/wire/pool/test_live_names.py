"""Live names: who comes is a member at once; who goes is one for a while, and for as long as we are cut off."""

import math

from cogradar.shared.wire.pool.live_names import LEAVE_AFTER_S, RETURN_S, LiveNames


def _both() -> LiveNames:
    live = LiveNames()
    assert [live.appear(name) for name in ("b", "a", "b")] == [True, True, False]
    return live


def test_a_member_without_a_token_leaves_after_a_while() -> None:
    live = _both()
    assert (live.names, live.due_s) == (("a", "b"), math.inf)
    live.disappear("a", 10.0)
    live.disappear("nobody", 10.0)
    assert live.due_s == 10.0 + LEAVE_AFTER_S
    assert not live.expire(9.9 + LEAVE_AFTER_S, is_connected=True)
    assert live.names == ("a", "b")
    assert live.expire(live.due_s, is_connected=True)
    assert live.due_s == math.inf
    assert not live.appear("b")
    assert live.appear("a")


def test_a_token_that_comes_back_in_time_changes_nothing() -> None:
    live = _both()
    live.disappear("a", 10.0)
    assert not live.appear("a")
    assert not live.expire(1e6, is_connected=True)
    assert live.names == ("a", "b")


def test_nobody_leaves_while_this_process_is_cut_off_or_until_the_others_may_be_back() -> None:
    live = _both()
    live.disappear("a", 10.0)
    assert not live.expire(100.0, is_connected=False)
    assert live.due_s == 100.0 + RETURN_S
    assert not live.expire(99.9 + RETURN_S, is_connected=True)
    assert live.expire(live.due_s, is_connected=True)
    live.disappear("b", 200.0)
    assert live.due_s == 200.0 + LEAVE_AFTER_S
