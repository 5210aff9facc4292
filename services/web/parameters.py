"""What may be asked for in a URL: each parameter's type, which is both checked and described."""

from collections.abc import Collection, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter
from starlette.requests import Request

from cogradar.services.web.problem_documents import bad, missing
from cogradar.shared.protocol.fields import MAX_SIDE, RunId
from cogradar.shared.scenario.faults import allowed
from cogradar.shared.scenario.radar_config import Strategy

MAX_ROWS = 1000  # of a page
MAX_QUERY = 2048  # bytes
COOKIE = "cogradar"  # with the token of the page
_MAX_DWELL = 2**31 - 1

_TYPES: dict[str, tuple[Any, str]] = {
    "run": (RunId, "Only this run."),
    "scenario": (Annotated[str, Field(min_length=1, max_length=64)], "Only runs of this scenario."),
    "strategy": (Strategy, "Only runs of this strategy."),
    "seed": (Annotated[int, Field(ge=0, lt=2**63)], "Only runs with this seed."),
    "target": (Annotated[int, Field(ge=1, le=MAX_SIDE)], "Only this target, counted from 1."),
    "track": (Annotated[int, Field(ge=1, lt=2**31)], "Only this track, counted from 1, where their number is unknown."),
    "dwells": (
        Annotated[
            str,
            Field(
                pattern=r"^[0-9]{0,9}:[0-9]{0,9}$",
                description="a:b, first and last dwell, either may be empty",
            ),
        ],
        "First and last dwell, a:b, both included; either may be left out.",
    ),
    "limit": (Annotated[int, Field(ge=1, le=MAX_ROWS)], f"Rows of a page; {MAX_ROWS} if left out."),
    "offset": (Annotated[int, Field(ge=0, lt=2**53)], "Rows before the page."),
    "state": (Literal["open"], "Only commands that are in force or will be: at most 80 of a run."),
    "dwell": (Annotated[int, Field(ge=1, le=_MAX_DWELL)], "This dwell; the newest if left out."),
    "name": (RunId, "Of a file of the page."),
    "last_event_id": (
        Annotated[int, Field(ge=0, le=_MAX_DWELL)],
        "Go on with the dwell after this one; like the header Last-Event-ID, which comes first.",
    ),
}
_CHECKS: dict[str, TypeAdapter[Any]] = {name: TypeAdapter(type_) for name, (type_, _) in _TYPES.items()}


def asked(request: Request, names: Collection[str]) -> dict[str, str]:
    """The parameters in the URL. Raises Problem for one that is unknown, repeated, or not what it must be."""
    found: dict[str, str] = {}
    for name, text in request.query_params.multi_items():
        if name not in names:
            raise bad(f"{name}: unknown parameter, must be one of {', '.join(names)}" if names else f"{name}: unknown")
        if name in found:
            raise bad(f"{name}: given twice")
        found[name] = checked(name, text)
    return found


def one_of(parameters: Collection[str], *names: str) -> str:
    """Which of these is given. Raises Problem unless it is one."""
    given = [name for name in names if name in parameters]
    if len(given) != 1:
        raise missing(f"{', '.join(names)}: one of them must be given")
    return given[0]


def checked(name: str, text: str) -> str:
    """A parameter's text, if it is what it must be. Raises Problem."""
    is_number = schema(name).get("type") == "integer"
    try:
        if is_number and not (text.isascii() and text.isdecimal() and len(text) <= 20):
            raise ValueError
        _CHECKS[name].validate_python(text)
    except ValueError:  # pydantic's is one
        raise bad(f"{name} = {text[:40]!r}: {allowed(schema(name))}") from None
    first, _, last = text.partition(":")
    if name == "dwells" and first and last and int(first) > int(last):
        raise bad(f"dwells = {text!r}: the first must not be after the last")
    return text


def schema(name: str) -> dict[str, Any]:
    """A parameter's JSON schema."""
    return _CHECKS[name].json_schema()


def described(name: str, where: str = "query") -> dict[str, Any]:
    """A parameter as OpenAPI has it."""
    head = {"name": name, "in": where, "required": where == "path", "schema": schema(name)}
    return {**head, "description": _TYPES[name][1]}


def shown_token(headers: Mapping[str, str]) -> str:
    """The token that a request shows, by its headers; empty: none."""
    scheme, _, given = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return given.strip()
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return "" if cookie is None else cookie.value
