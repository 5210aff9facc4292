"""The table of all tracks: sorted, filtered, saved; and what the scope says under the pointer."""

import csv
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.services.web.page.conftest import Open, until, wait_for_dwell

pytestmark = pytest.mark.browser


def _column(page: Page, head: str) -> list[float]:
    """Numbers of a column, top down."""
    heads = [text.split("\n")[0] for text in page.locator("#track-list thead th").all_inner_texts()]
    cells = page.locator(f"#track-list tbody tr td:nth-child({heads.index(head) + 1})").all_inner_texts()
    return [float(text.strip().replace("\N{MINUS SIGN}", "-")) for text in cells]


def test_tracks_are_sorted_and_filtered(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=hundred&dwell=60&view=list")
    rows, caption = page.locator("#track-list tbody tr"), page.locator("#list-caption")
    expect(rows).to_have_count(100)
    expect(caption).to_have_text("dwell 60: 100 targets")
    page.get_by_role("button", name="Range", exact=True).click()
    expect(page.locator("#track-list th[aria-sort=ascending]")).to_have_text(re.compile("^Range"))
    ranges = _column(page, "Range")
    assert ranges == sorted(ranges)
    assert len(set(ranges)) > 50
    page.get_by_role("button", name="Range", exact=True).click()
    expect(page.locator("#track-list th[aria-sort=descending]")).to_have_count(1)
    assert _column(page, "Range") == ranges[::-1]
    page.get_by_role("searchbox", name="Filter").fill("range<40.5 bearing>0")
    expect(caption).to_have_text(re.compile(r"^dwell 60: \d\d? of 100 targets$"))
    assert 0 < len(_column(page, "Range")) < 50
    assert max(_column(page, "Range")) < 40.5
    assert min(_column(page, "Bearing")) > 0.0
    page.get_by_role("searchbox", name="Filter").fill("rnge<40")
    expect(caption).to_have_text(re.compile("^no column rnge: track, state, age_s, range_km, "))
    page.get_by_role("searchbox", name="Filter").fill("no such state")
    expect(rows).to_have_count(0)
    expect(page.get_by_role("button", name="CSV")).to_be_disabled()
    expect(page.locator("#list-none")).to_contain_text("No target matches “no such state”.")
    page.get_by_role("button", name="Clear the filter").click()
    expect(rows).to_have_count(100)
    expect(page.locator("#list-none")).to_be_empty()
    expect(page.get_by_role("searchbox", name="Filter")).to_be_focused()


def test_what_is_shown_is_saved_with_full_numbers(unknown: str, show: Open, tmp_path: Path) -> None:
    page = show(f"{unknown}/?run=by-hand&dwell=8&view=list")
    expect(page.locator("#track-list tbody tr")).to_have_count(2)
    page.get_by_role("searchbox", name="Filter").fill("3")
    expect(page.locator("#track-list tbody tr")).to_have_count(1)
    with page.expect_download() as download:
        page.get_by_role("button", name="CSV").click()
    assert download.value.suggested_filename == "by-hand-dwell-8-tracks.csv"
    download.value.save_as(tmp_path / "tracks.csv")
    with (tmp_path / "tracks.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["track"] == "3"
    expect(page.locator("#track-list th", has_text="Age")).to_contain_text("s radar time")
    expect(page.locator("#track-list th", has_text="Last seen")).to_contain_text("s radar time ago")
    assert row["existence"] == "0.9"
    assert {"age_s", "range_km", "bearing_deg", "speed_m_s", "heading_deg", "seen_s", "error_km"} <= row.keys()
    assert "latitude_deg" not in row  # there is no [site]


def test_a_row_chooses_its_track(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=50&view=list")
    page.locator("#track-list tbody tr").nth(1).click()
    until(page, "location.search.includes('target=2')")
    page.keyboard.press("g")
    expect(page.locator("#course-title")).to_contain_text("Target 2")
    page.keyboard.press("t")
    expect(page.locator("#track-list tr.chosen")).to_have_attribute("data-target", "2")


def test_without_truth_no_column_is_empty(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=blind&dwell=60")
    expect(page.locator("#dwell")).to_have_text("60")
    expect(page.locator("#tracks th", has_text="Error")).to_be_hidden()
    page.keyboard.press("t")
    expect(page.locator("#track-list tbody tr").first).to_be_visible()
    expect(page.locator("#track-list th", has_text="Error")).to_have_count(0)


def test_the_pointer_says_where_it_is_and_what_flies_there(stored: str, show: Open, tmp_path: Path) -> None:
    page = show(f"{stored}/?run=wandering&dwell=50&target=1")
    expect(page.locator("#dwell")).to_have_text("50")
    box = page.locator("#scope").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 60)
    expect(page.locator("#pointer")).to_have_text(re.compile(r"^\d+\.\d km, \W?0\.\d°"))
    page.mouse.move(5, 5)
    expect(page.locator("#pointer")).to_have_text("")
    page.keyboard.press("+")  # the chosen one is in the middle then
    expect(page.locator("#zoom")).to_have_text(re.compile("^2"))
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    expect(page.locator("#pointer")).to_have_text(re.compile(r"km, .*°; 1: \d+ m/s, heading \W?\d+°$"))
    with page.expect_download() as download:
        page.get_by_role("button", name="PNG").click()
    download.value.save_as(tmp_path / "scope.png")
    assert (tmp_path / "scope.png").read_bytes().startswith(b"\x89PNG")


def test_the_scope_is_filmed_while_it_plays(stored: str, show: Open, tmp_path: Path) -> None:
    page = show(f"{stored}/?run=wandering&dwell=50&speed=10")
    expect(page.locator("#dwell")).to_have_text("50")
    film = page.get_by_role("button", name="Film")
    film.click()
    expect(film).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="Play").click()
    wait_for_dwell(page, 60)
    with page.expect_download() as download:
        film.click()
    expect(film).to_have_attribute("aria-pressed", "false")
    assert download.value.suggested_filename == "wandering-from-50.webm"
    download.value.save_as(tmp_path / "film.webm")
    data = (tmp_path / "film.webm").read_bytes()
    assert data.startswith(b"\x1aE\xdf\xa3")  # EBML
    assert len(data) > 10_000  # of more than one picture
