"""Lanes: few, never shared by runs that go on, not taken again at once."""

import numpy as np

from shared.wire.keys import LEFT_ALONE, SILENT_S, Lanes


def test_runs_that_go_on_at_once_have_lanes_of_their_own() -> None:
    lanes = Lanes()
    assert [lanes.of(run) for run in ("a", "b", "a", "c", "b")] == [0, 1, 0, 2, 1]


def test_a_lane_is_taken_again_when_enough_others_were_left_later() -> None:
    lanes = Lanes()
    for i in range(LEFT_ALONE + 1):
        assert lanes.of(f"r{i}") == i
        lanes.leave(f"r{i}")
        lanes.leave(f"r{i}")  # a repeated end changes nothing
    assert lanes.of("new") == 0
    assert lanes.of("newer") == LEFT_ALONE + 1
    assert lanes.of("r0") == LEFT_ALONE + 2  # what is said of a run whose lane is gone


def test_a_run_that_is_over_keeps_its_lane_until_another_takes_it() -> None:
    lanes = Lanes()
    lanes.of("a")
    lanes.leave("a")
    lanes.leave("nobody")
    assert (lanes.of("b"), lanes.of("a")) == (1, 0)


def test_a_run_that_nobody_speaks_of_leaves_its_lane() -> None:
    now = 0.0
    lanes = Lanes(clock=lambda: now)
    for i in range(LEFT_ALONE + 1):
        lanes.of(f"r{i}")
    now = SILENT_S + 1.0
    assert lanes.of("new") == 0


def test_there_are_no_more_lanes_than_runs_at_once_and_a_few() -> None:
    rng, lanes, live = np.random.default_rng(1), Lanes(), list[str]()
    most = 0
    for i in range(2000):
        live.append(f"r{i}")
        most = max(most, len(live))
        taken = [lanes.of(run) for run in live]
        assert len(set(taken)) == len(live)
        assert max(taken) < most + LEFT_ALONE + 1
        while live and rng.random() < 0.55:
            lanes.leave(live.pop(int(rng.integers(len(live)))))
