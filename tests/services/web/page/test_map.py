"""The scope with north up: what is drawn where it is on the earth, and lines of latitude and longitude."""

import re
from math import cos, radians, sin
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from cogradar.services.skies.place import Place
from cogradar.shared.scenario.scenario import SiteSection
from tests.services.web.conftest import SITE
from tests.services.web.page.conftest import Open, inked, until

pytestmark = pytest.mark.browser
PLACE = Place.of(SiteSection.model_validate(SITE))
NORTHWARD = Place(PLACE.latitude, PLACE.longitude, 0.0)  # its x is north, its y is east


def _pointed(page: Page, x: float, y: float) -> tuple[float, float]:
    """East and north of the radar that the page says of a point of the scope, km."""
    box = page.locator("#scope").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + x, box["y"] + y)
    found = re.match(r"([\d.]+) km, ([\d.]+)", page.locator("#pointer").inner_text())
    assert found is not None
    distance, bearing = float(found[1]), radians(float(found[2]))
    return distance * sin(bearing), distance * cos(bearing)


def _inside(page: Page) -> list[tuple[float, float]]:
    """Points of the scope that lie before the radar."""
    box = page.locator("#scope").bounding_box()
    assert box is not None
    found = []
    for x in np.linspace(40, box["width"] - 40, 12).tolist():
        for y in np.linspace(40, box["height"] - 40, 8).tolist():
            page.mouse.move(5, 5)
            page.mouse.move(box["x"] + x, box["y"] + y)
            if page.locator("#pointer").inner_text():
                found.append((x, y))
    return found


def _tracks(page: Page, t: int) -> Any:
    address = f"/api/v1/runs/sited/dwells?dwells={t}:{t}"
    return page.evaluate(f"fetch('{address}').then((answer) => answer.json())")["dwells"][0]["tracks"]


def test_a_track_is_drawn_where_it_is_on_the_earth(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=sited&dwell=8")
    expect(page.locator("#dwell")).to_have_text("8")
    page.get_by_role("button", name="North up").click()
    until(page, "location.search.includes('north=1')")
    points = _inside(page)
    said = np.array([_pointed(page, *point) for point in points])
    # From px to km: one scale, north up, east to the right.
    (across, _, x0), (_, up, y0) = (
        np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), said[:, i], rcond=None)[0] for i in (0, 1)
    )
    assert across == pytest.approx(-up, rel=0.02)
    fitted = np.column_stack([across * np.array(points)[:, 0] + x0, up * np.array(points)[:, 1] + y0])
    assert np.abs(fitted - said).max() < 0.3
    box = page.locator("#scope").bounding_box()
    assert box is not None
    for one in _tracks(page, 8):
        north, east = NORTHWARD.seen(one["latitude_hat_deg"], one["longitude_hat_deg"])
        page.mouse.click(box["x"] + (east - x0) / across, box["y"] + (north - y0) / up)
        expect(page.locator("#course-title")).to_contain_text(f"Track {one['track']}")


def test_lines_of_latitude_and_longitude_are_where_they_are(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=sited&dwell=8")
    expect(page.locator("#dwell")).to_have_text("8")
    before = inked(page)
    page.keyboard.press("n")
    expect(page.get_by_role("button", name="North up")).to_have_attribute("aria-pressed", "true")
    until(page, "location.search.includes('north=1')")
    assert inked(page) != before
    places = [(PLACE.latitude + dy, PLACE.longitude + dx) for dy in (-2.0, 0.0, 1.5) for dx in (-3.0, 0.5, 2.0)]
    site = {"latitude_deg": PLACE.latitude, "longitude_deg": PLACE.longitude}
    said = page.evaluate(
        "([site, places]) => import('/page/graticule.js').then(({ seen }) => places.map((one) => seen(site, ...one)))",
        [site, places],
    )
    expected = [NORTHWARD.seen(*place)[::-1] for place in places]
    assert np.array(said) == pytest.approx(np.array(expected), abs=0.1)


def test_airports_and_borders_are_on_the_map_if_there_are_data(unknown: str, show: Open) -> None:
    """The site is near Munich: its airport is 60 km away, and borders cross the map."""

    def without(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"surroundings": None})

    address = f"{unknown}/?run=sited&dwell=8&north=1"
    bare = show(address, before=lambda page: page.route("**/radar", without))
    page = show(address)
    for one in (page, bare):
        expect(one.locator("#dwell")).to_have_text("8")
        expect(one.locator("#legend")).to_contain_text("detected cell")
    expect(page.locator("#legend")).to_contain_text("airport")
    expect(page.locator("#legend")).to_contain_text("coast, border")
    expect(bare.locator("#legend")).not_to_contain_text("airport")
    assert inked(page) > inked(bare)
    page.keyboard.press("n")  # the scope by itself is no map
    until(page, "!location.search.includes('north=1')")


def test_without_a_site_north_is_not_known(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=by-hand&dwell=8&north=1")
    expect(page.locator("#dwell")).to_have_text("8")
    expect(page.get_by_role("button", name="North up")).to_be_hidden()
    expect(page.locator("#scope")).to_have_attribute("aria-label", re.compile("Scope"))
