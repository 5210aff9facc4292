import numpy as np
import pytest

from services.planner import PlannerCore, owner
from shared.messages import Members, Plan, RunEnd, Scan
from shared.wire.codec import encode
from tests.services.loop import plans, play, scans, smoke_start


@pytest.fixture(scope="module")
def history() -> tuple[list[Scan], list[Plan]]:
    said = play(smoke_start(dwells=5))
    return scans(said), plans(said)


def _feed(core: PlannerCore, heard: list[Scan]) -> list[Plan]:
    return [plan for scan in heard for plan in core.handle(scan) if isinstance(plan, Plan)]


def _bytes(said: list[Plan]) -> list[bytes]:
    return [encode(plan) for plan in said]


def test_one_plan_per_track_and_scan(history: tuple[list[Scan], list[Plan]]) -> None:
    heard, expected = history
    assert [(plan.k, plan.target) for plan in expected] == [(scan.k, m) for scan in heard for m in (0, 1)]
    acquiring = [plan for plan in expected if plan.status == "searching"]
    assert all(plan.bin == -1 for plan in acquiring)
    tracking = [plan for plan in expected if plan.status == "tracking"]
    assert all(0 <= plan.bin < 16 and plan.range_km > 0 for plan in tracking)
    assert len(tracking) >= 2 * 6  # t = 0 .. 5


def test_a_worker_without_the_track_says_nothing(history: tuple[list[Scan], list[Plan]]) -> None:
    heard, expected = history
    names = ("a", "b", "c")
    said = []
    for name in names:
        core = PlannerCore(name)
        core.handle(Members("planner", names))
        core.handle(smoke_start())
        mine = _feed(core, heard)
        assert {plan.target for plan in mine} == {m for m in (0, 1) if owner("r", m, names) == name}
        said += mine
    assert sorted(_bytes(said)) == sorted(_bytes(expected))


def test_scans_out_of_order_or_twice_give_the_same_plans(history: tuple[list[Scan], list[Plan]]) -> None:
    heard, expected = history
    core = PlannerCore("p")
    core.handle(smoke_start())
    swapped = [heard[0], heard[0], heard[2], heard[1], *heard[3:], heard[-1]]
    # Of the two scans that came together only the newer is still worth planning for.
    skipped = heard[1].k
    assert _bytes(_feed(core, swapped)) == _bytes([plan for plan in expected if plan.k != skipped])


def test_scans_heard_before_the_start_of_their_run_are_kept(history: tuple[list[Scan], list[Plan]]) -> None:
    heard, expected = history
    core = PlannerCore("p")
    assert _feed(core, heard) == []
    assert _bytes([plan for plan in core.handle(smoke_start()) if isinstance(plan, Plan)]) == _bytes(expected)


def test_a_new_owner_rebuilds_the_track_from_the_history(history: tuple[list[Scan], list[Plan]]) -> None:
    """Taking tracks over in mid-run gives byte for byte what the former owner would have said."""
    heard, expected = history
    both = ("a", "b")
    theirs = [m for m in (0, 1) if owner("r", m, both) == "b"]
    if not theirs:
        both, theirs = ("a", "zz"), [m for m in (0, 1) if owner("r", m, ("a", "zz")) == "zz"]
    core = PlannerCore("a")
    core.handle(Members("planner", both))
    core.handle(smoke_start())
    half = len(heard) - 2
    _feed(core, heard[:half])
    taken_over = [plan for plan in core.handle(Members("planner", ("a",))) if isinstance(plan, Plan)]
    last = heard[half - 1].k
    assert _bytes(taken_over) == _bytes([plan for plan in expected if plan.k == last and plan.target in theirs])
    rest = _feed(core, heard[half:])
    assert _bytes(rest) == _bytes([plan for plan in expected if plan.k > last])


def test_a_run_that_ended_is_forgotten(history: tuple[list[Scan], list[Plan]]) -> None:
    heard, _ = history
    core = PlannerCore("p")
    core.handle(smoke_start())
    core.handle(RunEnd(run="r", k=0, t=0, status="complete"))
    assert _feed(core, heard[:1]) == []


def test_ownership_is_shared_out_and_only_a_leaving_workers_tracks_move() -> None:
    workers = [f"planner-{i}" for i in range(8)]
    before = [owner("r", m, workers) for m in range(100)]
    after = [owner("r", m, workers[1:]) for m in range(100)]
    assert all(old == new for old, new in zip(before, after, strict=True) if old != workers[0])
    counts = np.bincount([workers.index(name) for name in before], minlength=8)
    # Multinomial with mean 12.5 and standard deviation 3.3 per worker: 5 sigma.
    assert counts.max() <= 12.5 + 5 * 3.3
