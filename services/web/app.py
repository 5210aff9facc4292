"""The application: what is served where, and what is refused."""

import time
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from http import HTTPStatus

from anyio.to_thread import current_default_thread_limiter
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from services.errors import BadInput, StoreFailed
from services.metrics.core import MetricsCore
from services.web.beampattern import beampattern
from services.web.events import Feed, events
from services.web.openapi import describe
from services.web.parameters import MAX_QUERY
from services.web.problems import Problem, of_error
from services.web.rows import SCORED, core_of, run, runs, scored

THREADS = 4  # answers in work: they share one connection to the journal
TICK_WITHIN_S = 5.0  # a service whose main loop takes longer is not ready
API = "/api/v1"
PROMETHEUS = "text/plain; version=0.0.4; charset=utf-8"


def healthz(_: Request) -> Response:
    """Whether the process is up."""
    return JSONResponse({"status": "ok"})


def readyz(request: Request) -> Response:
    """Whether there is a journal, and the service is connected and follows it."""
    core = core_of(request)
    if not core.is_open:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "there is no journal yet")
    if core.tick_s is None or time.monotonic() - core.tick_s > TICK_WITHIN_S:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not connected to a router, or too busy to follow the journal")
    return JSONResponse({"status": "ok"})


def metrics(request: Request) -> Response:
    """All processes, for Prometheus."""
    scrape = core_of(request).scrape
    if scrape is None:
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not connected to a router")
    return Response(scrape(), media_type=PROMETHEUS)


def openapi(_: Request) -> Response:
    """What this interface is."""
    return JSONResponse(describe())


ROUTES = (
    Route("/healthz", healthz),
    Route("/readyz", readyz),
    Route("/metrics", metrics),
    Route(f"{API}/openapi.json", openapi),
    Route(f"{API}/runs", runs),
    Route(f"{API}/runs/{{run}}", run),
    Route(f"{API}/runs/{{run}}/beampattern", beampattern),
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
    app.state.core, app.state.feed = core, Feed(core, interval_s)
    return app


@asynccontextmanager
async def _lifespan(_: Starlette) -> AsyncIterator[None]:
    current_default_thread_limiter().total_tokens = THREADS
    yield


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
