"""Commands from the page: with a token, in words, by buttons and on the scope; what comes of them is seen."""

import re
import threading
import time
from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from cogradar.services import kernels
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.web.address import COMMAND_VARIABLE
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.web.page.conftest import Live, Open, Watched, inked, wait_for_dwell
from tests.skies import small_sky

pytestmark = [pytest.mark.browser, pytest.mark.zenoh]
TOKEN, WARN, ALARM = "c0mmander-of-the-tower", "#946200", "#d1002c"  # the colours in light


@pytest.fixture(scope="module")
def sky(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """A run of an unknown number in real time, longer than the tests, which `tower` may command."""
    kernels.compile_all(lambda _: None)
    store = str(tmp_path_factory.mktemp("sky") / "runs.db")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMMAND_VARIABLE, f"tower:{TOKEN}")
        with Launcher(LocalProcesses(1, store, http="127.0.0.1:0"), threading.Event()) as launcher:
            cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
            start = RunStart.of(small_sky(), Strategy.POWER_AWARE, 1, 100_000, 5.0)
            cluster.start_on(launcher.endpoint, start, notify=lambda _: None, stop=threading.Event())
            yield Live(launcher, start.run)


@pytest.fixture
def commander(sky: Live, show: Open) -> Page:
    """The page with its panel open, and the token typed."""
    page = show(sky.page)
    wait_for_dwell(page, 3)
    page.keyboard.press("c")
    expect(page.get_by_label("Commander's token")).to_be_focused()
    expect(page.locator("#command-acts")).to_be_hidden()
    page.keyboard.type(TOKEN)
    page.keyboard.press("Enter")
    expect(page.get_by_label("In words")).to_be_focused()
    expect(_answer(page)).to_have_text("You command as tower.")
    return page


def _answer(page: Page) -> Locator:
    return page.locator("#command-answer")


def _at(page: Page, share: float) -> tuple[float, float]:
    """A point of the scope, from its left to its right edge, half-way up."""
    box = page.locator("#scope").bounding_box()
    assert box is not None
    return box["x"] + share * box["width"], box["y"] + 0.5 * box["height"]


def test_a_command_in_words_is_granted_or_refused(commander: Page, watched: Watched) -> None:
    watched.may_be_refused = True
    expect(page_forms := commander.locator("#command-forms")).to_contain_text(
        "sector blank|normal|double FROM TO; look"
    )
    commander.keyboard.type("power 0.5")
    commander.keyboard.press("Enter")
    expect(_answer(commander)).to_have_text(re.compile(r"^power 0\.5: granted from dwell \d+ on\.$"))
    expect(commander.locator("#orders li")).to_have_text(re.compile(r"^power 0\.5 since dwell \d+, tower$"))
    for words, why in (
        ("drop 999999", "there is no track 999999"),
        ("power 2", "share = 2"),
        ("dance", "must be one of"),
    ):
        commander.get_by_label("In words").fill(words)
        commander.keyboard.press("Enter")
        expect(_answer(commander)).to_contain_text(why)
    expect(page_forms).to_be_visible()  # a word that makes no sense costs no token
    commander.get_by_label("at most, %").fill("100")
    commander.get_by_role("button", name="Limit").click()
    expect(_answer(commander)).to_have_text(re.compile("^power 1: granted"))
    expect(commander.locator("#orders")).to_be_hidden()
    assert TOKEN not in commander.url


def test_a_sector_is_drawn_blanked_and_seen(commander: Page) -> None:
    expect(commander.locator("#legend")).not_to_contain_text("blanked sector")
    commander.keyboard.press("Tab")  # out of the line of words, to where letters are keys
    commander.keyboard.press("s")
    expect(commander.get_by_role("button", name="Draw", exact=True)).to_have_attribute("aria-pressed", "true")
    chosen = commander.url
    commander.mouse.move(*_at(commander, 0.7))
    commander.mouse.down()
    commander.mouse.move(*_at(commander, 0.65))
    commander.mouse.move(*_at(commander, 0.6))
    commander.mouse.up()
    low, high = (float(commander.get_by_label(name, exact=True).input_value()) for name in ("from", "to"))
    assert 5.0 < low < high < 60.0
    assert commander.url.partition("&target")[2] == chosen.partition("&target")[2]  # no target was chosen meanwhile
    commander.keyboard.press("Escape")
    before = inked(commander, WARN)
    commander.get_by_role("button", name="Blank").click()
    expect(_answer(commander)).to_contain_text(f"sector blank {low:g} {high:g}: granted from dwell")
    expect(commander.locator("#legend")).to_contain_text("blanked sector")
    deadline = time.monotonic() + 20.0
    while inked(commander, WARN) <= before:  # a late waveform does not obey it
        assert time.monotonic() < deadline
        commander.wait_for_timeout(50)
    commander.get_by_role("button", name="Normal").click()
    expect(_answer(commander)).to_contain_text("sector normal")
    expect(commander.locator("#orders")).to_be_hidden()


def test_a_look_goes_where_the_scope_is_clicked(commander: Page) -> None:
    commander.get_by_label("dwells", exact=True).fill("30")
    commander.get_by_role("button", name="Aim").click()
    commander.mouse.click(*_at(commander, 0.4))
    expect(_answer(commander)).to_have_text(re.compile(r"^look -\d+(\.\d)? 30 0\.2: granted from dwell \d+ on\.$"))
    expect(commander.get_by_role("button", name="Aim")).to_have_attribute("aria-pressed", "false")
    expect(commander.locator("#legend")).to_contain_text("commanded look")


