"""Questions over HTTP: runs, and what metrics answers about them, in pages."""

import hashlib
import json
from collections.abc import Callable
from functools import cache, wraps
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlencode

from pydantic_core import to_json
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cogradar.services.metrics.answers import answer, count
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.queries import run_row
from cogradar.services.metrics.selection import ALL, PARAMETERS
from cogradar.services.metrics.store import Store
from cogradar.services.web.parameters import MAX_ROWS, asked, checked
from cogradar.services.web.problem_documents import bad, missing

OF_RUNS = tuple(name for name in PARAMETERS if name not in {"target", "dwells"})
OF_SCORES = tuple(name for name in PARAMETERS if name != "run")
OF_PICTURES = tuple(name for name in OF_SCORES if name not in {"target", "dwells"})
# Metrics with an address of their own, and what they may be asked.
SCORED = dict.fromkeys(("summary", "p_d", "rmse", "consistency", "tracks"), OF_SCORES) | dict.fromkeys(
    ("confirmation", "picture", "commands"), OF_PICTURES
)
SCORED["commands"] += ("state",)
SCORED["antennas"] = tuple(name for name in OF_SCORES if name != "target")
_FINISHED = ("complete", "stopped", "failed")
_ROOT = Path(__file__).resolve().parents[2]
_ROOMS = ("services/metrics", "services/web", "shared")  # whose program makes the answers


class Question(NamedTuple):
    """What is asked about a run."""

    run: str
    parameters: dict[str, str]
    store: Store
    headers: dict[str, str]  # of the answer; made before it, since a run may end between them


def about_run(*names: str) -> Callable[[Callable[[Request, Question], Response]], Callable[[Request], Response]]:
    """A view of the run in the path with these parameters: 304 if the asker has the answer already."""

    def decorated(view: Callable[[Request, Question], Response]) -> Callable[[Request], Response]:
        @wraps(view)
        def answered(request: Request) -> Response:
            parameters, run = asked(request, names), run_of(request)
            headers = _headers_of(request, run)
            if is_known(request, headers.get("ETag", "")):
                return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
            return view(request, Question(run, parameters, core_of(request).store, headers))

        return answered

    return decorated


def runs(request: Request) -> Response:
    """All runs."""
    return _page(request, "runs", asked(request, OF_RUNS))


@about_run()
def run(request: Request, question: Question) -> Response:
    """One run."""
    if question.run == ALL:
        raise bad(f"run = {ALL!r}: one run, or {request.url.path.rpartition('/')[0]} for all of them")
    rows = answer(question.store, "runs", {"run": question.run})
    if not rows:
        raise missing(f"run = {question.run!r}: no such run")
    return JSONResponse(rows[0], headers=question.headers)


def scored(metric: str) -> Callable[[Request], Response]:
    """The view of one of SCORED, about a run or about all of them."""

    @about_run(*SCORED[metric])
    def view(request: Request, question: Question) -> Response:
        return _page(request, metric, question.parameters | {"run": question.run}, question.headers)

    return view


def core_of(request: Request) -> MetricsCore:
    """Whom the service asks."""
    core: MetricsCore = request.app.state.core
    return core


def run_of(request: Request) -> str:
    """Name of the run in the path. Raises Problem if it is none."""
    return checked("run", request.path_params["run"])


def _page(request: Request, metric: str, parameters: dict[str, str], headers: dict[str, str] | None = None) -> Response:
    """Rows of a metric, as many as are asked for at most, and where the next ones are."""
    limit, offset = int(parameters.get("limit", MAX_ROWS)), int(parameters.get("offset", 0))
    one_more = parameters | {"limit": str(limit + 1)}  # are there any left?
    rows = answer(core_of(request).store, metric, one_more)
    following = None
    if len(rows) > limit:
        query = dict(request.query_params) | {"limit": str(limit), "offset": str(offset + limit)}
        following = f"{request.url.path}?{urlencode(query)}"
    link = {"Link": f'<{following}>; rel="next"'} if following else {}
    body: dict[str, Any] = {"rows": rows[:limit], "next": following}
    if metric == "runs":
        body["total"] = count(core_of(request).store, parameters)
    # By pydantic: five times as fast, the same numbers.
    kept = headers or {"Cache-Control": "no-store"}
    return Response(to_json(body), headers=kept | link, media_type="application/json")


def is_known(request: Request, tag: str) -> bool:
    """Whether the client already has the answer with this tag; `*` matches no tag."""
    return tag in {
        known.strip().removeprefix("W/") for known in request.headers.get("if-none-match", "").split(",")
    } - {""}


def _headers_of(request: Request, name: str) -> dict[str, str]:
    """A tag for answers about a run that has ended: they stay what they are as long as the program does."""
    row = run_row(core_of(request).store, name) if name != ALL else None
    if row is None or row["status"] not in _FINISHED:
        return {"Cache-Control": "no-store"}
    asked_for = [_answered_by(), row, request.url.path, request.url.query]
    tag = hashlib.sha256(json.dumps(asked_for, sort_keys=True).encode()).hexdigest()[:32]
    return {"Cache-Control": "no-cache", "ETag": f'"{tag}"'}


@cache
def _answered_by() -> str:
    """Digest of the program."""
    digest = hashlib.sha256()
    for source in sorted(source for room in _ROOMS for source in (_ROOT / room).rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()
