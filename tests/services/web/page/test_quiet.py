"""The page over runs of which nothing more comes: what it shows at once, of a search, and while it hears nothing."""

import re
from collections.abc import Callable
from functools import partial

import httpx
import pytest
from playwright.sync_api import Page, Route, expect

from cogradar.services.web import events
from tests.services.web.page.conftest import BEGUN, Open, Watched, inked, until, wait_for_dwell

pytestmark = pytest.mark.browser
LIVE = re.compile("^Live(, no new dwell)?$")  # the runs here stand still


def _asked(page: Page, what: str) -> list[str]:
    """What the page asks for from now on, of such addresses."""
    found: list[str] = []
    page.on("request", lambda request: found.append(request.url) if what in request.url else None)
    return found


def test_a_live_run_that_stands_still_is_shown_at_once(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?run=begun")
    expect(page.locator("#connection")).to_have_text("Live")
    expect(page.locator("#dwell")).to_have_text(str(BEGUN - 1))
    expect(page.locator("#live")).to_have_attribute("aria-pressed", "true")
    assert inked(page) > 0.01


def test_a_search_is_told_and_shows_nothing_of_the_run_before(searching: str, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True  # no router is there, whose processes have certificates
    page = show(f"{searching}/?run=over&target=1")
    expect(page.locator("#pattern .scatterlayer .trace")).to_have_count(4)
    expect(page.locator("#course .subplot")).to_have_count(5)
    expect(page.locator("#facts")).to_contain_text("floor (of the rms)")
    expect(page.locator("#notice")).to_contain_text("A run has begun: searching.")
    page.get_by_role("button", name="Watch it").click()
    expect(page.locator("#empty")).to_contain_text("tracks confirmed after")
    expect(page.locator("#notice")).to_be_hidden()
    expect(page.locator("#connection")).to_have_text("Live")
    expect(page.locator("#dwell")).not_to_have_text(re.compile(r"\d"))
    page.wait_for_timeout(1500)  # for an answer that is late
    expect(page.locator("#pattern .trace")).to_have_count(0)
    expect(page.locator("#course .subplot")).to_have_count(0)
    expect(page.locator("#facts > *")).to_have_count(0)
    expect(page.locator("#tracks tbody tr")).to_have_count(0)


def test_silence_ends_a_stream_and_a_ping_is_none(quiet: str, show: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "PING_S", 0.1)
    page = show(f"{quiet}/?run=over")
    page.clock.install()
    streams = _asked(page, "/events")
    page.goto(f"{quiet}/?run=begun")
    expect(page.locator("#connection")).to_have_text(LIVE)
    for _ in range(4):
        page.clock.run_for(8000)
        page.wait_for_timeout(1000)  # for a ping, which the page must read meanwhile
    expect(page.locator("#connection")).to_have_text(LIVE)
    assert len(streams) == 1
    monkeypatch.setattr(events, "PING_S", 1000.0)
    page.wait_for_timeout(500)
    page.clock.run_for(10_100)
    expect(page.locator("#connection")).to_have_text("Reconnecting")
    page.clock.run_for(2000)
    expect(page.locator("#connection")).to_have_text(LIVE)
    assert len(streams) == 2


def test_a_stream_that_does_not_open_is_not_live(quiet: str, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True
    page = show(f"{quiet}/?run=over")
    page.clock.install()
    page.route("**/events", lambda _: None)  # neither an answer nor an error, as of a service that is being restarted
    streams = _asked(page, "/events")
    page.goto(f"{quiet}/?run=begun")
    expect(page.locator("#dwell")).to_have_text(str(BEGUN - 1))  # which was asked for
    expect(page.locator("#connection")).to_have_text("Connecting")
    page.clock.run_for(10_100)
    expect(page.locator("#connection")).to_have_text("Reconnecting")
    expect(page.locator("#notice")).to_contain_text("goes on by itself")
    page.unroute_all()
    page.clock.run_for(2000)
    expect(page.locator("#connection")).to_have_text(LIVE)
    expect(page.locator("#notice")).not_to_contain_text("goes on by itself")
    assert len(streams) == 2


def test_a_hidden_page_has_no_stream(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?run=begun")
    expect(page.locator("#dwell")).to_have_text(str(BEGUN - 1))
    streams = _asked(page, "/events")
    ended: list[str] = []
    for event in ("requestfailed", "requestfinished"):
        page.on(event, lambda request: ended.append(request.url))
    for is_hidden in ("true", "false"):
        page.evaluate(f"Object.defineProperty(document, 'hidden', {{ value: {is_hidden}, configurable: true }})")
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        page.wait_for_timeout(500)
        assert len(streams) == (0 if is_hidden == "true" else 1)
        assert any(url.endswith("/events") for url in ended)
        expect(page.locator("#connection")).to_have_text("Connecting" if is_hidden == "true" else LIVE)


def test_a_role_that_nobody_plays_has_a_row_of_its_own(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?view=machines&run=begun")
    rows = page.locator("#processes tbody tr")
    expect(rows.filter(has_text="no planner")).to_have_count(1)
    expect(rows.filter(has_text="no allocator")).to_have_count(1)


def test_what_is_kept_is_around_what_is_shown(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?run=over")
    wait_for_dwell(page, 1)
    kept = page.evaluate(
        """import('/page/dwells.js').then(({ Dwells, TRAIL }) => {
          const dwells = new Dwells('over', 2);
          for (let t = 1; t <= 100; t += 1) dwells.put({ t });
          dwells.at = 60;
          for (let t = 101; t <= 3000; t += 1) dwells.put({ t });
          return [dwells.before(60).length === TRAIL, dwells.get(3000) !== null, dwells.kept.size];
        })"""
    )
    assert kept == [True, True, 2000]


def test_false_alarms_and_particles_are_drawn(quiet: str, show: Open) -> None:
    told = httpx.get(f"{quiet}/api/v1/runs/over/dwells?dwells=1:60").json()["dwells"]
    with_alarm = next(one["t"] for one in told if one["false_alarms"])
    without = next(one["t"] for one in told if not one["false_alarms"])
    shares = {}
    for dwell in (with_alarm, without):
        page = show(f"{quiet}/?run=over&dwell={dwell}&target=1")
        expect(page.locator("#dwell")).to_have_text(str(dwell))
        warn = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--warn')")
        shares[dwell] = inked(page, warn)
    assert shares[with_alarm] > shares[without] == 0.0
    expect(page.locator("#notice")).to_be_visible()  # it takes room from the scope
    page.wait_for_timeout(500)
    picture = "document.getElementById('scope').toDataURL()"
    page.evaluate(f"window.bare = {picture}")
    page.get_by_role("button", name="Particles").click()
    until(page, f"{picture} !== window.bare")
    page.get_by_role("button", name="Particles").click()
    until(page, f"{picture} === window.bare")


def test_a_run_that_stands_still_says_who_is_missing(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?run=begun")
    expect(page.locator("#dwell")).to_have_text(str(BEGUN - 1))
    missing = "No planner: tracks are not updated; No allocator: waveforms are not updated."
    expect(page.locator("#notice")).to_have_text(missing)
    expect(page.locator("#notice")).to_have_text(re.compile(r"^No new dwell for \d+ s: no planner, no allocator\.$"))
    page.keyboard.press("ArrowLeft")  # who looks back is not alarmed
    expect(page.locator("#notice")).to_be_hidden()


def test_a_role_without_a_process_is_said_before_anything_else_is_wrong(quiet: str, show: Open) -> None:
    nobody = _planner("", alive=False, answers=False, began_utc_s=None) | {"role": "allocator"}
    page = show(f"{quiet}/?run=begun", before=partial(_with_processes, processes=[_planner(), nobody], rate_hz=0.2))
    expect(page.locator("#notice")).to_have_text("No allocator: waveforms are not updated.")


def test_a_planner_that_is_restarted_between_two_looks_is_listed_and_starting(quiet: str, show: Open) -> None:
    rows = [_planner()]

    def answered(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(
            response=answer, json=answer.json() | {"processes": rows, "owners": {"begun": {"1": "planner-0"}}}
        )

    page = show(f"{quiet}/?view=machines&run=begun", before=lambda page: page.route("**/processes", answered))
    row, owner = page.locator("#processes tbody tr"), page.locator(".owner h3")
    expect(row).to_contain_text("● up")
    for rows[0] in (_planner(answers=False, began_utc_s=None), _planner(began_utc_s=1995.0, starting=True)):
        expect(row).to_contain_text("starting" if rows[0]["answers"] else "too busy")
    expect(owner).to_have_text("planner-0: starting")
    expect(page.locator("#moves li")).to_have_text(re.compile("planner-0 was restarted$"))
    rows[0] = _planner(began_utc_s=1995.0)
    expect(row).to_contain_text("● up")
    expect(owner).to_have_text("planner-0")
    expect(page.locator("#moves li")).to_have_count(1)


def _planner(name: str = "planner-0", **more: object) -> dict[str, object]:
    """A row of a planner that has been up for long."""
    usual = {"alive": True, "answers": True, "began_utc_s": 1000.0, "starting": False}
    return {"role": "planner", "name": name, "front_end_p99_ms": None} | usual | more


def _with_processes(
    page: Page,
    processes: list[dict[str, object]],
    change: Callable[[Route], None] = lambda route: route.continue_(),
    rate_hz: float = 5.0,
) -> None:
    """A run on these processes, of five dwells a second, or of another rate where none is to be due."""

    def answered(route: Route) -> None:
        answer = route.fetch()
        document = answer.json()
        document.update({"rate_hz": rate_hz} if "rate_hz" in document else {})
        document.update({"processes": processes, "utc_s": 2000.0} if "processes" in document else {})
        route.fulfill(response=answer, json=document)

    page.route("**/dwells?*", change)
    page.route("**/radar", answered)
    page.route("**/processes", answered)


def test_no_beampattern_is_asked_for_where_the_waveform_is_not_stored(quiet: str, show: Open) -> None:
    def without(route: Route) -> None:
        answer = route.fetch()
        document = answer.json()
        for dwell in document["dwells"]:
            dwell["isotropic"] = None
        route.fulfill(response=answer, json=document)

    asked = list[str]()

    def begin(page: Page) -> None:
        page.on("request", lambda request: asked.append(request.url))
        page.route("**/dwells?*", without)

    page = show(f"{quiet}/?run=over", before=begin)
    expect(page.locator("#pattern")).to_have_text("No beampattern: the waveform of this dwell is not stored.")
    assert any("/dwells?" in url for url in asked)
    assert [url for url in asked if "beampattern" in url] == []


def test_dwells_that_are_due_and_do_not_come_are_said_within_seconds(quiet: str, show: Open) -> None:
    """Five dwells a second: there is none for two seconds."""
    frozen = _planner("emulator-0", answers=False, began_utc_s=None) | {"role": "emulator"}
    page = show(f"{quiet}/?run=begun", before=partial(_with_processes, processes=[frozen, _planner()]))
    expect(page.locator("#notice")).to_have_text(re.compile("^No new dwell for [2-5] s: emulator-0 does not answer.$"))
    expect(page.locator("#connection")).to_have_text("Live, no new dwell")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#connection")).to_have_text("Live, looking back")


def test_late_plans_and_blind_cells_are_said(quiet: str, show: Open) -> None:
    def change(route: Route) -> None:
        answer = route.fetch()
        document = answer.json()
        for dwell in document["dwells"]:
            for target in dwell["targets"]:
                target["late"] = dwell["t"] % 2 == 0
            dwell["stale"] = dwell["t"] % 2 == 0
            dwell["cells"]["blind"] = [True] + [False] * 9
            dwell["cells"]["unmeasured"] = dwell["cells"]["bin"]
        route.fulfill(response=answer, json=document)

    page = show(f"{quiet}/?run=begun", before=lambda page: page.route("**/dwells?*", change))
    expect(page.locator("#notice")).to_have_text(
        re.compile(
            "% of the plans are late; (4[0-9]|50) % of the waveforms are stale; "
            "10 % of the cells are blind; (4[89]|50) % of the looks are not measured"
        )
    )
    expect(page.locator("#legend")).to_contain_text("blind cell")
    expect(page.locator("#legend")).to_contain_text("cell not measured")
    emulator = _planner("emulator-0") | {"role": "emulator", "front_end_p99_ms": 3854.0}
    late = "% of the plans are late"
    for rows, why in (
        ([emulator, _planner()], f"{late}, for the front end takes up to 3854 ms of a dwell of 5000 ms; "),
        (
            [emulator | {"front_end_p99_ms": 8.0}, _planner()],
            f"{late}: the planners are slow (the front end takes up to 8 ms of a dwell of 5000 ms); ",
        ),
        ([emulator, _planner(answers=False, began_utc_s=None)], f"{late}: planner-0 does not answer; "),
        ([emulator, _planner(), _planner("planner-1", began_utc_s=1995.0)], f"{late}: planner-1 was started 5 s ago; "),
        ([emulator, _planner(starting=True)], f"{late}: planner-0 was started 1000 s ago; "),
    ):
        told = show(f"{quiet}/?run=begun", before=partial(_with_processes, processes=rows, change=change, rate_hz=0.2))
        expect(told.locator("#notice")).to_contain_text(why)
    nobody = _planner("", alive=False, answers=False, began_utc_s=None)
    told = show(
        f"{quiet}/?run=begun", before=partial(_with_processes, processes=[emulator, nobody], change=change, rate_hz=0.2)
    )
    expect(told.locator("#notice")).to_have_text(
        re.compile(
            r"^No planner: tracks are not updated; \d+ % of the plans are late; \d+ % of the waveforms are stale; 10 %"
        )
    )
    as_it_is = show(f"{quiet}/?run=begun")
    expect(as_it_is.locator("#dwell")).to_have_text(str(BEGUN - 1))
    expect(as_it_is.locator("#legend")).to_contain_text("false alarm")
    expect(as_it_is.locator("#legend")).not_to_contain_text("cell not measured")
