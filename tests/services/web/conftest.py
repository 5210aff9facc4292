"""A journal with a run of each kind, and a service over it."""

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from starlette.types import ASGIApp

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Gathered, read
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.web.address import listen, url
from cogradar.services.web.server import Server
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, RunStart, Scan, Truth
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.exposition import Exposition
from tests.services.loop import play, smoke_start

DWELLS = 8
LATE = 3  # dwell that an older waveform was radiated in, of some runs
SITE = {
    "latitude_deg": 48.0,
    "longitude_deg": 11.0,
    "height_m": 500.0,
    "boresight_deg": 30.0,
    "begin_utc": "2026-01-01T00:00:00Z",
}
FAST_S = 0.001  # between the events of a stream


@pytest.fixture(scope="session")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def record(path: Path, runs: dict[str, list[Message]]) -> None:
    """Write these messages into a journal, as runs of these names."""
    journal = Journal(str(path))
    for run, messages in runs.items():
        core = RecorderCore(journal)
        for message in messages:
            core.handle(message.model_copy(update={"run": run}))
        for _ in range(2):
            core.handle(Tick(0.0))
    journal.close()


def _late(message: Message) -> Message:
    """In dwell 3 an older waveform was radiated."""
    if isinstance(message, Scan | Truth) and message.t == LATE:
        return message.model_copy(update={"waveform_k": message.k - 2})
    return message


def _timed(message: Message) -> Message:
    """When a scan was."""
    return message.model_copy(update={"utc_s": 1e9 + message.k}) if isinstance(message, Scan) else message


@pytest.fixture(scope="session")
def journal(sent: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs: whole, other (another strategy), sited (on the earth), timed (late once), blind (so, no truth), begun."""
    path = tmp_path_factory.mktemp("web") / "runs.db"
    start = smoke_start(dwells=DWELLS)
    sited = start.scenario | {"site": SITE}
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    record(
        path,
        {
            "whole": sent,
            "other": play(smoke_start(Strategy.UNIFORM, dwells=DWELLS)),
            "sited": [start.model_copy(update={"scenario": sited}), *sent[1:]],
            "timed": [_timed(_late(m)) for m in sent],
            "blind": [blind, *(_late(m) for m in sent if not isinstance(m, RunStart | Truth))],
            "begun": sent[: len(sent) // 2],
        },
    )
    return path


@pytest.fixture(scope="session")
def core(journal: Path) -> Iterator[MetricsCore]:
    core = MetricsCore(str(journal))
    text = Exposition(core.measures).text  # of this process alone: there is no router
    core.gather = lambda: Gathered({(Role.METRICS, "metrics-0"): read(text())}, {(Role.PLANNER, "")})
    core.handle(Tick(time.monotonic()))
    yield core
    core.close()


@pytest.fixture(scope="session")
def server(core: MetricsCore) -> Iterator[str]:
    """Address of a server."""
    listener = listen("127.0.0.1:0")
    assert listener is not None
    address = url(listener)
    server, stop = Server(core, listener, FAST_S), threading.Event()

    def tick() -> None:
        while not stop.wait(0.25):
            core.handle(Tick(time.monotonic()))

    ticking = threading.Thread(target=tick)
    ticking.start()
    yield address
    stop.set()
    ticking.join()
    server.close()


@pytest.fixture(scope="session")
def web(server: str) -> Iterator[httpx.Client]:
    """A client of the server."""
    with httpx.Client(base_url=server, timeout=30.0) as client:
        yield client


def ask(app: ASGIApp, path: str, **headers: str) -> httpx.Response:
    """Ask an application in this process."""

    async def get() -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.get(path, headers=headers)

    return asyncio.run(get())
