"""One clock for all dwells of a run: what the front end says, counted on and back; one wrong time moves no other."""

from collections.abc import Mapping
from itertools import count, islice

import pytest

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.export.times import AHEAD, timed
from cogradar.services.runs.dwell import DwellMessages
from cogradar.shared.protocol.messages import Scan
from cogradar.shared.scenario.files import load
from tests.samples import sample

SITE = ["site.latitude_deg=48", "site.longitude_deg=11", "site.boresight_deg=90"]
NOW_S, BEGIN_S = 1.79e9, 1767225600.0


def _dwell(k: int, utc_s: float | None = None, *, has_world: bool = False, begins: bool = False) -> Dwell:
    """Of a run with two dwells of acquisition and intervals of 1 s."""
    scenario = load("smoke", [*SITE, 'site.begin_utc="2026-01-01T00:00:00Z"'] if begins else [])
    scan = sample(Scan, k=k, t=max(k - 1, 0), utc_s=utc_s)
    assert isinstance(scan, Scan)
    return Dwell(DwellMessages(k, scan, None), scenario if has_world else scenario.model_copy(update={"world": None}))


def _times(told: Mapping[int, float], n: int = 6, *, begins: bool = False) -> list[float]:
    found = list(timed([_dwell(k, told.get(k), begins=begins) for k in range(n)], 5.0, 2))
    assert {one.is_utc for one in found} == {begins or any(k < AHEAD for k in told)}
    assert [one.dwell.k for one in found] == list(range(n))
    return [one.at_s for one in found]


@pytest.mark.parametrize("begins", [False, True])
def test_dwells_before_the_first_time_are_counted_back(begins: bool) -> None:
    assert _times({3: NOW_S + 3.5, 5: NOW_S + 5.25}, begins=begins) == pytest.approx(
        [NOW_S + one for one in (0.5, 1.5, 2.5, 3.5, 4.5, 5.25)]
    )


@pytest.mark.parametrize("wrong_s", [7e9, NOW_S + 3600.0, 0.0])
def test_one_wrong_time_moves_no_other(wrong_s: float) -> None:
    right = {k: NOW_S + k for k in range(8)}
    assert _times(right | {4: wrong_s}, 8) == list(right.values())


def test_times_ascend_and_go_on_after_a_pause() -> None:
    assert _times({0: 100.0, 1: 101.0, 2: 100.5, 3: 103.0}, 4) == [100.0, 101.0, 101.0, 103.0]
    assert _times({0: 100.0, 1: 101.0, 2: 3602.0, 3: 3603.0, 4: 3604.0}) == [
        100.0,
        101.0,
        102.0,
        3603.0,
        3604.0,
        3605.0,
    ]


def test_without_a_clock_dwells_are_counted_from_the_site_or_the_epoch() -> None:
    assert _times({}, 4) == [5.0, 6.0, 7.0, 8.0]
    assert _times({}, 4, begins=True) == [BEGIN_S + one for one in (-1.0, 0.0, 1.0, 2.0)]
    late = {AHEAD: NOW_S, AHEAD + 1: NOW_S + 1}
    assert _times(late, AHEAD + 2) == [5.0 + k for k in range(AHEAD + 2)]  # one clock in a run


@pytest.mark.parametrize(("has_world", "taken"), [(True, 1), (False, AHEAD)])
def test_a_stream_is_looked_ahead_only_where_a_time_may_come(has_world: bool, taken: int) -> None:
    read = list[int]()
    stream = (read.append(k) or _dwell(k, has_world=has_world) for k in count())  # type: ignore[func-returns-value]
    assert [one.dwell.k for one in islice(timed(stream), 1)] == [0]
    assert len(read) == taken
