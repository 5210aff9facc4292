"""The application: what is served where, what is refused, and which clients are let go."""

import asyncio
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from http import HTTPStatus
from urllib.parse import parse_qs

import h11
from anyio import CapacityLimiter
from anyio.to_thread import current_default_thread_limiter
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import page as page_of
from cogradar.services.web.address import Admitted
from cogradar.services.web.events import Feed, events
from cogradar.services.web.openapi import describe
from cogradar.services.web.parameters import COOKIE, MAX_QUERY, shown_token
from cogradar.services.web.problem_documents import API, Problem, of_error
from cogradar.services.web.run_answers import SCORED, core_of, run, runs, scored
from cogradar.services.web.shared import VIEW_S, Shared, once
from cogradar.services.web.static import file, page
from cogradar.services.web.views.beampattern import beampattern
from cogradar.services.web.views.commands import commander, commands
from cogradar.services.web.views.course import Courses, course
from cogradar.services.web.views.dwells import Encoded, dwells
from cogradar.services.web.views.particles import Beliefs, particles
from cogradar.services.web.views.processes import Machines, processes
from cogradar.services.web.views.radar import radar
from cogradar.services.web.views.timeline import timeline

THREADS = 4  # answers in work: they share one connection to the journal
COURSES = (
    2  # courses of targets and tracks in work, in threads of their own: the first look at a long run takes seconds
)
TICK_WITHIN_S = 5.0  # a service whose main loop takes longer is not ready
SEND_WITHIN_S = 30.0  # some part of what waits for a client, or it is let go
HEAD_WITHIN_S = 10.0  # the head of a request, or the connection is let go
RATE_HZ, BURST = 100.0, 300.0  # requests from one address elsewhere
MAX_ADDRESSES = 1000  # counted apart
UNASKED = ("/healthz", "/readyz")  # that need no token: supervisors ask them, and they tell nothing
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
    return JSONResponse({"status": core.trouble or core.silence or "ok"})


async def metrics(request: Request) -> Response:
    """All processes, for Prometheus: they are asked once for all requests meanwhile, which may take seconds."""
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
    Route(f"{API}/commander", commander),
    Route(f"{API}/runs", runs),
    Route(f"{API}/runs/{{run}}", run),
    *(Route(f"{API}/runs/{{run}}/{view.__name__}", once(view)) for view in (beampattern, radar, timeline)),
    Route(f"{API}/runs/{{run}}/course", once(course, by="of_courses")),
    Route(f"{API}/runs/{{run}}/particles", once(particles, by="one_at_a_time")),
    Route(f"{API}/runs/{{run}}/dwells", dwells),
    Route(f"{API}/runs/{{run}}/events", events),
    *(Route(f"{API}/runs/{{run}}/{metric}", scored(metric)) for metric in SCORED if metric != "commands"),
    Route(f"{API}/runs/{{run}}/commands", commands, methods=["GET", "POST"]),
)


def create(core: MetricsCore, admitted: Admitted | None, interval_s: float) -> Starlette:
    """The application over the store of `core`, for whom it is; None: for everybody. Events come no faster."""
    handled = (Problem, BadInput, StoreFailed, HTTPException, Exception)
    app = Starlette(
        routes=ROUTES,
        middleware=[Middleware(_Guard, admitted=admitted or Admitted(hosts=None))],
        exception_handlers=dict.fromkeys(handled, of_error),
        lifespan=_lifespan,
    )
    app.router.redirect_slashes = False
    app.state.core, app.state.encoded, app.state.admitted = core, Encoded(), admitted or Admitted()
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
    """uvicorn's, which is aborted once nothing has gone out for SEND_WITHIN_S, or half a request came and no more for
    HEAD_WITHIN_S; it would stay for ever.
    """

    _check: asyncio.TimerHandle | None = None
    _head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn has it
        """Writers block until the kernel has taken all bytes: that alone bounds what is held for a client."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)
        self._await_head()

    def data_received(self, data: bytes) -> None:
        """Part of a request, or several."""
        super().data_received(data)
        if self._head is None and self.conn.their_state is h11.IDLE:
            self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is over."""
        self._stop()
        if self._head is not None:
            self._head.cancel()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The client reads more slowly than we write, or not at all."""
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        """It has read."""
        self._stop()
        super().resume_writing()

    def _await_head(self) -> None:
        self._head = self.loop.call_later(HEAD_WITHIN_S, self._has_head)

    def _has_head(self) -> None:
        self._head = None
        if self.conn.their_state is h11.IDLE and (self.cycle is None or self.cycle.response_complete):
            self.transport.abort()

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
    """Refuses requests for other hosts, which a web page elsewhere may have been tricked into, requests from other
    pages or without the token, too many requests, and endless queries.
    """

    def __init__(self, app: ASGIApp, admitted: Admitted) -> None:
        self._app, self._admitted = app, admitted
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()  # requests of an address, and as of when

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer = self._answer(scope) if scope["type"] == "http" else None
        await (answer or self._app)(scope, receive, send)

    def _answer(self, scope: Scope) -> Response | None:
        """What is answered in place of the application: a problem, or the way to the page with a token shown."""
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in reversed(scope["headers"])}
        try:
            self._check(scope, headers)
        except Problem as problem:
            return problem.response()
        shown = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if scope["path"] == "/" and self._admitted.is_known(shown):
            way = RedirectResponse("/", HTTPStatus.SEE_OTHER, {"Cache-Control": "no-store"})
            way.set_cookie(COOKIE, shown, httponly=True, samesite="strict", secure=scope["scheme"] == "https")
            return way
        if scope["path"] in UNASKED or not self._admitted.token or self._admitted.is_known(shown_token(headers)):
            return None
        detail = "a token is needed: Authorization: Bearer TOKEN, or the page with ?token=TOKEN"
        return Problem(HTTPStatus.UNAUTHORIZED, detail, {"WWW-Authenticate": "Bearer"}).response()

    def _check(self, scope: Scope, headers: Mapping[str, str]) -> None:
        """Raise Problem for an invalid or forbidden request."""
        if len(scope["query_string"]) > MAX_QUERY:
            raise Problem(HTTPStatus.REQUEST_URI_TOO_LONG, f"the query is longer than {MAX_QUERY} bytes")
        host, hosts = headers.get("host", ""), self._admitted.hosts
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() else host
        if hosts is not None and name.lower() not in hosts:
            detail = f"Host: {host[:80]!r} is not served, only this machine's own"
            raise Problem(HTTPStatus.MISDIRECTED_REQUEST, detail)
        origin = headers.get("origin", "")
        if origin and origin.lower().partition("//")[2] != host.lower():
            raise Problem(HTTPStatus.FORBIDDEN, f"Origin: {origin[:80]!r} is another page's")
        if self._admitted.is_limited and not self._has_left(str((scope["client"] or ("",))[0])):
            detail = f"more than {RATE_HZ:.0f} requests a second from this address"
            raise Problem(HTTPStatus.TOO_MANY_REQUESTS, detail, {"Retry-After": "1"})

    def _has_left(self, address: str) -> bool:
        """Whether an address may ask once more, by a bucket of BURST requests that fills with RATE_HZ."""
        now = time.monotonic()
        left, since = self._left.get(address, (BURST, now))
        left = min(BURST, left + (now - since) * RATE_HZ) - 1.0
        self._left[address] = max(left, -1.0), now
        self._left.move_to_end(address)
        if len(self._left) > MAX_ADDRESSES:
            self._left.popitem(last=False)
        return left >= 0.0
