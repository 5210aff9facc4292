"""How fast it draws: a hundred tracks at 10 Hz, any stored dwell at a click, and for an hour without growing."""

import logging
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.services.web.long_run import long_run
from tests.services.web.page.conftest import Live, Open, serve, until, wait_for_dwell

pytestmark = pytest.mark.browser
log = logging.getLogger(__name__)
WITHIN_MS = 100.0
ATTEMPTS = 3  # something else may need the machine meanwhile

# From the cause until it is on the screen, as the page measures it.
WATCH = """window.took = []; new PerformanceObserver((list) => {
  for (const one of list.getEntriesByName('dwell')) window.took.push(one.duration);
}).observe({ entryTypes: ['measure'] })"""


def _took(page: Page) -> list[float]:
    return sorted(page.evaluate("took.splice(0)"))


@pytest.mark.parametrize("share", [0.5, pytest.param(0.9, marks=pytest.mark.nightly)])
def test_a_hundred_tracks_at_10_hz_are_drawn_within_100_ms(stored: str, show: Open, share: float) -> None:
    """This share of the updates; 0.9 wants an idle machine."""
    page = show(f"{stored}/?run=hundred&dwell=1&target=42&speed=10")
    expect(page.locator("#tracks tbody tr")).to_have_count(100)
    expect(page.locator("#course .subplot")).to_have_count(5)
    page.evaluate(WATCH)
    said = []
    for _ in range(ATTEMPTS):
        page.keyboard.press("Home")
        page.wait_for_timeout(500)
        _took(page)
        page.keyboard.press(" ")
        began = time.monotonic()
        wait_for_dwell(page, 50)
        took = _took(page)
        assert took, "no update was measured"
        rate_hz, slow = len(took) / (time.monotonic() - began), took[int(share * len(took))]
        page.keyboard.press(" ")
        said.append(f"{rate_hz:.1f} Hz, {share:.0%} of the updates within {slow:.0f} ms")
        log.info(said[-1])
        if rate_hz > 7.0 and slow < WITHIN_MS:
            return
    raise AssertionError(said)


def test_any_stored_dwell_is_there_within_100_ms_of_the_click(stored: str, show: Open) -> None:
    _click(show(f"{stored}/?run=wandering&target=1"), (3, 120, 41, 189, 77, 160, 12, 99, 140))


@pytest.mark.nightly
def test_any_of_20_000_stored_dwells_is_there_within_100_ms_of_the_click(tmp_path: Path, show: Open) -> None:
    for address in serve(long_run(tmp_path / "long.db", 20_000)):
        page = show(f"{address}/?run=long&target=1")
        _click(page, (3, 12_000, 4_100, 18_900, 7_700, 16_000, 1_200, 9_900, 14_000))
        page.close()  # or it would find its service gone


def _click(page: Page, dwells: Sequence[int]) -> None:
    """Show each of these dwells; half of them within the time, or it is tried again."""
    said = []
    for _ in range(ATTEMPTS):
        expect(page.locator("#course .subplot")).to_have_count(5)
        page.evaluate(WATCH)
        took = []
        for dwell in dwells:
            page.get_by_role("slider", name="Dwell").fill(str(dwell))
            expect(page.locator("#dwell")).to_have_text(str(dwell))
            until(page, "took.length > 0")
            took.append(_took(page)[-1])
        said.append(took)
        log.info("dwells %s within %s ms", dwells, [round(ms) for ms in took])
        if sorted(took)[len(took) // 2] < WITHIN_MS:
            return
        page.reload()  # so that all have to be asked for again
    raise AssertionError(said)


@pytest.mark.nightly
@pytest.mark.zenoh
def test_memory_stays_flat(live: Live, show: Open, pytestconfig: pytest.Config) -> None:
    """A live page, a target's charts open, for --browser-minutes."""
    page = show(f"{live.page}&target=2")
    wait_for_dwell(page, 1)
    devtools = page.context.new_cdp_session(page)
    devtools.send("HeapProfiler.enable")
    heap = []
    for _ in range(int(pytestconfig.getoption("browser_minutes"))):
        page.wait_for_timeout(60_000)
        devtools.send("HeapProfiler.collectGarbage")
        used = devtools.send("Runtime.getHeapUsage")["usedSize"]
        counts = devtools.send("Memory.getDOMCounters")
        heap.append((used / 2**20, counts["nodes"], counts["jsEventListeners"]))
        log.info("%.1f MiB, %d nodes, %d listeners", *heap[-1])
    settled = heap[len(heap) // 3]
    assert heap[-1][0] < settled[0] + 8.0  # MiB
    assert heap[-1][1] < 1.5 * settled[1]
    assert heap[-1][2] < 1.5 * settled[2]
