"""The page over runs that are over: links, the timeline, keys, loss and re-acquisition, runs without truth."""

import re
import time
from datetime import datetime
from itertools import pairwise

import pytest
from playwright.sync_api import Page, Route, expect

from cogradar.shared.scenario.files import load
from tests.services.web.page.conftest import WITHIN_MS, Open, Watched, dwell_of, inked, until, wait_for_dwell
from tests.services.web.page.scenes import HUNDRED_DWELLS, WANDERING_DWELLS

pytestmark = pytest.mark.browser


def _table(page: Page) -> str:
    return page.locator("#tracks tbody").inner_text()


def test_a_link_shows_what_it_was_taken_from(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=75&target=2&zoom=4")
    expect(page.locator("#dwell")).to_have_text("75")
    expect(page.locator("#zoom")).to_have_text(re.compile("^4"))
    expect(page.locator("#course-title")).to_contain_text("Target 2")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("1")
    expect(page.locator("#course-title")).to_contain_text("Target 1")
    until(page, "location.search.includes('dwell=86') && location.search.includes('target=1')")
    copy = show(page.url)
    expect(copy.locator("#dwell")).to_have_text("86")
    expect(copy.locator("#tracks tbody tr.chosen th")).to_have_text("1")
    assert _table(copy) == _table(page)


def test_the_browsers_back_button_undoes_a_choice_of_view(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=20")
    expect(page.locator("#dwell")).to_have_text("20")
    page.get_by_role("link", name="Runs").click()
    page.get_by_role("link", name="hundred").click()
    expect(page.locator("#heading")).to_contain_text("hundred")
    page.go_back()
    expect(page.locator("#run-table")).to_be_visible()
    page.go_back()
    expect(page.locator("#heading")).to_contain_text("smoke")
    expect(page.locator("#dwell")).to_have_text("20")


@pytest.mark.parametrize("width", [1280, 400])
def test_a_beampattern_of_many_beams_has_the_highest_power_of_each_column_of_pixels(
    stored: str, show: Open, width: int
) -> None:
    page = show(f"{stored}/?run=hundred&dwell=12", width)
    with page.expect_response(re.compile("beampattern")) as answer:
        page.reload()
    until(page, "document.getElementById('pattern').data?.length > 4")
    told = answer.value.json()
    angles, powers, length = page.evaluate(
        "(({ data: [, one], _fullLayout }) => [one.x, one.y, _fullLayout.xaxis._length])"
        "(document.getElementById('pattern'))"
    )
    highest = dict[int, float]()
    for angle, power in zip(told["angle_deg"], told["power_db"], strict=True):
        column = int((angle + 90) / 180 * length)
        highest[column] = max(power, highest.get(column, power))
    assert [int((angle + 90) / 180 * length) for angle in angles] == list(highest)
    assert powers == list(highest.values())
    assert len(angles) < len(told["angle_deg"]) / 2


def test_the_timeline_scrubs_plays_and_stops_at_the_end(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering")
    expect(page.locator("#dwell")).to_have_text(str(WANDERING_DWELLS))  # where it ended
    scrub = page.get_by_role("slider", name="Dwell")
    scrub.fill("17")
    expect(page.locator("#dwell")).to_have_text("17")
    box = scrub.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    until(page, "Math.abs(Number(document.getElementById('dwell').textContent) - 95) < 4")
    scrub.fill("150")
    page.get_by_label("Speed").select_option("2")
    page.get_by_role("button", name="Play").click()
    wait_for_dwell(page, 152)
    page.get_by_role("button", name="Freeze").click()
    paused = dwell_of(page)
    assert 152 <= paused < WANDERING_DWELLS
    page.wait_for_timeout(400)
    assert dwell_of(page) == paused
    page.get_by_label("Speed").select_option("20")
    page.keyboard.press(" ")
    expect(page.locator("#dwell")).to_have_text(str(WANDERING_DWELLS))
    expect(page.get_by_role("button", name="Play")).to_be_visible()


def test_loss_and_re_acquisition_cannot_be_missed(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=80&target=2")
    expect(page.locator("#dwell")).to_have_text("80")
    alarm = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--alarm')")
    assert inked(page, alarm) == 0.0
    page.get_by_label("Speed").select_option("20")
    page.keyboard.press(" ")
    events = page.get_by_role("log", name="Tracks lost and found again")
    expect(events).to_contain_text("target 2 lost")
    expect(events).to_contain_text("target 2 found again")
    at = re.search(r"Dwell (\d+): target 2 lost", events.inner_text())
    assert at is not None
    expect(page.get_by_role("button", name="Play")).to_be_visible()  # it is over
    page.get_by_role("slider", name="Dwell").fill(str(int(at[1]) + 5))
    expect(page.locator("#tracks tr[data-state=lost] td").first).to_have_text("LOST")
    until(page, "document.getElementById('scope').ariaLabel.includes('lost: 2')")
    assert inked(page, alarm) > 0.0005


def test_the_time_of_a_dwell_is_the_radars_and_utc_where_it_is_known(stored: str, unknown: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=75")
    expect(page.locator("#clock")).to_have_text("75 s radar time")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#clock")).to_have_text("76 s radar time")
    sited = show(f"{unknown}/?run=sited&dwell=8")
    expect(sited.locator("#clock")).to_have_text("8 s radar time\n2026-01-01 00:00:08 UTC")


def test_a_run_without_truth_shows_what_it_can(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=blind&dwell=60&target=1")
    expect(page.locator("#tracks-caption")).to_contain_text("no truth")
    row = page.locator("#tracks tbody tr").first.locator("td")
    expect(row.nth(1)).to_have_text(re.compile(r"\d"))  # share
    expect(row.nth(4)).not_to_have_text(re.compile(r"\d"))  # error
    expect(page.locator("#course .subplot")).to_have_count(5)
    assert inked(page) > 0.01


def test_runs_are_found_by_words(stored: str, show: Open) -> None:
    page = show(f"{stored}/?view=runs")
    rows = page.locator("#run-table tbody tr")
    expect(rows).to_have_count(3)
    page.get_by_role("searchbox", name="Find").fill("uniform blin")
    expect(rows).to_have_count(1)
    page.get_by_role("searchbox", name="Find").fill("nothing like it")
    expect(page.locator("#runs-none")).to_contain_text(re.compile("^No run matches “.+”\\."))
    page.get_by_role("button", name="Clear the filter").click()
    expect(page.locator("#run-table tbody tr")).to_have_count(3)


def test_runs_say_when_they_began_how_long_they_are_and_how_they_ended(quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?view=runs")
    over = page.locator("#run-table tr[data-run=over] td")
    expect(over.nth(0)).to_have_text("complete")
    expect(over.nth(1)).to_have_text(re.compile(r"\d\d:\d\d"))
    row = page.evaluate("fetch('/api/v1/runs/over').then((answer) => answer.json())")
    expect(over.nth(2)).to_have_text(f"{int(row['length_s']) // 60:02}:{round(row['length_s']) % 60:02}")
    assert row["length_s"] == pytest.approx(row["t"] * load("smoke").radar.motion.dt_s)
    assert abs(time.time() - datetime.fromisoformat(row["began"]).timestamp()) < 600.0
    expect(page.locator("#run-table tr[data-run=begun] td").nth(0)).to_have_text("live")


def test_a_second_run_is_drawn_beside_the_first(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&view=runs")
    expect(page.get_by_role("button", name="Compare with wandering")).to_be_disabled()
    other = page.get_by_role("button", name="Compare with hundred")
    other.press("Enter")
    expect(other).to_have_attribute("aria-pressed", "true")
    chart = page.locator("#compare")
    expect(chart.locator(".subplot")).to_have_count(2)
    expect(chart.locator(".scatterlayer .trace")).to_have_count(4)
    expect(chart).to_have_attribute(
        "aria-label", re.compile(r"wandering: Detected % [\d.]+, Error km [\d.]+\. hundred: Det")
    )
    until(page, "location.search.includes('beside=hundred')")
    expect(page.locator("#compare-first")).to_have_text("wandering: uniform, seed 4")
    expect(page.locator("#compare-second")).to_have_text("hundred: power-aware, seed 1")
    page.get_by_role("button", name="Close").click()
    expect(chart).to_be_hidden()
    until(page, "!location.search.includes('beside')")


def test_names_of_what_is_compared_are_whole_beside_three_charts(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=sited&view=runs&beside=by-hand")
    titles = page.locator("#compare .g-ytitle, #compare .g-y2title, #compare .g-y3title")
    expect(titles).to_have_count(3)
    frame = page.locator("#compare").bounding_box()
    boxes = sorted((box for i in range(3) if (box := titles.nth(i).bounding_box())), key=lambda box: box["y"])
    assert frame is not None
    assert boxes[0]["y"] >= frame["y"]
    assert all(one["y"] + one["height"] < other["y"] for one, other in pairwise(boxes))


@pytest.mark.parametrize("view", ["radar", "list", "runs"])
def test_a_table_that_is_wider_than_the_screen_says_that_it_goes_on(view: str, stored: str, show: Open) -> None:
    address = f"{stored}/?run=hundred&dwell=30&view={view}"
    page = show(address, width=400)
    said = page.locator(f"#{view} .goes-on")
    place = said.locator("xpath=following-sibling::*[1]")
    expect(place.locator("tbody tr").first).to_be_visible()  # its head alone is narrower, and ends earlier
    expect(said).to_have_text("more columns →")
    expect(place).to_have_attribute("data-goes-on", "right")
    assert "gradient" in place.evaluate("(node) => getComputedStyle(node).maskImage")
    place.evaluate("(node) => node.scrollTo({ left: 30 })")
    place.evaluate("(node) => node.scrollTo({ left: node.scrollWidth })")
    expect(said).to_have_text("← more columns")
    expect(place).to_have_attribute("data-goes-on", "left")
    expect(show(address).locator(f"#{view} .goes-on")).to_be_hidden()


def test_a_run_whose_last_dwell_takes_long_shows_its_first_one_meanwhile(stored: str, show: Open) -> None:
    held, last = list[Route](), WANDERING_DWELLS

    def hold(route: Route) -> None:
        held.append(route)

    address = f"**/dwells?dwells={last}:{last}"
    page = show(f"{stored}/?run=wandering", before=lambda page: page.route(address, hold))
    expect(page.locator("#dwell")).to_have_text("1")
    expect(page.locator("#notice")).to_contain_text(f"Dwell {last} is on its way")
    assert inked(page) > 0.01
    held[0].continue_()
    expect(page.locator("#dwell")).to_have_text(str(last))
    expect(page.locator("#notice")).to_be_hidden()


def test_what_is_not_there_says_what_to_do(stored: str, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True  # there are no processes behind a store alone
    gone = show(f"{stored}/?run=gone")
    expect(gone.locator("#empty")).to_have_text("There is no run gone here. Choose one under Runs.")
    bad = show(f"{stored}/?run=no%20name")
    expect(bad.locator("#empty")).to_contain_text("run")
    expect(bad.locator("#connection")).to_have_text("No run")
    page = show(f"{stored}/?view=machines&run=wandering")
    expect(page.locator("#machines-caption")).to_contain_text("cogradar run")


def test_keys_reach_everything_and_the_help_lists_them(stored: str, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True  # as above
    page = show(f"{stored}/?run=wandering&dwell=50")
    expect(page.locator("#dwell")).to_have_text("50")
    page.keyboard.press("Tab")
    expect(page.locator(".skip")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#timeline")).to_be_focused()
    page.keyboard.press("j")
    expect(page.locator("#tracks tr.chosen")).to_have_attribute("data-target", "1")
    page.keyboard.press("j")
    expect(page.locator("#tracks tr.chosen")).to_have_attribute("data-target", "2")
    page.keyboard.press("+")
    expect(page.locator("#zoom")).to_have_text(re.compile("^2"))
    page.keyboard.press("p")
    expect(page.locator("#particles")).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("Escape")
    expect(page.locator("#course-title")).to_have_text("Choose a target")
    page.keyboard.press("d")
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keys")).to_be_hidden()
    page.keyboard.press("?")
    page.get_by_label("Keys of one letter, digit or sign act").uncheck()
    page.keyboard.press("Escape")
    page.keyboard.press("d")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#dwell")).to_have_text("51")
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    until(page, "location.search.includes('dwell=51')")
    page.reload()
    expect(page.locator("#dwell")).to_have_text("51")
    page.keyboard.press("r")
    expect(page.locator("#run-table")).to_be_hidden()
    page.get_by_role("button", name="?").click()
    page.get_by_label("Keys of one letter, digit or sign act").check()
    page.keyboard.press("Escape")
    for key, view in (("r", "#run-table"), ("m", "#processes"), ("g", "#scope")):
        page.keyboard.press(key)
        expect(page.locator(view)).to_be_visible()


def test_the_end_of_a_stored_run_is_all_of_its_last_dwell(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=100")
    expect(page.locator("#dwell")).to_have_text("100")
    page.keyboard.press("End")
    expect(page.locator("#dwell")).to_have_text(str(WANDERING_DWELLS))
    copy = show(f"{stored}/?run=wandering&dwell={WANDERING_DWELLS}")
    expect(copy.locator("#dwell")).to_have_text(str(WANDERING_DWELLS))
    expect(page.locator("#tracks tbody")).to_have_text(copy.locator("#tracks tbody").inner_text(), use_inner_text=True)


def test_a_run_that_is_chosen_while_another_plays_is_shown_as_ever(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=3&speed=1")
    expect(page.locator("#dwell")).to_have_text("3")
    page.keyboard.press(" ")
    wait_for_dwell(page, 4)
    page.keyboard.press("r")
    page.get_by_role("link", name="hundred").click()
    expect(page.locator("#dwell")).to_have_text(str(HUNDRED_DWELLS))


def test_an_outage_is_over_once_an_answer_comes(stored: str, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True
    page = show(f"{stored}/?run=hundred&dwell=60&target=3")
    expect(page.locator("#pattern .scatterlayer .trace")).to_have_count(4)
    page.context.set_offline(True)
    page.keyboard.press("Home")
    expect(page.locator("#connection")).to_have_text("Reconnecting")
    expect(page.locator("#notice")).to_contain_text("goes on by itself")
    page.context.set_offline(False)
    expect(page.locator("#connection")).to_have_text("Complete")
    expect(page.locator("#notice")).to_be_hidden()
    expect(page.locator("#dwell")).to_have_text("1")
    page.keyboard.press("Escape")
    page.keyboard.press("3")
    expect(page.locator("#pattern .scatterlayer .trace")).to_have_count(4)


def test_a_click_on_a_chart_goes_to_its_dwell(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=180&target=1")
    expect(page.locator("#course .subplot")).to_have_count(5)
    page.keyboard.press("Escape")
    expect(page.locator("#course .subplot")).to_have_count(0)
    page.keyboard.press("1")
    expect(page.locator("#course .subplot")).to_have_count(5)
    x, y = page.evaluate(
        """(() => {
          const node = document.getElementById('course');
          const [box, shape, snr] = [node.getBoundingClientRect(), node._fullLayout, node.data[1]];
          const at = snr.x.indexOf(40);
          const [across, up] = [shape.xaxis, shape.yaxis2];
          return [box.x + across._offset + across.l2p(40), box.y + up._offset + up.l2p(snr.y[at])];
        })()"""
    )
    page.mouse.move(x, y)
    page.mouse.click(x, y)
    until(page, "Math.abs(Number(document.getElementById('dwell').textContent) - 40) < 4")


def test_only_runs_that_may_have_changed_are_asked_for_again(stored: str, show: Open) -> None:
    page = show(f"{stored}/?view=runs")
    expect(page.locator("#run-table tbody tr")).to_have_count(3)
    with page.expect_request(lambda request: "/runs?offset=" in request.url) as asked:
        pass
    assert asked.value.url.endswith("offset=2")
    expect(page.locator("#run-table tbody tr")).to_have_count(3)


@pytest.mark.parametrize("view", ["radar", "list", "machines", "runs"])
def test_everything_has_its_place_on_a_phone(stored: str, show: Open, watched: Watched, view: str) -> None:
    watched.may_be_refused = view == "machines"
    page = show(f"{stored}/?run=hundred&dwell=30&target=3&view={view}", width=390, height=844)
    expect(page.locator("#heading")).to_contain_text("hundred")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    expect(page.get_by_role("button", name="Play")).to_be_in_viewport()
    expect(page.get_by_role("slider", name="Dwell")).to_be_in_viewport()
    small = page.evaluate(
        "[...document.querySelectorAll('button, select, nav a')].filter(b => b.offsetParent"
        " && Math.min(b.offsetHeight, b.offsetWidth) < 24).map(b => b.outerHTML)"
    )
    assert small == []


def test_text_has_contrast_and_all_controls_have_names(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=50&target=1")
    expect(page.locator("#dwell")).to_have_text("50")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        names = page.evaluate(
            "Object.fromEntries(['ink', 'muted', 'alarm', 'warn', 'good', 'accent', 'panel', 'bg', 'on-warn']"
            ".map(n => [n, getComputedStyle(document.documentElement).getPropertyValue('--' + n)]))"
        )
        low = {
            (name, ground): _contrast(names[name], names[ground])
            for name in ("ink", "muted", "alarm", "warn", "good", "accent")
            for ground in ("panel", "bg")
        } | {("on-warn", "warn"): _contrast(names["on-warn"], names["warn"])}
        assert {pair: ratio for pair, ratio in low.items() if ratio < 4.5} == {}, scheme
    for control in page.locator("button:visible, a:visible, select:visible, input:visible, canvas:visible").all():
        if control.get_attribute("aria-hidden") != "true":
            assert control.evaluate("e => e.ariaLabel || e.innerText || e.labels?.[0]?.innerText"), control


def _contrast(one: str, other: str) -> float:
    """Contrast ratio as WCAG 2 defines it."""
    low, high = sorted(_luminance(colour.strip()) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_dwells_are_asked_for_although_others_of_their_hundred_were_under_way(stored: str, show: Open) -> None:
    held, address = list[Route](), f"{stored}/?run=hundred&dwell=60&target=3"

    def hold(route: Route) -> None:
        held.append(route)

    page = show(address, before=lambda page: page.route(re.compile("dwells=21:59$"), hold))
    for _ in range(WITHIN_MS // 50):
        if held:
            break
        page.wait_for_timeout(50)
    assert held, "the dwells around the first were not asked for"
    page.get_by_role("slider", name="Dwell").fill("20")
    expect(page.locator("#dwell")).to_have_text("20")
    with page.expect_request(re.compile("dwells=1:19$")):
        held[0].continue_()
