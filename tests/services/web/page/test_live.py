"""The page over real processes: a run that goes on, processes that die, and metrics that comes back."""

import re
import threading
import time

import httpx
import pytest
from playwright.sync_api import Route, expect

from cogradar.services.runs import cluster
from cogradar.services.runs.command import command_on
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.web.page.conftest import Live, Open, Watched, dwell_of, inked, until, wait_for_dwell

pytestmark = [pytest.mark.browser, pytest.mark.zenoh]


def test_every_panel_shows_a_run_that_goes_on(live: Live, show: Open) -> None:
    page = show(f"{live.launcher.url}/")  # the newest run, unasked
    expect(page.locator("#connection")).to_have_text("Live")
    wait_for_dwell(page, 1)
    until(page, "location.search.includes('run=newest')")
    first = dwell_of(page)
    wait_for_dwell(page, first + 10)
    page.keyboard.press("2")
    expect(page.locator("#course-title")).to_contain_text("Target 2")
    expect(page.locator("#tracks tbody tr")).to_have_count(2)
    for cell in page.locator("#tracks tbody tr").nth(1).locator("td").all()[1:]:
        expect(cell).to_have_text(re.compile(r"\d"))
    expect(page.locator("#pattern .scatterlayer .trace")).to_have_count(4)
    expect(page.locator("#course .subplot")).to_have_count(5)
    expect(page.locator("#facts")).to_contain_text(re.compile(r"P_D so far[01]\.\d{3} [01]\.\d\d.[01]\.\d\d"))
    expect(page.locator("#now")).to_be_visible()
    assert inked(page) > 0.01
    until(page, "location.search.includes('target=2')")
    assert "dwell=" not in page.url  # it is live


def test_looking_back_and_live_again(live: Live, show: Open) -> None:
    page = show(live.page)
    wait_for_dwell(page, 12)
    page.keyboard.press("Home")
    # In real time the first dwells may never have happened, if the machine had no time for them.
    stored = page.evaluate(f"fetch('/api/v1/runs/{live.run}/dwells?dwells=1:99').then((answer) => answer.json())")
    first = stored["dwells"][0]["t"]
    for _ in range(1, first):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#dwell")).to_have_text(str(first))
    expect(page.locator("#connection")).to_have_text("Live, looking back")
    expect(page.locator("#live")).to_have_attribute("aria-pressed", "false")
    page.get_by_role("button", name="Play").click()
    wait_for_dwell(page, first + 2)
    page.get_by_role("button", name="Live").click()
    expect(page.locator("#connection")).to_have_text("Live")
    shown, newest = "document.querySelector('#dwell').textContent", "document.querySelector('#scrub').ariaValueText"
    until(page, f"Number({shown}) >= Number({newest}.split(' ').pop()) - 3")  # the dwell is drawn a frame later


def test_orders_in_force_are_shown_with_who_asked(live: Live, show: Open) -> None:
    page = show(live.page)
    wait_for_dwell(page, 3)
    expect(page.locator("#orders")).to_be_hidden()
    row = command_on(live.launcher.endpoint, live.run, ["power", "0.9"])
    expect(page.locator("#orders li")).to_have_text(f"power 0.9 since dwell {row['t']}, {row['by']}")
    command_on(live.launcher.endpoint, live.run, ["power", "1"])
    expect(page.locator("#orders")).to_be_hidden()


def test_a_killed_planner_is_seen_and_so_are_its_tracks_that_move(live: Live, show: Open) -> None:
    page = show(f"{live.page}&view=machines")
    rows = page.locator("#processes tbody tr")
    expect(rows).to_have_count(7)
    expect(page.locator("#processes")).not_to_contain_text("gone")
    expect(rows.filter(has_text="emulator-0")).to_contain_text(re.compile(r"\d+\.\d · \d+\.\d"))
    owned = page.locator(".owner li")
    expect(owned).to_have_count(2)
    victim = page.locator(".owner").filter(has=page.locator("li")).first.get_attribute("data-planner")
    assert victim is not None
    other = {"planner-0": "planner-1", "planner-1": "planner-0"}[victim]
    live.kill(victim)
    try:
        expect(page.locator(f".owner.gone[data-planner={victim}]")).to_be_visible()
        expect(page.locator(f".owner[data-planner={other}] li")).to_have_count(2)
        moved = page.locator(f".owner[data-planner={other}] li.moved")
        expect(page.locator("#moves")).to_contain_text(f"{victim} is gone")
        expect(page.locator("#moves")).to_contain_text(re.compile(rf"track \d: {victim} → {other}"))
        expect(moved.first).to_be_visible()
    finally:
        live.mend()
    expect(page.locator("#moves")).to_contain_text(f"{victim} is up")
    expect(rows.filter(has_text=victim)).to_contain_text("up")


def test_a_page_that_is_open_sees_its_run_end(live: Live, show: Open) -> None:
    start = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 2, 100, 10.0)
    cluster.start_on(live.launcher.endpoint, start, notify=lambda _: None, stop=threading.Event())
    page = show(f"{live.launcher.url}/?run={start.run}")
    expect(page.locator("#connection")).to_have_text("Live")
    expect(page.locator("#connection")).to_have_text("Complete")
    assert dwell_of(page) == 100
    strip = page.locator("#strip").bounding_box()
    assert strip is not None
    page.mouse.click(strip["x"] + strip["width"] / 2, strip["y"] + strip["height"] / 2)
    expect(page.locator("#dwell")).to_have_text(re.compile("^5[01]$"))


@pytest.mark.parametrize(
    "is_open", [pytest.param(True, id="open"), pytest.param(False, id="opening", marks=pytest.mark.nightly)]
)
def test_it_comes_back_after_a_restart_of_metrics(live: Live, show: Open, watched: Watched, is_open: bool) -> None:
    held: list[Route] = []

    def hold(route: Route) -> None:
        held.append(route)

    page = show(live.page, before=lambda page: None if is_open else page.route("**/events", hold))
    wait_for_dwell(page, 1)
    expect(page.locator("#connection")).to_have_text("Live" if is_open else "Connecting")
    watched.may_be_refused = True
    live.kill("metrics-0")
    for route in held:  # that stream meets a socket that is there, and nobody who serves on it
        route.continue_()
    page.unroute_all()
    try:
        expect(page.locator("#connection")).to_have_text("Reconnecting")
        expect(page.locator("#notice")).to_contain_text("goes on by itself")
        before = dwell_of(page)
        assert before >= 1  # the last picture stays
    finally:
        live.mend()
    expect(page.locator("#connection")).to_have_text("Live", timeout=40_000)
    expect(page.locator("#notice")).to_be_hidden()
    wait_for_dwell(page, before + 5)
    deadline = time.monotonic() + 20.0  # a stream that goes on where it broke off stays behind
    while dwell_of(page) < httpx.get(f"{live.launcher.url}/api/v1/runs/{live.run}").json()["t"] - 3:
        assert time.monotonic() < deadline
        page.wait_for_timeout(200)
