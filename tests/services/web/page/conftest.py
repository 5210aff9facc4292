"""A Chromium, pages that are watched for faults, a live run of real processes, and stored runs."""

import itertools
import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page, Request, expect, sync_playwright

from cogradar.services import kernels
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Gathered
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.web.address import listen, url
from cogradar.services.web.server import Server
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, RunStart, Scan, Truth
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.conftest import service_processes
from tests.services.loop import play
from tests.services.web import unknown_run
from tests.services.web.conftest import SITE, record
from tests.services.web.page.scenes import HUNDRED_DWELLS, WANDERING_DWELLS, hundred, wandering

WITHIN_MS = 20_000
BEGUN = 30
# The shell has no window: a page costs it half the processor time.
BROWSERS = "chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"
CHROMIUM = next(filter(None, map(shutil.which, BROWSERS)), None)
expect.set_options(timeout=WITHIN_MS)


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("there is no Chromium here (Debian: apt install chromium-headless-shell, or chromium)")
    with sync_playwright() as playwright:
        # A sandbox cannot be had by root in a container, and a graphics card that is emulated is slower than none.
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@dataclass
class Watched:
    """What went wrong on the pages of a test, and whom they asked."""

    faults: list[str] = field(default_factory=list)
    asked: set[str] = field(default_factory=set)
    may_be_refused: bool = False  # that an answer is a refusal, or none, is no fault

    def watch(self, page: Page) -> None:
        page.on("pageerror", lambda error: self.faults.append(f"{error.message}\n{error.stack}"))
        page.on("console", lambda line: self._said(line.type, line.text, line.location["url"]))
        page.on("request", self._request)

    def _said(self, kind: str, text: str, address: str) -> None:
        is_network = "Failed to load resource" in text or "net::ERR" in text
        if kind in {"error", "warning"} and not (self.may_be_refused and is_network):
            self.faults.append(f"{text}: {address}")

    def _request(self, request: Request) -> None:
        if urlsplit(request.url).scheme not in {"data", "blob"}:
            self.asked.add(urlsplit(request.url).netloc)


@pytest.fixture
def watched() -> Watched:
    return Watched()


Open = Callable[..., Page]


@pytest.fixture
def show(browser: Browser, watched: Watched) -> Iterator[Open]:
    """Opens an address in a page of its own. At the end no page had a fault or asked another host."""
    contexts = []

    def show_(
        address: str,
        width: int = 1280,
        height: int = 800,
        color_scheme: str = "light",
        before: Callable[[Page], None] = lambda _: None,
    ) -> Page:
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=color_scheme)  # type: ignore[arg-type] # "light" or "dark"
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(WITHIN_MS)
        watched.watch(page)
        before(page)
        page.goto(address)
        hosts.add(urlsplit(address).netloc)
        return page

    hosts: set[str] = set()
    yield show_
    for context in contexts:
        # What a test answers in the service's place asks the service first, perhaps just now.
        for page in context.pages:
            page.unroute_all(behavior="ignoreErrors")
        context.close()
    assert watched.faults == []
    assert watched.asked == hosts


@dataclass
class Live:
    """Services that are up, and a run of theirs that goes on."""

    launcher: Launcher
    run: str

    @property
    def page(self) -> str:
        return f"{self.launcher.url}/?run={self.run}"

    def kill(self, name: str) -> None:
        """End a process for good, until `mend`."""
        (process,) = (p for p, command in service_processes().items() if f"--name {name} " in command)
        os.kill(process, signal.SIGKILL)

    def mend(self) -> None:
        """Start again what was killed."""
        self.launcher.check()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """A run in real time at 10 Hz, longer than the tests."""
    kernels.compile_all(lambda _: None)
    store = str(tmp_path_factory.mktemp("live") / "runs.db")
    with Launcher(LocalProcesses(2, store, http="127.0.0.1:0"), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        start = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, 100_000, 10.0)
        cluster.start_on(launcher.endpoint, start, notify=lambda _: None, stop=threading.Event())
        yield Live(launcher, start.run)


