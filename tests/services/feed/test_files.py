"""The formats that are files, and the loop that sends them."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.aircraft_json import KNOT, AircraftJson
from cogradar.services.feed.feed import FORMATS, Options, Tally, feed
from cogradar.services.feed.geojson import GeoJson
from cogradar.services.feed.output import Output
from cogradar.services.feed.picture import Picture
from cogradar.services.feed.transport import Folder
from tests.services.feed.made import SITE, UTC_S, crowd, picture, track


def test_aircraft_json_is_what_tar1090_reads() -> None:
    receiver, aircraft = AircraftJson().encode(picture(track(0x12), track(7, seen_s=3.0)))
    assert receiver.file == "receiver.json"
    said = json.loads(receiver.data)
    assert (said["lat"], said["lon"], said["history"]) == (SITE.latitude_deg, SITE.longitude_deg, 0)
    assert said["refresh"] >= 100
    found = json.loads(aircraft.data)
    assert found["now"] == UTC_S + 1.0
    first, second = found["aircraft"]
    assert (first["hex"], second["hex"], second["seen_pos"]) == ("~000012", "~000007", 3.0)
    assert first["gs"] == pytest.approx((100.0**2 + 200.0**2) ** 0.5 / KNOT, abs=0.1)
    assert first["track"] == pytest.approx(153.43, abs=0.01)  # to the south-east
    assert first["rc"] == pytest.approx(245.0, abs=1.0)
    assert "alt_baro" not in first


def test_the_receiver_is_told_once_and_the_aircraft_each_time() -> None:
    form = AircraftJson()
    assert [len(form.encode(picture(t=t))) for t in (1, 2, 3)] == [2, 1, 1]


def test_a_page_forgets_all_at_the_end_of_a_run_and_joins_no_trails() -> None:
    """It takes an aircraft away by the time of the files, and reads none that is not newer."""
    form = AircraftJson()
    made = [picture(track(1), track(5)), picture(track(5), t=2), picture(track(5), t=2).without_tracks()]
    made += [picture(track(1), run="r-2"), picture(track(1), t=100, run="r-2")]
    found = [json.loads(form.encode(one)[-1].data) for one in made]
    times = [one["now"] for one in found]
    assert times == sorted(set(times))
    assert times[2] > times[1] + 58.0
    assert times[4] == UTC_S + 100.0
    addresses = [[one["hex"] for one in file["aircraft"]] for file in found]
    assert addresses == [["~000001", "~000005"], ["~000005"], [], ["~000006"], ["~000006"]]


def test_geojson_has_a_point_for_each_track() -> None:
    made = crowd(20, seed=1)
    (output,) = GeoJson().encode(made)
    found = json.loads(output.data)
    assert found["type"] == "FeatureCollection"
    assert found["utc"] == "2026-09-21T14:13:21.000+00:00"
    for feature, of in zip(found["features"], made.tracks, strict=True):
        assert feature["geometry"] == {
            "type": "Point",
            "coordinates": [pytest.approx(of.longitude, abs=1e-7), pytest.approx(of.latitude, abs=1e-7)],
        }
        assert feature["properties"]["track"] == feature["id"] == of.number
        assert feature["properties"]["north_sigma_m"] == pytest.approx(of.covariance[2, 2] ** 0.5, abs=0.1)


class _Kept:
    done, is_answered = "kept", True

    def __init__(self) -> None:
        self.sent: list[list[int]] = []

    def send(self, outputs: Sequence[Output]) -> bool:
        self.sent += [[feature["id"] for feature in json.loads(output.data)["features"]] for output in outputs]
        return True

    def close(self) -> None: ...


def test_at_the_end_and_between_runs_no_track_stays() -> None:
    way, tally = _Kept(), Tally()
    made = [picture(track(1)), None, picture(track(1), track(2), t=2), picture(track(3), run="r-2")]
    feed(made, GeoJson(), way, 0.0, tally)
    assert tally == Tally(3, 3)  # and not those without tracks
    assert way.sent == [[1], [1, 2], [], [3], []]


def test_what_ends_the_feed_ends_its_tracks() -> None:
    def interrupted() -> Iterator[Picture]:
        yield picture(track(1))
        raise KeyboardInterrupt

    way, tally = _Kept(), Tally()
    with pytest.raises(KeyboardInterrupt):
        feed(interrupted(), GeoJson(), way, 0.0, tally)
    assert tally == Tally(1, 1)
    assert way.sent == [[1], []]


def test_more_pictures_than_may_be_sent_give_way_to_the_newest() -> None:
    def made() -> Iterator[Picture | None]:
        for t in range(1, 200):
            yield picture(track(t), t=t)
        time.sleep(0.11)
        yield None

    way = _Kept()
    feed(made(), GeoJson(), way, 10.0, Tally())
    assert way.sent[0] == [1]
    assert way.sent[-2:] == [[199], []]
    assert len(way.sent) < 20


def test_files_are_replaced_whole(tmp_path: Path) -> None:
    way = Folder(tmp_path / "new" / "folder")
    way.send([Output(b"a" * 10, "tracks.geojson")])
    way.send([Output(b"b", "tracks.geojson")])
    assert [(file.name, file.read_bytes()) for file in (tmp_path / "new" / "folder").iterdir()] == [
        ("tracks.geojson", b"b")
    ]


@pytest.mark.parametrize(
    ("to", "out", "words"),
    [
        ("aircraft-json", "-", "several files"),
        ("aircraft-json", "udp://127.0.0.1:9", "is files"),
        ("geojson", "http://host:80", "must be udp://HOST:PORT"),
        ("geojson", "udp://host:70000", "must be udp://HOST:PORT"),
        ("sapient", "udp://127.0.0.1:9", "needs a connection; must be tcp://HOST:PORT"),
    ],
)
def test_places_that_a_format_cannot_go_to(to: str, out: str, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        FORMATS[to].way(out, FORMATS[to].make(Options()), print)


class _Broken(_Kept):
    def send(self, outputs: Sequence[Output]) -> bool:
        if self.sent:
            raise RunFailed("standard output: its reader is gone")
        return super().send(outputs)


def test_with_no_way_left_nothing_is_sent_once_more() -> None:
    tally = Tally()
    with pytest.raises(RunFailed, match="reader is gone"):
        feed([picture(track(1)), picture(track(1), t=2)], GeoJson(), _Broken(), 0.0, tally)
    assert tally == Tally(2, 1)


@pytest.mark.parametrize(
    ("offered", "sent", "words"),
    [
        (0, 0, "no picture was kept"),
        (1, 0, "no picture was kept, 1 was lost"),
        (2, 0, "no picture was kept, 2 were lost"),
        (1, 1, "1 picture kept"),
        (2, 2, "2 pictures kept"),
        (2, 1, "1 of 2 pictures kept; the other one was lost"),
        (3, 1, "1 of 3 pictures kept; the others were lost"),
    ],
)
def test_what_has_become_of_pictures_is_said(offered: int, sent: int, words: str) -> None:
    assert Tally(offered, sent).words(_Kept()) == words


def test_a_variance_below_zero_is_none() -> None:
    covariance = np.diag([-1e-9, 1.0, 4.0, 1.0])
    (output,) = GeoJson().encode(picture(track(1, covariance=covariance)))
    assert json.loads(output.data)["features"][0]["properties"]["east_sigma_m"] == 0.0
