"""Work that is done once for all equal requests: streams, scrapes, views."""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from functools import wraps
from typing import Any

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import Response

KEPT = 64  # results
VIEW_S = 0.5  # how long a view is given again


class Shared:
    """Work done in threads, once for all equal requests. Results are kept for some time after."""

    def __init__(self, for_s: float, limiter: CapacityLimiter | None = None) -> None:
        """`limiter` has the threads; without it, the threads of all answers are used."""
        self._for_s, self._limiter = for_s, limiter
        self._results: OrderedDict[Any, tuple[float, asyncio.Future[Any]]] = OrderedDict()

    async def get(self, key: Any, work: Callable[[], Any]) -> Any:
        """Result of `work`, which `key` stands for."""
        now = asyncio.get_running_loop().time()
        until, result = self._results.get(key, (0.0, None))
        if result is None or (result.done() and (until <= now or result.cancelled() or result.exception())):
            result = asyncio.ensure_future(to_thread.run_sync(work, limiter=self._limiter))
            self._results[key] = (now + self._for_s, result)
            self._results.move_to_end(key)
            if len(self._results) > KEPT:
                self._results.popitem(last=False)
        return await asyncio.shield(result)


def once(view: Callable[[Request], Response], by: str = "views") -> Callable[[Request], Awaitable[Response]]:
    """A view that is made once for all equal requests at the same time; `by` names the application's Shared."""

    @wraps(view)
    async def answered(request: Request) -> Response:
        shared: Shared = getattr(request.app.state, by)
        key = (request.app.state.core.store, str(request.url), request.headers.get("if-none-match"))
        found: Response = await shared.get(key, lambda: view(request))
        return found

    return answered
