"""Server-sent events: the dwells of a run, live and from the journal alike.

A stream is a cursor on the journal and the few dwells that were read from there last. A client that reads slowly holds
no more, and `cogradar.services.web.app.Connection` lets go of one that does not read at all. Clients at the same dwell
share what is read for them.
"""

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.selection import ALL
from cogradar.services.web.parameters import asked, checked
from cogradar.services.web.problem_documents import Problem, bad, missing
from cogradar.services.web.run_answers import run_of
from cogradar.services.web.shared import Shared
from cogradar.services.web.views import dwells

BEHIND: Final = 16  # dwells that a live stream may lag before it goes on with the newest
MAX_STREAMS = 100
PING_S = 3.0  # without an event; a page counts on three in its `SILENT_MS`
STATE_FOR_S = 0.05  # how long it may be old
PING = b"event: ping\ndata: {}\n\n"  # an event and no comment, which a browser would keep to itself


@dataclass
class Feed:
    """What all streams share."""

    core: MetricsCore
    encoded: dwells.Encoded
    interval_s: float  # between the events of a stream
    is_closing: bool = False  # all streams are to end
    streams: int = 0
    _states: Shared = field(default_factory=lambda: Shared(STATE_FOR_S))
    _dwells: Shared = field(default_factory=lambda: Shared(60.0))

    async def state(self, run: str) -> dwells.State | None:
        """How far a run is, or was a moment ago."""
        store = self.core.store
        found: dwells.State | None = await self._states.get((store, run), lambda: dwells.state(store, run))
        return found

    async def following(self, run: str, t: int, newest: int) -> list[tuple[int, bytes]]:
        """The next dwells after dwell t, of which `newest` is the last one that there can be."""
        store = self.core.store
        key = (store, run, t, min(newest, t + dwells.AT_ONCE))
        found: list[tuple[int, bytes]] = await self._dwells.get(key, lambda: dwells.events(store, self.encoded, run, t))
        return found

    async def acquisition(self, run: str, k: int) -> bytes:
        """Scan k."""
        store = self.core.store
        found: bytes = await self._dwells.get(
            (store, run, -1, k), lambda: dwells.acquisition(store, self.encoded, run, k)
        )
        return found


async def events(request: Request) -> Response:
    """The dwells of a run: from the one after Last-Event-ID on, without a gap until the newest is reached; else the
    newest, or of a run that has ended all of them.
    """
    parameters, run = asked(request, ("last_event_id",)), run_of(request)
    if run == ALL:
        raise bad("run = 'all': events are of one run")
    text = request.headers.get("last-event-id")
    given = parameters.get("last_event_id") if text is None else checked("last_event_id", text)
    feed: Feed = request.app.state.feed
    now = await feed.state(run)
    if now is None:
        raise missing(f"run = {run!r}: no such run")
    if given is not None and int(given) >= now.t and now.status != "running":
        return Response(status_code=HTTPStatus.NO_CONTENT)  # an EventSource asks no more
    is_live = given is None and now.status == "running"
    after = int(given) if given is not None else max(0, now.t - 1) if is_live else 0
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    if request.method == "HEAD":
        return Response(headers=headers, media_type="text/event-stream")
    return EventStream(feed, _dwells(feed, run, after, is_live=is_live), headers)


class EventStream(StreamingResponse):
    """A stream of events, one of at most MAX_STREAMS."""

    def __init__(self, feed: Feed, content: AsyncIterator[bytes], headers: dict[str, str]) -> None:
        super().__init__(content, headers=headers, media_type="text/event-stream")
        self._feed = feed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until the client, the run or the service ends."""
        if self._feed.streams >= MAX_STREAMS:
            text = f"{MAX_STREAMS} streams of events are open, and no more are served"
            busy = Problem(HTTPStatus.SERVICE_UNAVAILABLE, text, {"Retry-After": "5"})
            await busy.response()(scope, receive, send)
            return
        self._feed.streams += 1
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._feed.streams -= 1


async def _dwells(feed: Feed, run: str, t: int, *, is_live: bool) -> AsyncIterator[bytes]:
    """The events after dwell t."""
    loop = asyncio.get_running_loop()
    waiting: deque[tuple[int, bytes]] = deque()
    seen_k, quiet_since, due = -1, loop.time(), loop.time()
    while not feed.is_closing:
        now = await feed.state(run)
        if now is None:  # dropped from the journal meanwhile
            yield _event({"run": run, "status": "dropped", "reason": "", "t": t}, "end")
            return
        is_live = is_live or t >= now.t  # it has caught up
        if is_live and now.t - t > BEHIND:
            t = now.t - 1
            waiting.clear()
        if not waiting and now.t > t:
            waiting.extend(await feed.following(run, t, now.t))
        text = None
        if waiting:
            t, text = waiting.popleft()
        elif now.status != "running":
            yield _event({"run": run, "status": now.status, "reason": now.reason, "t": now.t}, "end")
            return
        elif now.t == 0 and now.k - 1 > seen_k:
            seen_k = now.k - 1
            text = await feed.acquisition(run, seen_k)
        elif loop.time() - quiet_since > PING_S:
            text = PING
        if text is not None:
            yield text
            quiet_since = loop.time()
        # A delay is made up for by half an interval, or a stream would fall behind a run of its own rate.
        # A live one that lags catches up at twice the rate: a run of just this rate would stay ahead of it for good.
        interval_s = feed.interval_s * (0.5 if is_live and now.t - t > 1 else 1.0)
        due = max(due + interval_s, loop.time() - 0.5 * feed.interval_s)
        await asyncio.sleep(due - loop.time())


def _event(data: dict[str, Any], name: str) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n".encode()
