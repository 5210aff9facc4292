"""Where dwells are missing, or nothing was measured in them, no line of the page goes across."""

from typing import Any

import pytest
from playwright.sync_api import Page, Route

from tests.services.web.page.conftest import Open, until

pytestmark = pytest.mark.browser

MISSING = range(40, 60)  # dwells that never happened, as the receiver was away
ALONE = 90  # a dwell with transmission
PAUSED = {*range(80, 100)} - {ALONE}  # dwells without
# Of each line of a chart that is seen: the dwells around its breaks.
BREAKS = """(id) => {
  const lines = document.getElementById(id).data.filter((one) => one.mode === 'lines' && one.line.width > 0);
  const next = (one, i) => one.x[i + one.y.slice(i).findIndex((y) => y !== null)];
  const begins = (one, i) => i && one.y[i] === null && one.y[i - 1] !== null;
  const breaks = (one) => one.y.flatMap((_, i) => (begins(one, i) ? [[one.x[i - 1], next(one, i)]] : []));
  return lines.map(breaks);
}"""


def _without(document: dict[str, Any], n: int) -> dict[str, Any]:
    """Columns without the missing dwells."""
    kept = [i for i in range(n) if i + 1 not in MISSING]
    return {
        name: [column[i] for i in kept] if isinstance(column, list) and len(column) == n else column
        for name, column in document.items()
    }


def _course(route: Route) -> None:
    answer = route.fetch()
    document = answer.json()
    for name in ("detected", "statistic"):
        document[name] = [None if t in PAUSED else one for t, one in zip(document["t"], document[name], strict=True)]
    route.fulfill(response=answer, json=_without(document, len(document["t"])))


def _timeline(route: Route) -> None:
    answer = route.fetch()
    document = answer.json()
    route.fulfill(response=answer, json=_without(document, len(document["first"])))


def _answers(page: Page) -> None:
    page.route("**/course?*", _course)
    page.route("**/timeline", _timeline)


def test_no_line_of_a_course_goes_across_an_outage_or_a_pause(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&dwell=120&target=1", before=_answers)
    until(page, "document.getElementById('course').data?.length > 3")
    share, snr, statistic, threshold, p_d, error, floor = page.evaluate(f"({BREAKS})('course')")
    outage, pause = [39, 60], [79, ALONE]
    assert outage in share
    assert outage in snr  # where the target was is known in a pause
    for line in (threshold, p_d, error, floor):
        assert outage in line
        assert pause in line
    assert pause in statistic
    assert any(begin <= outage[0] < outage[1] <= end for begin, end in statistic)
    alone = page.evaluate(
        "(t) => document.getElementById('course').data.filter((one) => one.mode === 'lines' && one.line.width > 0)"
        ".map(({ x, y }) => y.filter((value, i) => value !== null && Math.round(x[i]) === t).length)",
        ALONE,
    )
    assert alone == 7 * [2]  # a line of one point is not seen
    crosses = page.evaluate("document.getElementById('course').data.find((one) => one.mode === 'markers').x")
    assert len(crosses) == len(set(crosses))
    low, high = page.evaluate(
        "document.getElementById('course').data.filter((one) => one.line.width === 0).map(({ x, y }) =>"
        " x.map((t, i) => [t, y[i]]).filter(([t]) => t === 39 || t === 60))"
    )
    assert low[1] == high[1]  # the area has no height at the edges of a gap, nor between them
    assert low[2] == high[2]
    assert low[0] != high[0]


def test_the_timeline_and_two_runs_show_an_outage(stored: str, show: Open) -> None:
    page = show(f"{stored}/?run=wandering&view=runs&beside=blind", before=_answers)
    until(page, "document.getElementById('compare').data?.length > 3")
    lines = page.evaluate(f"({BREAKS})('compare')")
    assert [39, 60] in lines[0]
    assert [39, 60] in lines[2]
    until(
        page,
        """[39, 50].map((t) => {
          const strip = document.getElementById('strip');
          const x = Math.round(strip.width * (8 + ((strip.clientWidth - 16) * (t - 1)) / 189) / strip.clientWidth);
          const copy = new OffscreenCanvas(1, strip.height).getContext('2d', { willReadFrequently: true });
          copy.drawImage(strip, -x, 0);
          return copy.getImageData(0, 0, 1, strip.height).data.some((value) => value > 0);
        }).join() === 'true,false'""",
    )
