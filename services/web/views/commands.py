"""Commands over HTTP: what a commander asks of a run goes to the recorder, and its answer comes back by the journal."""

import asyncio
import json
import time
import uuid
from http import HTTPStatus
from typing import Any

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cogradar.services.delivery.order_book import commands_kept_free
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web.address import COMMAND_VARIABLE, Admitted
from cogradar.services.web.parameters import asked, shown_token
from cogradar.services.web.problem_documents import Problem, bad
from cogradar.services.web.run_answers import core_of, run_of, scored
from cogradar.shared.protocol.messages import Command
from cogradar.shared.protocol.words.orders import action_of, parsed

WITHIN_S = 5.0
POLL_S = 0.05
MAX_BODY = 4096  # bytes
MAX_DWELL = 2**31 - 1
_STATUS = {  # by why a run cannot be commanded
    "missing": HTTPStatus.NOT_FOUND,
    "ended": HTTPStatus.CONFLICT,
    "full": HTTPStatus.CONFLICT,
    "held": HTTPStatus.SERVICE_UNAVAILABLE,
}


_listed = scored("commands")


async def commands(request: Request) -> Response:
    """The commands of a run; with POST, one more."""
    return await (_command(request) if request.method == "POST" else run_sync(_listed, request))


async def commander(request: Request) -> Response:
    """The name that the token which is shown commands with."""
    asked(request, ())
    return JSONResponse({"name": _commander(request)}, headers={"Cache-Control": "no-store"})


async def _command(request: Request) -> Response:
    """Command a run: its row of `commands` once the recorder has granted it."""
    by, run, core = _commander(request), run_of(request), core_of(request)
    document = await _document(request)
    try:
        told = document["action"]
        action = parsed(told.split()) if isinstance(told, str) else action_of(told)
    except ValueError as error:
        raise bad(str(error)) from None
    command = Command(run=run, id=uuid.uuid4().hex, by=by, action=action, at=document.get("at", 0))
    await run_sync(_check, core, command)
    if not core.command(command):
        detail = "too many commands wait for the recorder; this one was not sent"
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, detail, {"Retry-After": "1"})
    until = time.monotonic() + WITHIN_S
    while (row := await run_sync(_row, core, command)) is None:
        if time.monotonic() > until:
            await run_sync(_check, core, command)
            detail = f"no recorder confirmed it within {WITHIN_S:.0f} s: it may still be granted; GET this address says"
            raise Problem(HTTPStatus.GATEWAY_TIMEOUT, detail)
        await asyncio.sleep(POLL_S)
    if row["state"] == "refused":
        raise Problem(HTTPStatus.CONFLICT, f"refused: {row['reason']}")
    return JSONResponse(row, HTTPStatus.CREATED, headers={"Cache-Control": "no-store"})


def _commander(request: Request) -> str:
    """The name of the client. Raises Problem."""
    admitted: Admitted = request.app.state.admitted
    if not admitted.commanders:
        detail = f"commands are disabled: start metrics with {COMMAND_VARIABLE}=NAME:TOKEN, then show the token"
        raise Problem(HTTPStatus.FORBIDDEN, f"{detail}: Authorization: Bearer TOKEN")
    shown = shown_token(request.headers)
    if not shown:
        headers = {"WWW-Authenticate": "Bearer"}
        raise Problem(HTTPStatus.UNAUTHORIZED, "a commander's token is needed: Authorization: Bearer TOKEN", headers)
    if not (name := admitted.commander(shown)):
        raise Problem(HTTPStatus.FORBIDDEN, f"this token is no commander's: {COMMAND_VARIABLE} of metrics has those")
    return name


async def _document(request: Request) -> dict[str, Any]:
    """The body: `action`, and `at`. Raises Problem."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise Problem(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "Content-Type: must be application/json")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY:
            raise Problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the body is longer than {MAX_BODY} bytes")
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):
        raise bad("the body is no JSON") from None
    if not isinstance(document, dict) or not set(document) <= {"action", "at"}:
        raise bad("the body: must be an object of action and, if not at once, at")
    if not isinstance(document.get("action"), dict | str):
        raise bad('action: must be words such as "power 0.5", or an object such as {"kind": "power", "share": 0.5}')
    at = document.get("at", 0)
    if type(at) is not int or not 0 <= at <= MAX_DWELL:
        raise bad(f"at: must be a dwell, 0 .. {MAX_DWELL}")
    return document


def _check(core: MetricsCore, command: Command) -> None:
    """Raises Problem if the run cannot be commanded."""
    for row in answer(core.store, "refusal", {"run": command.run, "kept": str(commands_kept_free(command))}):
        status = _STATUS[row["fault"]]
        raise Problem(status, row["reason"], {"Retry-After": "1"} if row["fault"] == "held" else None)


def _row(core: MetricsCore, command: Command) -> dict[str, Any] | None:
    rows = answer(core.store, "command", {"run": command.run, "id": command.id})
    return rows[0] if rows else None
