"""Metrics that also answers over HTTP: the server is a thread of its process."""

import asyncio
import logging
import socket
import threading
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web.address import (
    HERE,
    TOKEN_VARIABLE,
    Admitted,
    allowed,
    commanders,
    is_loopback,
    listen,
    token,
    url,
)

if TYPE_CHECKING:
    import uvicorn
    from starlette.applications import Starlette

INTERVAL_S = 0.1  # between the events of a stream, at least
CLOSE_WITHIN_S = 3.0  # less than a process gets to end
MAX_CONNECTIONS = 256
MAX_HEAD = 16 << 10  # bytes of a request's head
log = logging.getLogger(__name__)


class ServedMetrics(MetricsCore):
    """Metrics behind an address of HTTP, until it is closed."""

    def __init__(self, path: str, http: str) -> None:
        """`http` is what `cogradar.services.web.address.listen` takes. Raises BadInput."""
        super().__init__(path)
        listener = listen(http)
        self._server = (
            None
            if listener is None
            else Server(self, listener, hosts=allowed(listener, http), token=token(), commanders=commanders())
        )

    def close(self) -> None:
        """Close the server, then the journal."""
        if self._server is not None:
            self._server.close()
        super().close()


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """Not of an answer that was cut off because the server closes, which uvicorn takes for an error of the program."""
    return record.exc_info is None or not isinstance(record.exc_info[1], asyncio.CancelledError)


class Server:
    """Serves on a socket, in a thread with an event loop of its own."""

    def __init__(
        self,
        core: MetricsCore,
        listener: socket.socket,
        interval_s: float = INTERVAL_S,
        hosts: Collection[str] | None = HERE,
        token: str = "",
        commanders: Mapping[str, str] | None = None,
    ) -> None:
        """For requests to these hosts, None: to any; that show this token, empty: or none. Commanders by token."""
        self._admitted = Admitted(hosts, token, commanders or {}, is_limited=not is_loopback(listener))
        self._serving: tuple[Starlette, uvicorn.Server] | None = None
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, args=(core, listener, interval_s), name="http", daemon=True)
        self._thread.start()
        log.info("HTTP at %s", url(listener))
        if not (token or is_loopback(listener)):
            log.warning("HTTP is open: any client may read every run; %s asks for a token", TOKEN_VARIABLE)

    @property
    def streams(self) -> int:
        """Streams of events that are open."""
        return 0 if self._serving is None else int(self._serving[0].state.feed.streams)

    @property
    def connections(self) -> int:
        """Connections that are open."""
        return 0 if self._serving is None else len(self._serving[1].server_state.connections)

    def close(self) -> None:
        """End all streams and answers, within seconds."""
        self._is_closed = True
        if self._serving is not None:
            app, server = self._serving
            app.state.feed.is_closing = True
            server.should_exit = True
        self._thread.join(CLOSE_WITHIN_S)

    def _run(self, core: MetricsCore, listener: socket.socket, interval_s: float) -> None:
        import uvicorn  # here: a run need not wait for it, requests do

        from cogradar.services.web.app import Connection, create

        app = create(core, self._admitted, interval_s)
        config = uvicorn.Config(
            app,
            loop="asyncio",
            http=Connection,
            ws="none",
            log_config=None,
            log_level="warning",
            access_log=False,
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            h11_max_incomplete_event_size=MAX_HEAD,
            timeout_graceful_shutdown=1,
        )
        logging.getLogger("uvicorn.error").addFilter(_is_no_cancellation)
        with listener:
            self._serving = app, uvicorn.Server(config)
            if not self._is_closed:
                asyncio.run(self._serving[1].serve([listener]))
