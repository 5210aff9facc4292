"""Draws the pictures of the page that the documents show: of a run of the paper's scenario that goes on."""

import io
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page, expect

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
FILM_S, FRAME_S = 10.0, 0.25
COLOURS = 64
LARGEST = 3_000_000  # bytes of a file in the README

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
        page.keyboard.press("g")
        happens: dict[float, Callable[[], object]] = {
            2.0: lambda: page.keyboard.press("m"),
            3.5: lambda: launcher.signal("planner-1", signal.SIGKILL),
            8.0: lambda: page.keyboard.press("g"),
        }
        film(page, FIGURES / "page-killed.gif", happens)
        phone = show(f"{launcher.url}/?run={start.run}&target=3", 390, 844, "dark")
        expect(phone.locator("#course .subplot")).to_have_count(5)
        phone.wait_for_timeout(2000)
        phone.screenshot(path=FIGURES / "page-phone.png")
        watched.may_be_refused = True  # the services end before the pages


def film(page: Page, path: Path, happens: dict[float, Callable[[], object]]) -> None:
    """Write an animated GIF of a page, FILM_S seconds long. `happens` has actions by seconds from the start."""
    frames, at, waiting = [], [], sorted(happens)
    began = time.monotonic()
    while (now := time.monotonic() - began) < FILM_S:
        while waiting and waiting[0] <= now:
            happens[waiting.pop(0)]()
        frames.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
        at.append(now)
        page.wait_for_timeout(max(0.0, 1000 * (FRAME_S - (time.monotonic() - began - now))))
    first = frames[0].quantize(COLOURS)
    lasts_ms = [round(1000 * (end - start)) for start, end in zip(at, [*at[1:], FILM_S + 1.0], strict=True)]
    further = [frame.quantize(palette=first, dither=Image.Dither.NONE) for frame in frames[1:]]
    first.save(path, save_all=True, append_images=further, duration=lasts_ms, loop=0, optimize=True)
    assert path.stat().st_size < LARGEST
