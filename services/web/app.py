"""The application: what is served where, what is refused, and who is let go."""

import asyncio
import time
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from http import HTTPStatus

from anyio import CapacityLimiter
from anyio.to_thread import current_default_thread_limiter
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from services.errors import BadInput, StoreFailed
from services.metrics.core import MetricsCore
from services.metrics.processes import page as page_of
from services.web.events import Feed, events
from services.web.openapi import describe
from services.web.parameters import MAX_QUERY
from services.web.problems import API, Problem, of_error
from services.web.rows import SCORED, core_of, run, runs, scored
from services.web.shared import VIEW_S, Shared, once
from services.web.static import file, page
from services.web.views.beampattern import beampattern
from services.web.views.dwells import Encoded, dwells
from services.web.views.history import Courses, history
from services.web.views.particles import Beliefs, particles
from services.web.views.processes import Machines, processes
from services.web.views.radar import radar
from services.web.views.timeline import timeline

THREADS = 4  # answers in work: they share one connection to the journal
COURSES = 2  # courses of targets in work, in threads of their own: the first look at a long run takes seconds
TICK_WITHIN_S = 5.0  # a service whose main loop takes longer is not ready
SEND_WITHIN_S = 30.0  # some part of what waits for a client, or it is let go
PROMETHEUS = "text/plain; version=0.0.4; charset=utf-8"


async def healthz(_: Request) -> Response:
    """Whether the process is up."""
    return JSONResponse({"status": "ok"})


async def readyz(request: Request) -> Response:
    """Whether there is a journal, and the service is connected and follows it."""
    core = core_of(request)
    if not core.is_open:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "there is no journal yet")
    if core.tick_s is None or time.monotonic() - core.tick_s > TICK_WITHIN_S:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not connected to a router, or too busy to follow the journal")
    return JSONResponse({"status": "ok"})


async def metrics(request: Request) -> Response:
    """All processes, for Prometheus: they are asked once for all who ask meanwhile, which may take seconds."""
    gather = core_of(request).gather
    if gather is None:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not connected to a router")
    return Response(await request.app.state.scraped.get(None, lambda: page_of(gather())), media_type=PROMETHEUS)


async def openapi(_: Request) -> Response:
    """What this interface is."""
    return JSONResponse(describe())


ROUTES = (
    Route("/", page),
    Route("/page/{name}", file),
    Route("/healthz", healthz),
    Route("/readyz", readyz),
    Route("/metrics", metrics),
    Route(f"{API}/openapi.json", openapi),
    Route(f"{API}/processes", processes),
    Route(f"{API}/runs", runs),
    Route(f"{API}/runs/{{run}}", run),
    *(Route(f"{API}/runs/{{run}}/{view.__name__}", once(view)) for view in (beampattern, radar, timeline)),
    Route(f"{API}/runs/{{run}}/history", once(history, by="of_courses")),
    Route(f"{API}/runs/{{run}}/particles", once(particles, by="one_at_a_time")),
    Route(f"{API}/runs/{{run}}/dwells", dwells),
    Route(f"{API}/runs/{{run}}/events", events),
    *(Route(f"{API}/runs/{{run}}/{metric}", scored) for metric in SCORED),
)


def create(core: MetricsCore, hosts: Collection[str] | None, interval_s: float) -> Starlette:
    """The application over the store of `core`, for requests to these hosts; None: any. Events come no faster."""
    handled = (Problem, BadInput, StoreFailed, HTTPException, Exception)
    app = Starlette(
        routes=ROUTES,
        middleware=[Middleware(_Guard, hosts=hosts)],
        exception_handlers=dict.fromkeys(handled, of_error),
        lifespan=_lifespan,
    )
    app.router.redirect_slashes = False
    app.state.core, app.state.encoded = core, Encoded()
    app.state.feed = Feed(core, app.state.encoded, interval_s)
    app.state.views, app.state.one_at_a_time = Shared(VIEW_S), Shared(VIEW_S, CapacityLimiter(1))
    app.state.of_courses = Shared(VIEW_S, CapacityLimiter(COURSES))
    app.state.courses, app.state.beliefs = Courses(), Beliefs()
    app.state.scraped, app.state.machines = Shared(0.0, CapacityLimiter(1)), Machines(core)
    return app


@asynccontextmanager
async def _lifespan(_: Starlette) -> AsyncIterator[None]:
    current_default_thread_limiter().total_tokens = THREADS
    yield


class Connection(H11Protocol):
    """uvicorn's, which is aborted once nothing has gone out for SEND_WITHIN_S; it would stay for ever."""

    _check: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn has it
        """Whoever writes waits until all is with the system: that alone bounds what is held for a client."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)

    def connection_lost(self, exc: Exception | None) -> None:
        """It is over."""
        self._stop()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The client reads more slowly than we write, or not at all."""
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        """It has read."""
        self._stop()
        super().resume_writing()

    def _watch(self) -> None:
        self._check = self.loop.call_later(SEND_WITHIN_S, self._let_go, self.transport.get_write_buffer_size())

    def _let_go(self, waiting: int) -> None:
        if self.transport.get_write_buffer_size() < waiting:
            self._watch()
        else:
            self.transport.abort()

    def _stop(self) -> None:
        if self._check is not None:
            self._check.cancel()
            self._check = None


class _Guard:
    """Refuses requests for other hosts, which a web page elsewhere may have been tricked into, and endless queries."""

    def __init__(self, app: ASGIApp, hosts: Collection[str] | None) -> None:
        self._app, self._hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = self._problem(scope) if scope["type"] == "http" else None
        await (problem.response() if problem else self._app)(scope, receive, send)

    def _problem(self, scope: Scope) -> Problem | None:
        if len(scope["query_string"]) > MAX_QUERY:
            return Problem(HTTPStatus.REQUEST_URI_TOO_LONG, f"the query is longer than {MAX_QUERY} bytes")
        if self._hosts is None:
            return None
        host = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"host"), "")
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() else host
        if name.lower() in self._hosts:
            return None
        return Problem(HTTPStatus.MISDIRECTED_REQUEST, f"Host: {host[:80]!r} is not served, only this machine's own")
