"""A recording instead of a receiver: the same loop gives the same run, another loop sees what was recorded."""

import pytest

from cogradar.services.emulator.front_end import FrontEnd, FrontEndError
from cogradar.services.emulator.recorded import RecordedFrontEnd, check_fits
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, Plan, RunEnd, RunStart, Scan, Waveform
from cogradar.shared.wire.codec import encode
from tests.samples import plan
from tests.services.loop import SMOKE, plans, play, scans, smoke_start
from tests.skies import sky_start, small_sky

DWELLS = 8


@pytest.fixture(scope="module")
def recorded() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def _without_world(start: RunStart) -> RunStart:
    return start.model_copy(update={"scenario": start.scenario | {"world": None}})


def _replayed(recorded: list[Message], start: RunStart, n_scan: int | None = None) -> list[Message]:
    payloads = {scan.k: encode(scan) for scan in scans(recorded)[:n_scan]}

    def open_recording(_: EmulatorCheckpoint) -> FrontEnd:
        return RecordedFrontEnd(payloads.get)

    return play(_without_world(start), open_recording)


def _of_loop(messages: list[Message]) -> list[bytes]:
    return [encode(message) for message in messages if isinstance(message, Scan | Plan | Waveform | RunEnd)]


def test_the_same_loop_plays_the_same_run(recorded: list[Message]) -> None:
    assert _of_loop(_replayed(recorded, smoke_start(dwells=DWELLS))) == _of_loop(recorded)


def test_another_loop_sees_the_recorded_scans(recorded: list[Message]) -> None:
    again = _replayed(recorded, smoke_start(seed=2, dwells=DWELLS))
    assert [encode(scan) for scan in scans(again)] == [encode(scan) for scan in scans(recorded)]
    assert _of_loop(again) != _of_loop(recorded)
    assert isinstance(again[-1], RunEnd)


def test_a_run_ends_with_its_recording(recorded: list[Message]) -> None:
    again = _replayed(recorded, smoke_start(dwells=DWELLS), n_scan=5)
    assert scans(again) == scans(recorded)[:5]
    (end,) = [message for message in again if isinstance(message, RunEnd)]
    assert (end.status, end.k, end.t) == ("complete", 4, scans(again)[-1].t)


@pytest.fixture(scope="module")
def sky() -> list[Message]:
    return play(sky_start(dwells=DWELLS))


def test_with_tracks_of_an_unknown_number_the_same_loop_plays_the_same_run(sky: list[Message]) -> None:
    assert any(plan.confirmed for plan in plans(sky))
    assert _of_loop(_replayed(sky, sky_start(dwells=DWELLS))) == _of_loop(sky)


def test_another_loop_follows_the_recorded_tracks(sky: list[Message]) -> None:
    """Whatever it would begin and end itself: the beams are those of the recorded ones."""
    again = _replayed(sky, sky_start("radar.belief.filter=likelihood", dwells=DWELLS, seed=2))
    assert [encode(scan) for scan in scans(again)] == [encode(scan) for scan in scans(sky)]
    assert [(plan.k, plan.target) for plan in plans(again)] == [(plan.k, plan.target) for plan in plans(sky)]
    assert _of_loop(again) != _of_loop(sky)
    (end,) = [message for message in again if isinstance(message, RunEnd)]
    assert end.status == "complete"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("radar.search.beams=3", "radar.search"),
        ("radar.initiation.false_tracks_per_hour=4", "radar.initiation"),
        ("radar.max_tracks=7", "radar.max_tracks"),
    ],
)
def test_another_search_would_have_found_others(setting: str, words: str) -> None:
    with pytest.raises(FrontEndError, match=f"^recorded with another {words}: scans would not fit$"):
        check_fits(small_sky().radar, small_sky(setting).radar)


def test_a_radar_to_which_the_scans_mean_nothing_is_refused() -> None:
    radar = SMOKE.radar
    check_fits(radar, radar.model_copy(update={"planner": radar.planner.model_copy(update={"n_sim": 7})}))
    other = radar.model_copy(update={"tracks": 3, "array": radar.array.model_copy(update={"n_bin": 32})})
    with pytest.raises(FrontEndError, match=r"radar\.tracks and radar\.array"):
        check_fits(radar, other)


def test_a_recording_of_something_else_is_refused() -> None:
    with pytest.raises(FrontEndError, match="is no scan"):
        RecordedFrontEnd(lambda _: encode(plan())).transmit(0, 0, None)  # type: ignore[arg-type]