def serve(store: Path, nobody_plays: frozenset[Role] = frozenset()) -> Iterator[str]:
    """Address of metrics on a store alone; or as if on a router, without processes of these roles."""
    core, listener = MetricsCore(str(store)), listen("127.0.0.1:0")
    assert listener is not None
    if nobody_plays:
        core.gather = lambda: Gathered({}, {(role, "") for role in nobody_plays})
    core.handle(Tick(time.monotonic()))
    server, stop = Server(core, listener), threading.Event()

    def tick() -> None:
        while not stop.wait(0.25):
            core.handle(Tick(time.monotonic()))

    ticking = threading.Thread(target=tick)
    ticking.start()
    yield url(listener)
    stop.set()
    ticking.join()
    server.close()
    core.close()


@pytest.fixture(scope="package")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Runs that are over: wandering, the same without truth (blind), and hundred."""
    path = tmp_path_factory.mktemp("stored") / "runs.db"
    start = wandering(WANDERING_DWELLS)
    sent: list[Message] = play(start)
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    record(
        path,
        {
            "wandering": sent,
            "blind": [blind, *(m for m in sent if not isinstance(m, RunStart | Truth))],
            "hundred": play(hundred(HUNDRED_DWELLS)),
        },
    )
    yield from serve(path)


@pytest.fixture(scope="package")
def unknown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Runs that are over, whose tracks begin and end: by-hand, the same on the earth (sited), in real time (late)."""
    path = tmp_path_factory.mktemp("unknown") / "runs.db"
    start, *sent = unknown_run.sent()
    assert isinstance(start, RunStart)
    sited = start.model_copy(update={"scenario": start.scenario | {"site": SITE}})
    record(path, {"sited": [sited, *sent], "late": [start, *map(unknown_run.late, sent)], "by-hand": [start, *sent]})
    yield from serve(path)


@pytest.fixture(scope="package")
def smoke_run() -> list[Message]:
    """A target is lost after some 40 dwells, and there are false alarms."""
    more = ["radar.fidelity=paper", "world.motion.sigma_s_km_s2=0.2", "radar.detector.p_fa=0.1"]
    return play(RunStart.of(load("smoke", more), Strategy.UNIFORM, 5, 2 * BEGUN))


def _until_dwell(sent: list[Message], t: int) -> list[Message]:
    return list(itertools.takewhile(lambda message: not (isinstance(message, Scan) and message.t == t), sent))


@pytest.fixture(scope="package")
def quiet(smoke_run: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Runs of which nothing more comes: over, and begun (running, with BEGUN - 1 dwells)."""
    path = tmp_path_factory.mktemp("quiet") / "runs.db"
    record(path, {"over": smoke_run, "begun": _until_dwell(smoke_run, BEGUN)})
    yield from serve(path, frozenset({Role.PLANNER, Role.ALLOCATOR}))


@pytest.fixture(scope="package")
def searching(smoke_run: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Runs of which nothing more comes: over, and searching (running, before its first dwell)."""
    path = tmp_path_factory.mktemp("searching") / "runs.db"
    record(path, {"over": smoke_run, "searching": _until_dwell(smoke_run, 1)})
    yield from serve(path)


def dwell_of(page: Page) -> int:
    """Which dwell is shown; 0 for none yet."""
    text = page.locator("#dwell").inner_text()
    return int(text) if re.fullmatch(r"\d+", text) else 0


def until(page: Page, expression: str) -> None:
    """Wait until an expression is true. (Playwright's own way needs `eval`, which the page's policy forbids.)"""
    deadline = time.monotonic() + WITHIN_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, expression
        page.wait_for_timeout(50)


def wait_for_dwell(page: Page, least: int) -> None:
    until(page, f"Number(document.getElementById('dwell').textContent) >= {least}")


def inked(page: Page, colour: str | None = None) -> float:
    """Share of the scope's pixels that are drawn, or that have this colour."""
    share: float = page.evaluate(
        """(wanted) => {
          const canvas = document.getElementById('scope');
          const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
          copy.drawImage(canvas, 0, 0);
          const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
          let n = 0;
          for (let i = 0; i < data.length; i += 4)
            n += wanted ? wanted.every((value, j) => data[i + j] === value) && data[i + 3] === 255 : data[i + 3] > 0;
          return (4 * n) / data.length;
        }""",
        None if colour is None else [int(colour.strip()[i : i + 2], 16) for i in (1, 3, 5)],
    )
    return share
