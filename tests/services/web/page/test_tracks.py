"""The page over a run whose tracks begin, are confirmed, and end: nobody told the radar how many targets there are."""

import pytest
from playwright.sync_api import expect

from tests.services.web.page.conftest import Open, inked, until

pytestmark = pytest.mark.browser


def test_tracks_come_are_confirmed_and_disappear(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=by-hand&dwell=1")
    rows, caption = page.locator("#tracks tbody tr"), page.locator("#tracks-caption")
    expect(page.locator("#dwell")).to_have_text("1")
    expect(page.locator("#tracks-title")).to_have_text("Tracks")
    expect(caption).to_have_text("0 confirmed; 0 of 1 targets followed")  # an empty sky, as far as the radar knows
    expect(rows).to_have_count(0)
    scrub = page.get_by_role("slider", name="Dwell")
    scrub.fill("4")
    expect(rows.locator("th")).to_have_text(["1", "2"])
    expect(rows.nth(1).locator("td").first).to_have_text("tentative")
    expect(caption).to_contain_text("1 confirmed, 1 tentative")
    expect(page.locator("#picture")).to_have_text("GOSPA 0 km (off 0, missed 0, false 0) · 0 swaps, 300 false/h")
    expect(page.locator("#beliefs")).to_have_text(
        "NEES all 0.0, straight 0.0 · 0.0 % beyond 99 % · confirmed after 2 s of radar time, "
        "95 % 2 s, 0 of 0 never found"
    )
    # Of a target that is lost the error may be as large as it likes.
    assert page.evaluate(
        "import('/page/text.js').then(({ fixed, short }) => [fixed(5.687e17), short(-1.25e5), fixed(99999, 0)])"
    ) == [
        "5.7e17",
        "\N{MINUS SIGN}1.3e5",
        "99999",
    ]
    scrub.fill("8")
    expect(rows.locator("th")).to_have_text(["1", "3"])
    expect(rows.locator("td:nth-child(4)")).to_have_text(["90.0", "90.0"])
    page.keyboard.press("2")  # the second row
    expect(page.locator("#course-title")).to_contain_text("Track 3: detected")
    expect(page.locator("#course .subplot")).to_have_count(4)
    expect(page.locator("#facts")).to_contain_text("90.0 %, turns 10 %, hard 10 %")
    until(page, "document.getElementById('pattern').ariaLabel?.startsWith('Beampattern of dwell 8: track 1')")
    colour = page.evaluate("getComputedStyle(document.querySelector('#tracks tr:nth-child(2) .glyph path')).fill")
    scrub.fill("12")
    expect(rows.locator("th")).to_have_text(["1"])
    expect(page.locator("#course-title")).to_have_text("Track 3 is not there in dwell 12")
    scrub.fill("7")
    expect(rows.locator("th")).to_have_text(["1", "3"])
    assert colour == page.evaluate(
        "getComputedStyle(document.querySelector('#tracks tr:nth-child(2) .glyph path')).fill"
    )


def test_the_timeline_and_the_log_tell_of_tracks_that_begin_and_end(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=by-hand&dwell=2&speed=5")
    expect(page.locator("#dwell")).to_have_text("2")
    expect(page.locator("#strip-key")).to_contain_text("targets without a track")
    page.keyboard.press(" ")
    events = page.get_by_role("log", name="Tracks confirmed and ended")
    expect(events).to_contain_text("track 1 confirmed")
    expect(events).to_contain_text("track 3 confirmed")
    expect(events).to_contain_text("track 3 ended")
    expect(events).not_to_contain_text("track 2")  # it never was
    until(page, "document.getElementById('dwell').textContent === '12'")
    until(page, "document.getElementById('scope').ariaLabel.includes('confirmed tracks: 1')")
    assert inked(page) > 0.01


def test_the_timeline_shows_late_plans_and_stale_waveforms(unknown: str, show: Open) -> None:
    page = show(f"{unknown}/?run=late&dwell=9")
    expect(page.locator("#strip-key .key-late")).to_be_visible()
    expect(page.locator("#tracks tbody tr").first).to_contain_text("late, stale")
    marked = """Math.max(...[8, 9].map((t) => {
      const strip = document.getElementById('strip');
      const ink = getComputedStyle(document.documentElement).getPropertyValue('--warn').trim();
      const rgb = [1, 3, 5].map((i) => parseInt(ink.slice(i, i + 2), 16));
      const x = Math.round(strip.width * (8 + (strip.clientWidth - 16) * (t - 1) / 11) / strip.clientWidth);
      const copy = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
      copy.drawImage(strip, -x, 1 - strip.height);
      const { data } = copy.getImageData(0, 0, 1, 1);
      return rgb.reduce((sum, value, i) => sum + Math.abs(value - data[i]), 0);
    })) < 10"""
    until(page, marked)


def test_numbers_at_the_beampattern_cover_no_others(unknown: str, show: Open) -> None:
    """Of a hundred tracks none had a number, and of a few they lay on one another."""
    page = show(f"{unknown}/?run=by-hand&dwell=4")
    beams = [
        {"target": target, "angle_deg": angle_deg, "power_db": power_db}
        for target, angle_deg, power_db in (
            (955, 48.6, 0.0),
            (974, 50.8, -1.0),
            (119, 9.0, 3.0),
            (119, 30.0, 2.0),
            (7, 51.0, -20.0),
        )
    ]
    numbers = (
        "([beams, chosen]) => import('/page/pattern.js')"
        ".then(({ withNumbers }) => withNumbers(beams, chosen, 700).map((one) => one.target))"
    )
    assert page.evaluate(numbers, [beams, None]) == [119, 955, 7]
    assert page.evaluate(numbers, [beams, 974]) == [974, 119, 7]