def test_transmission_is_paused_and_resumed_and_the_scope_says_so(commander: Page) -> None:
    expect(commander.locator("#legend")).not_to_contain_text("transmission paused")
    before = inked(commander, ALARM)
    commander.get_by_role("button", name="Pause transmission").click()
    expect(_answer(commander)).to_have_text(re.compile(r"^pause: granted from dwell \d+ on\.$"))
    expect(commander.locator("#legend")).to_contain_text("transmission paused")
    deadline = time.monotonic() + 20.0
    while inked(commander, ALARM) <= before:
        assert time.monotonic() < deadline
        commander.wait_for_timeout(50)
    commander.get_by_role("button", name="Resume").click()
    expect(_answer(commander)).to_contain_text("resume: granted from dwell")
    expect(commander.locator("#orders li", has_text="pause")).to_have_count(0)
    commander.locator("#pause-dwells").fill("2")
    commander.get_by_role("button", name="Pause transmission").click()
    expect(_answer(commander)).to_contain_text("pause 2: granted from dwell")


def test_the_chosen_track_comes_first_and_is_dropped(commander: Page) -> None:
    drop = commander.locator("#drop")
    expect(drop).to_be_disabled()
    commander.locator("#tracks tbody tr[data-state=detected]").first.get_by_role("button").click()
    expect(drop).to_have_text(re.compile(r"^Drop track \d+$"))
    track = drop.inner_text().split()[-1]
    commander.get_by_role("button", name="Priority").click()
    expect(_answer(commander)).to_contain_text(f"priority {track} 4: granted from dwell")
    order = commander.locator("#orders li", has_text="priority")  # the look of the test above may still be in force
    expect(order).to_have_text(re.compile(rf"^priority {track} 4 since dwell \d+, tower$"))
    commander.get_by_label("within, km").fill("3")
    commander.get_by_role("button", name="Accuracy", exact=True).click()
    expect(_answer(commander)).to_contain_text(f"accuracy {track} 3: granted from dwell")
    commander.get_by_role("button", name="Any accuracy").click()
    expect(_answer(commander)).to_contain_text(f"accuracy {track} none: granted from dwell")
    drop.click()
    expect(_answer(commander)).to_contain_text(f"drop {track}: granted from dwell")
    expect(commander.locator(f"#tracks tr[data-target='{track}']")).to_have_count(0)


def test_what_stops_the_radar_comes_first(commander: Page) -> None:
    names = commander.locator("#command-acts button").all_inner_texts()
    assert names[:3] == ["Pause transmission", "Resume transmission", "End the run …"]
    expect(commander.get_by_role("button", name="Freeze")).to_be_visible()  # what stops the picture is called otherwise
    expect(commander.get_by_role("button", name=re.compile("pause", re.IGNORECASE))).to_have_count(1)


def test_a_second_enter_sends_nothing(commander: Page, watched: Watched) -> None:
    watched.may_be_refused = True
    sent = list[str]()
    commander.on("request", lambda request: sent.append(request.url) if request.method == "POST" else None)
    words = commander.get_by_label("In words")
    words.fill("power 1")
    commander.keyboard.press("Enter")
    expect(_answer(commander)).to_contain_text("power 1: granted")
    expect(words).to_have_value("")
    commander.keyboard.press("Enter")
    words.fill("power 2")
    commander.keyboard.press("Enter")
    expect(_answer(commander)).to_contain_text("share = 2")
    expect(words).to_have_value("power 2")  # to be mended
    assert len(sent) == 2


def test_a_token_that_is_none_opens_nothing(sky: Live, show: Open, watched: Watched) -> None:
    watched.may_be_refused = True
    page = show(sky.page)
    wait_for_dwell(page, 3)
    page.get_by_role("button", name="Command").click()
    page.get_by_label("Commander's token").fill("no-commander-has-this-one")
    page.get_by_role("button", name="Use it").click()
    expect(_answer(page)).to_contain_text("this token is no commander's")
    expect(page.locator("#command-acts")).to_be_hidden()
    expect(page.get_by_label("Commander's token")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#command")).to_be_hidden()
    expect(page.get_by_role("button", name="Command")).to_be_focused()


def test_the_run_ends_when_it_is_asked_for_twice(sky: Live, commander: Page) -> None:
    """The last test of this file: the run is over."""
    commander.get_by_role("button", name="End the run …").click()
    commander.get_by_role("button", name="Keep it").click()
    expect(commander.locator("#connection")).to_have_text("Live")
    assert not [row for row in _commands(sky) if row["action"] == "end"]
    commander.get_by_label("In words").fill("end")
    commander.keyboard.press("Enter")
    expect(commander.locator("#end-dialog")).to_contain_text(sky.run)
    commander.get_by_role("button", name="End the run", exact=True).click()
    expect(_answer(commander)).to_contain_text("end: granted from dwell")
    expect(commander.locator("#connection")).to_have_text("Complete: ended by command")
    expect(commander.locator("#command-over")).to_be_visible()
    expect(commander.locator("#command-acts")).to_be_hidden()
    commander.locator("#token-forget").evaluate("button => button.click()")
    expect(commander.locator("#token-form")).to_be_hidden()


def _commands(sky: Live) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = httpx.get(f"{sky.launcher.url}/api/v1/runs/{sky.run}/commands").json()["rows"]
    return rows
