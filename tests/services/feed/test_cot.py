"""Cursor on Target, as a parser of XML reads it."""

from datetime import datetime
from xml.etree import ElementTree as ET

import pytest

from cogradar.services.feed.cot import CursorOnTarget
from cogradar.services.feed.output import Output
from tests.services.feed.made import UTC_S, crowd, picture, track


def events(outputs: list[Output]) -> list[ET.Element]:
    return [ET.fromstring(output.data) for output in outputs]  # noqa: S314 - it is our own text


def _inner(event: ET.Element, path: str) -> dict[str, str]:
    found = event.find(path)
    assert found is not None, path
    return found.attrib


def _s(event: ET.Element, name: str) -> float:
    return datetime.fromisoformat(event.attrib[name]).timestamp()


def test_each_track_is_an_event_of_its_own() -> None:
    made = crowd(300, seed=2)
    found = events(CursorOnTarget(8.0).encode(made))
    assert len(found) == 300
    for event, of in zip(found, made.tracks, strict=True):
        assert event.attrib["uid"] == f"cogradar.r-1.{of.number}"
        assert (event.attrib["type"], event.attrib["how"]) == ("a-u-A", "m-s")
        assert (_s(event, "time"), _s(event, "start"), _s(event, "stale")) == (UTC_S + 1, UTC_S + 1, UTC_S + 9)
        point, moving = _inner(event, "point"), _inner(event, "detail/track")
        assert float(point["lat"]) == pytest.approx(of.latitude, abs=1e-7)
        assert float(point["lon"]) == pytest.approx(of.longitude, abs=1e-7)
        assert (point["hae"], point["le"]) == ("9999999.0", "9999999.0")
        largest = max(of.covariance[0, 0], of.covariance[2, 2])
        assert largest**0.5 - 0.1 <= float(point["ce"]) <= (2.0 * largest) ** 0.5 + 0.1
        assert float(moving["speed"]) == pytest.approx(of.speed, abs=0.01)
        assert float(moving["course"]) == pytest.approx(of.course_deg, abs=0.01)
        assert _inner(event, "detail/contact") == {"callsign": f"T{of.number}"}


def test_a_track_that_ends_is_deleted_once() -> None:
    form = CursorOnTarget(5.0)
    made = [picture(track(1), track(2)), picture(track(2), t=2), picture(track(2), t=3), picture(t=4)]
    told = [[(event.attrib["type"], event) for event in events(form.encode(one))] for one in made]
    assert [[kind for kind, _ in one] for one in told] == [
        ["a-u-A", "a-u-A"],
        ["t-x-d-d", "a-u-A"],
        ["a-u-A"],
        ["t-x-d-d"],
    ]
    deletion = told[1][0][1]
    assert _inner(deletion, "detail/link")["uid"] == "cogradar.r-1.1"
    assert deletion.find("detail/__forcedelete") is not None


def test_tracks_of_another_run_are_others() -> None:
    form = CursorOnTarget(5.0)
    form.encode(picture(track(1)))
    found = events(form.encode(picture(track(1), run="r-2")))
    assert [(event.attrib["type"], event.attrib["uid"]) for event in found] == [
        ("t-x-d-d", "cogradar.r-1.1.drop"),
        ("a-u-A", "cogradar.r-2.1"),
    ]
