"""How old a track is where it arrives."""

import threading

import pytest

from cogradar.services.errors import RunFailed
from cogradar.services.feed.asterix import Asterix, Source
from studies.processes import ages
from studies.processes.ages import Ages, times_of_tracks
from tests.services.feed.made import UTC_S, crowd
from tests.services.tables import assert_shown_whole

ASKED = (3, 1.0, 2)  # aircraft, rate, dwells


def test_ages_are_of_the_last_dwells_and_over_midnight() -> None:
    arrived = [(10.0, 1.0), (20.1, 20.0), (20.2, 20.0), (0.05, 86_399.95)]
    found = Ages.of(ASKED, arrived, [5.0], 0.5)
    assert (found.pictures, found.tracks) == (2, 1.5)
    assert found.most_ms == pytest.approx(200.0)
    assert found.p50_ms == pytest.approx(100.0)
    assert found.is_met
    assert not Ages.of(ASKED, [(1.3, 1.0)], [5.0], 0.5).is_met
    assert_shown_whole([ages.table(found)])
    with pytest.raises(RunFailed, match="no track has arrived"):
        Ages.of(ASKED, [], [5.0], 0.5)


def test_the_times_of_tracks_that_go_on_are_read() -> None:
    form, there = Asterix(Source(1, 2)), crowd(3, 1)
    times = [time for output in form.encode(there) for time in times_of_tracks(output.data)]
    assert times == [pytest.approx((UTC_S + 1.0) % 86_400.0, abs=1.0 / 128.0)] * 3
    assert [time for output in form.encode(there.without_tracks()) for time in times_of_tracks(output.data)] == []


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_small_crowd_is_heard() -> None:
    found = ages.measure(6, 4.0, 20, lambda _: None, threading.Event())
    assert found.pictures >= 18
    assert 3.0 < found.tracks <= 6.0
    assert 0.0 < found.p50_ms <= found.p99_ms
