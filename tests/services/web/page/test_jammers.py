"""Jammers and the cells that they blind, over HTTP and on the page."""

import json
from collections.abc import Iterator
from urllib.request import urlopen

import pytest
from playwright.sync_api import expect

from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.loop import play
from tests.services.web.conftest import record
from tests.services.web.page.conftest import Open, inked, serve, until, wait_for_dwell

DWELLS, ON_S, OFF_S = 12, 2.0, 8.0
JAMMED = (
    "world.signal=array",
    f"world.jammers=[{{bearing_deg = 30.0, jnr_db = 40.0, on_s = {ON_S}, off_s = {OFF_S}}}]",
    "radar.belief.n_particle=200",
    "radar.planner.n_sim=100",
)
pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def jammed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A run with a jammer that is switched off, and one without any."""
    path = tmp_path_factory.mktemp("jammed") / "runs.db"
    start = RunStart.of(load("smoke", JAMMED), Strategy.ORTHOGONAL, 1, DWELLS)
    quiet = RunStart.of(load("smoke", JAMMED[2:]), Strategy.ORTHOGONAL, 1, DWELLS)
    record(path, {"jammed": play(start), "quiet": play(quiet)})
    yield from serve(path)


def _blind(address: str, run: str) -> dict[int, int]:
    """How many cells are blind in each dwell."""
    with urlopen(f"{address}/api/v1/runs/{run}/dwells?dwells=1:{DWELLS}") as answer:  # noqa: S310 - our own
        return {dwell["t"]: sum(dwell["cells"]["blind"]) for dwell in json.load(answer)["dwells"]}


def test_a_jammer_and_the_cells_it_blinds_are_drawn_while_it_is_on(jammed: str, show: Open) -> None:
    blind = _blind(jammed, "jammed")
    assert sum(n for t, n in blind.items() if ON_S <= t < OFF_S) > 0
    assert max(n for t, n in blind.items() if not ON_S <= t < OFF_S) < 3
    most, least = (pick((t for t in blind if ON_S <= t < OFF_S), key=blind.__getitem__) for pick in (max, min))
    assert blind[most] > blind[least]
    ink = {}
    for t in (most, least, DWELLS):
        page = show(f"{jammed}/?run=jammed&dwell={t}")
        wait_for_dwell(page, t)
        expect(page.locator("#legend")).to_contain_text("jammer")
        expect(page.locator("#legend")).to_contain_text("blind cell")
        warn = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--warn')")
        until(page, "document.getElementById('scope').width > 0")
        page.wait_for_timeout(500)
        ink[t] = inked(page, warn)
    assert ink[most] > ink[least] > ink[DWELLS]


def test_without_a_jammer_the_legend_has_none(jammed: str, show: Open) -> None:
    page = show(f"{jammed}/?run=quiet&dwell={DWELLS}")
    wait_for_dwell(page, DWELLS)
    expect(page.locator("#legend")).to_contain_text("lost")
    expect(page.locator("#legend")).not_to_contain_text("jammer")
