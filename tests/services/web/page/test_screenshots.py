"""Draws the pictures of the page that the documents show: of a run of the paper's scenario that goes on."""

import threading
from pathlib import Path

import pytest
from playwright.sync_api import expect

from cogradar.services import kernels
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.web.page.conftest import Open, Watched, wait_for_dwell

FIGURES = Path(__file__).resolve().parents[4] / "docs" / "figures"
RATE_HZ = 5.0
DWELL = 150

pytestmark = [pytest.mark.screenshots, pytest.mark.zenoh]


def test_draw_them(show: Open, watched: Watched) -> None:
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(2, http="127.0.0.1:0"), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        start = RunStart.of(load("paper"), Strategy.POWER_AWARE, 3, 300, RATE_HZ)
        cluster.start_on(launcher.endpoint, start, notify=lambda _: None, stop=threading.Event())
        page = show(f"{launcher.url}/?run={start.run}&target=2")
        page.wait_for_timeout(DWELL / RATE_HZ * 1000)
        wait_for_dwell(page, DWELL)
        expect(page.locator("#course .subplot")).to_have_count(5)
        page.screenshot(path=FIGURES / "page-radar.png")
        page.keyboard.press("m")
        page.wait_for_timeout(5000)
        page.keyboard.press("d")
        page.screenshot(path=FIGURES / "page-machines.png")
        phone = show(f"{launcher.url}/?run={start.run}&target=3", 390, 844, "dark")
        expect(phone.locator("#course .subplot")).to_have_count(5)
        phone.wait_for_timeout(2000)
        phone.screenshot(path=FIGURES / "page-phone.png")
        watched.may_be_refused = True  # the services end before the pages
