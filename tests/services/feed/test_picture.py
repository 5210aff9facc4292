"""Pictures of the air, from the messages of runs."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from cogradar.services.feed.picture import (
    PARTS,
    TRACKS_ALONE,
    WAIT_S,
    WITHOUT_PLOTS,
    Picture,
    Pictures,
    TrackReport,
    Wanted,
)
from cogradar.services.skies.place import Place
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.tracking.association import echoes
from cogradar.shared.wire.bus import Inbox
from cogradar.shared.wire.codec import BadMessage, decode, encode, join
from tests.services.feed.made import SITE
from tests.services.loop import play, smoke_start
from tests.skies import sky_start

DWELLS = 45


@pytest.fixture(scope="module")
def sky() -> list[Message]:
    return play(sky_start(dwells=DWELLS))


def pictures_of(
    said: Sequence[Message], wanted: Wanted = TRACKS_ALONE, *, begin_utc: str | None = None
) -> list[Picture]:
    start = next(message for message in said if isinstance(message, RunStart))
    site = SITE.model_copy(update={"begin_utc": begin_utc})
    made = Pictures(start.run, Scenario.model_validate(start.scenario), site, wanted)
    return [picture for message in said for picture in made.take(message, 0.0, 77.0)]


def test_each_dwell_has_one_picture_with_its_estimates_on_the_earth() -> None:
    said = play(smoke_start(dwells=6))
    found = [picture for picture in pictures_of(said, begin_utc="1970-01-01T00:01:00Z") if picture.t]
    assert [picture.t for picture in found] == [1, 2, 3, 4, 5, 6]
    assert [picture.utc_s for picture in found] == [60.0 + picture.t for picture in found]
    plans = {(plan.t, plan.target + 1): plan for plan in said if isinstance(plan, Plan)}
    place = Place.of(SITE)
    for picture in found:
        assert picture.is_simulated
        assert len(picture.tracks) == 2
        for track in picture.tracks:
            plan = plans[picture.t, track.number]
            x, vx, y, vy = plan.estimate.tolist()
            assert place.seen(track.latitude, track.longitude) == pytest.approx((x, y), abs=1e-6)
            assert np.hypot(track.east_km, track.north_km) == pytest.approx(np.hypot(x, y))
            assert track.speed == pytest.approx(1e3 * np.hypot(vx, vy))
            # A second later it is where its velocity says.
            there = place.position(x + 0.1 * vx, y + 0.1 * vy)
            north = (there[0] - track.latitude) * np.pi / 180.0 * 6.37e6 * 10.0
            assert north == pytest.approx(track.velocity[1], abs=0.01 * track.speed + 0.1)
            metres = 6.37e6 * np.cos(np.radians(track.latitude))
            east = (there[1] - track.longitude) * np.pi / 180.0 * metres * 10.0
            assert east == pytest.approx(track.velocity[0], abs=0.01 * track.speed + 0.1)
            # The variance along the velocity is the same in both frames.
            along = np.array([vx, vy]) @ plan.covariance[np.ix_((0, 2), (0, 2))] @ np.array([vx, vy])
            turned = np.array(track.velocity) @ track.covariance[np.ix_((0, 2), (0, 2))] @ np.array(track.velocity)
            assert turned == pytest.approx(1e12 * along, rel=1e-6)


@pytest.mark.parametrize("wanted", [TRACKS_ALONE, Wanted(plots=True)])
def test_the_time_is_the_front_ends_where_it_knows_it(sky: list[Message], wanted: Wanted) -> None:
    """Of dwell 20 it does not; nobody else does."""
    said = [m.model_copy(update={"utc_s": 1e9 + m.k}) if isinstance(m, Scan) and m.k != 20 else m for m in sky]
    parts = PARTS if wanted.plots else WITHOUT_PLOTS
    start, *rest = [message for message in said if isinstance(message, RunStart | Scan | Plan | Waveform)]
    found = pictures_of([start, *(decode(encode(message), parts) for message in rest)], wanted)
    assert len(found) == DWELLS
    assert [picture.utc_s for picture in found] == [1e9 + k if k != 20 else 77.0 for k in range(DWELLS)]
    assert [picture.is_timed for picture in found] == [k != 20 for k in range(DWELLS)]


def test_a_pause_is_seen_in_the_waveform(sky: list[Message]) -> None:
    silent = {"isotropic": 0.0}
    said = [
        m.model_copy(update=silent | {"factor": m.factor[:, :0]}) if isinstance(m, Waveform) and m.k == 20 else m
        for m in sky
    ]
    found = pictures_of(said)
    assert [picture.k for picture in found] == list(range(DWELLS))
    assert [picture.k for picture in found if picture.is_paused] == [20]


def test_tracks_are_told_from_confirmation_to_their_end(sky: list[Message]) -> None:
    plans = [message for message in sky if isinstance(message, Plan)]
    waveforms = {message.k: message for message in sky if isinstance(message, Waveform)}
    for picture in pictures_of(sky):
        roster = waveforms[picture.t - 1].roster
        assert roster is not None
        confirmed = {
            plan.target + 1
            for plan in plans
            if plan.k == picture.t - 1 and plan.confirmed and plan.target in roster.ids and plan.status == "tracking"
        }
        assert {track.number for track in picture.tracks} == confirmed
    assert any(picture.tracks for picture in pictures_of(sky))


def test_tentative_tracks_are_told_on_request(sky: list[Message]) -> None:
    found = [track for picture in pictures_of(sky, Wanted(tentative=True)) for track in picture.tracks]
    assert {track.confirmed for track in found} == {True, False}
    assert all(track.existence is not None for track in found)


def test_a_plan_is_read_as_far_as_a_picture_needs_it_with_the_same_limits(sky: list[Message]) -> None:
    for name, field in TrackReport.model_fields.items():
        of_plan = Plan.model_fields[name]
        assert (field.annotation, repr(field.metadata)) == (of_plan.annotation, repr(of_plan.metadata))
    plans = [message for message in sky if isinstance(message, Plan)]
    found = [decode(encode(plan), PARTS) for plan in plans]
    for report, plan in zip(found, plans, strict=True):
        assert isinstance(report, TrackReport)
        for name in TrackReport.model_fields:
            assert repr(getattr(report, name)) == repr(getattr(plan, name))
    for fault in ({"k": -1}, {"estimate": np.full(4, np.nan)}, {"existence": 1.5}, {"status": "lost"}):
        with pytest.raises(BadMessage, match=f"plan.{next(iter(fault))}"):
            decode(encode(plans[0].model_copy(update=fault)), PARTS)
    waveform = next(message for message in sky if isinstance(message, Waveform))
    assert decode(encode(waveform), PARTS) == waveform


def test_a_listener_takes_plans_from_their_key_alone(sky: list[Message]) -> None:
    plans = [message for message in sky if isinstance(message, Plan)][:2]
    inbox, payload = Inbox(parts=PARTS), join([encode(plan) for plan in plans])
    assert [type(one) for one in inbox.open(BY_MESSAGE[Plan].key_of(plans[0], "build"), payload)] == [TrackReport] * 2
    assert inbox.open(BY_MESSAGE[Waveform].key_of(plans[0], "build"), payload) == []


def test_a_waveform_waits_for_no_track_that_has_ended() -> None:
    said = [message for message in play(smoke_start(dwells=3)) if isinstance(message, RunStart | Plan | Waveform)]
    late = [message for message in said if isinstance(message, Plan) and message.t == 3 and message.target == 0]
    start, last = said[0], max(message.k for message in said if isinstance(message, Waveform))
    assert isinstance(start, RunStart)
    made = Pictures(start.run, Scenario.model_validate(start.scenario), SITE)
    found = [one for message in said if message not in late for one in made.take(message, 0.0, 0.0)]
    assert found[-1].t == 2
    end = late[0].model_copy(update={"k": last - 1, "status": "searching"})
    assert made.take(end, 0.0, 0.0) == []  # older than what is known of the track
    (picture,) = made.take(late[0].model_copy(update={"status": "searching"}), 0.0, 0.0)
    assert [track.number for track in picture.tracks] == [2]


def test_plots_are_the_detections_of_a_dwell_and_one_of_each_echo(sky: list[Message]) -> None:
    radar = Scenario.model_validate(next(one for one in sky if isinstance(one, RunStart)).scenario).radar
    rows, scans = ScanRows.of(radar), {one.k: one for one in sky if isinstance(one, Scan)}
    n_row = n_plot = 0
    for picture in pictures_of(sky, Wanted(plots=True)):
        seen = rows.read(vars(scans[picture.t - 1]))
        over = {
            (float(seen.ranges_km[i]), SITE.boresight_deg + math.degrees(math.asin(2.0 * seen.nu_hats[i])))
            for i in np.flatnonzero(seen.is_over())
        }
        assert len(picture.plots) == len(echoes(rows.response, seen, np.flatnonzero(seen.is_over())))
        for plot in picture.plots:
            assert any(plot == pytest.approx((one[0], one[1] % 360.0)) for one in over)
        n_row, n_plot = n_row + len(over), n_plot + len(picture.plots)
    assert 0 < n_plot < n_row
    assert not any(picture.plots for picture in pictures_of(sky))


def test_a_track_whose_plan_is_late_coasts_for_that_dwell() -> None:
    said = [message for message in play(smoke_start(dwells=6)) if isinstance(message, RunStart | Plan | Waveform)]
    lost = next(message for message in said if isinstance(message, Plan) and message.t == 3 and message.target == 0)
    start = said[0]
    assert isinstance(start, RunStart)
    made = Pictures(start.run, Scenario.model_validate(start.scenario), SITE)
    found = list[Picture]()
    for message in said:
        if isinstance(message, Plan) and message.t > 3:
            break
        if message is not lost:
            found += made.take(message, 10.0, 0.0)
    assert [picture.t for picture in found if picture.t] == [1, 2]
    assert made.late(10.0, 0.0) == []
    (picture,) = made.late(10.0 + WAIT_S, 0.0)
    before, now = found[-1].tracks[0], picture.tracks[0]
    x, y = Place.of(SITE).seen(before.latitude, before.longitude)
    plan = next(message for message in said if isinstance(message, Plan) and message.t == 2 and message.target == 0)
    assert Place.of(SITE).seen(now.latitude, now.longitude) == pytest.approx(
        (x + plan.estimate[1], y + plan.estimate[3]), abs=1e-6
    )
    assert picture.t == 3
    assert np.trace(now.covariance) > np.trace(before.covariance)


def test_messages_that_come_again_change_nothing() -> None:
    said = play(smoke_start(dwells=4))
    again = [message for message in said for _ in range(2)]
    assert [picture.t for picture in pictures_of(again)] == [picture.t for picture in pictures_of(said)]


def test_without_a_begin_a_picture_has_the_time_at_which_it_was_heard() -> None:
    assert {picture.utc_s for picture in pictures_of(play(smoke_start(dwells=2)))} == {77.0}
