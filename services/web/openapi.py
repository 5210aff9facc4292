"""The description of this interface, OpenAPI 3.1: from the types that check its parameters and name its columns."""

from functools import cache
from importlib.metadata import version
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from cogradar.services.web import problem_documents
from cogradar.services.web.parameters import described
from cogradar.services.web.run_answers import OF_RUNS, SCORED
from cogradar.services.web.schemas import DOCUMENTS, PAGES, Processes
from cogradar.services.web.static import MEDIA_TYPES
from cogradar.services.web.views import schemas

_REF = "#/components/schemas/{model}"
_TEXTS = {
    "runs": "All runs, in the order in which they began.",
    "summary": "One row per run and target: P_D, errors, hit rate, SNR, what came late, whether the track was lost.",
    "p_d": "Probability of detection of each target.",
    "rmse": "Root mean squared errors of each track.",
    "consistency": "Normalised errors (NEES) of all tracks, in straight flight and in turns.",
    "confirmation": "How soon visible targets got a confirmed track, if their number is unknown.",
    "picture": "One row per run, of all targets together: GOSPA, completeness, spuriousness, swaps, false tracks.",
    "antennas": "One row per run and transmit antenna: power and its peak over the mean, over stored waveforms.",
    "commands": "One row per command: who asked for what, when, from which dwell on, and what became of it.",
    "tracks": "One row per run, dwell and target: truth and estimate.",
}
_FAULTS = {"400": "A parameter is not what it must be.", "503": "The store cannot be read now."}
_AT_THE_DOOR = {  # of every question, before anybody looks what it asks
    "401": "A token is needed.",
    "403": "The script of another page asks.",
    "414": "The query is too long.",
    "421": "This host is not served.",
    "429": "Too many requests from this address.",
}
_NO_COMMANDER = "Commands are disabled, the token is no commander's, or the script of another page asks."
_MISSING = {"404": "There is no such run, target, track or dwell."}
_UNCHANGED = {"304": {"description": "As If-None-Match says."}}
_ALL_RUNS = " `all` in place of a run is every run, each once."

_VIEWS: dict[str, tuple[type[BaseModel], tuple[str, ...]]] = {
    "radar": (schemas.Radar, ()),
    "dwells": (schemas.Dwells, ("dwells",)),
    "course": (schemas.Course, ("target", "track", "dwells")),
    "particles": (schemas.Particles, ("target", "track", "dwell")),
    "timeline": (schemas.Timeline, ()),
    "beampattern": (schemas.Beampattern, ("dwell",)),
}
_TEXT = {"text/plain": {"schema": {"type": "string"}}}


@cache
def describe() -> dict[str, Any]:
    """The whole document."""
    _, definitions = models_json_schema([(model, "serialization") for model in DOCUMENTS], ref_template=_REF)
    runs = "/api/v1/runs"
    paths = {
        "/": _get("The page.", {"text/html": {"schema": {"type": "string"}}}, faults={}, tagged=True),
        "/page/{name}": _file(),
        "/healthz": _get("Whether the process is up.", _json("Status"), faults={}),
        "/readyz": _get("Whether it can answer.", _json("Status"), faults={"503": "Not now; `detail` says why."}),
        "/metrics": _get("All processes, for Prometheus.", _TEXT, faults={"503": "Not now; `detail` says why."}),
        "/api/v1/openapi.json": _get("This document.", {"application/json": {"schema": {"type": "object"}}}, faults={}),
        "/api/v1/processes": _get(Processes.__doc__ or "", _json("Processes"), faults={"503": "There is no router."}),
        "/api/v1/commander": _get(
            "The name that a commander's token commands with.",
            _json("Commander"),
            faults={"400": _FAULTS["400"], "403": _NO_COMMANDER},
        ),
        runs: _get(_TEXTS["runs"], _page("runs"), OF_RUNS),
        f"{runs}/{{run}}": _get("One run.", _json("RunRow"), run=True, tagged=True),
        f"{runs}/{{run}}/events": _events(),
    }
    for name, (model, parameters) in _VIEWS.items():
        paths[f"{runs}/{{run}}/{name}"] = _get(
            model.__doc__ or "", _json(model.__name__), parameters, run=True, tagged=True
        )
    too_far = "The nearest belief that is known is too many dwells before; `detail` says what to do in Python."
    paths[f"{runs}/{{run}}/particles"]["get"]["responses"]["422"] = _problem(too_far)
    for metric, parameters in SCORED.items():
        text = _TEXTS[metric] + _ALL_RUNS
        paths[f"{runs}/{{run}}/{metric}"] = _get(text, _page(metric), parameters, run=True, tagged=True)
    paths[f"{runs}/{{run}}/commands"] |= _command()
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "cogradar",
            "version": version("cogradar"),
            "description": "What the runs of a cognitive radar have come to. Columns as in `cogradar query`.",
        },
        "paths": paths,
        "components": {"schemas": definitions["$defs"]},
    }


def _get(
    text: str,
    content: dict[str, Any],
    parameters: tuple[str, ...] = (),
    *,
    run: bool = False,
    tagged: bool = False,
    faults: dict[str, str] | None = None,
) -> dict[str, Any]:
    found = [described("run", "path")] * run + [described(name) for name in parameters]
    known = _FAULTS | (_MISSING if run else {}) if faults is None else faults
    responses: dict[str, Any] = {"200": {"description": text, "content": content}}
    responses |= _UNCHANGED if tagged else {}
    responses |= {status: _problem(what) for status, what in (_AT_THE_DOOR | known).items()}
    return {"get": {"summary": text, "parameters": found, "responses": responses}}


def _file() -> dict[str, Any]:
    media_types = {kind.partition(";")[0] for kind in MEDIA_TYPES.values()}
    faults = {"400": _FAULTS["400"], "404": "The page has no such file."}
    found = _get("A file of the page.", {kind: {} for kind in sorted(media_types)}, faults=faults, tagged=True)
    found["get"]["parameters"] = [described("name", "path")]
    return found


def _command() -> dict[str, Any]:
    text = "Command a run that goes on, with the token of a commander: its row of `commands`, once it is granted."
    faults = {
        "400": "The body is not what it must be.",
        "403": _NO_COMMANDER,
        "404": "There is no such run.",
        "409": "The run has ended, or the recorder refuses; `detail` says why.",
        "413": "The body is too long.",
        "415": "The body is not said to be JSON.",
        "503": _FAULTS["503"],
        "504": "No recorder has confirmed it.",
    }
    responses: dict[str, Any] = {"201": {"description": "It is granted.", "content": _json("CommandRow")}}
    responses |= {status: _problem(what) for status, what in (_AT_THE_DOOR | faults).items()}
    body = {"required": True, "content": _json("CommandDocument")}
    said = {"summary": text, "parameters": [described("run", "path")], "requestBody": body, "responses": responses}
    return {"post": said}


def _events() -> dict[str, Any]:
    text = (
        "The dwells of a run as server-sent events, at most ten a second: `id` is the dwell t, `data` a DwellEvent."
        " Without a last event a live run begins now and a finished one at its first dwell. `acquisition` tells of a"
        " scan before tracking, `end` that there will be no more, and `ping`, every 3 s without another, nothing."
    )
    parts = {name: {"type": "string"} for name in ("id", "event")}
    data = {"type": "string", "contentMediaType": "application/json", "description": "Without `event`: a DwellEvent."}
    event = {"type": "object", "required": ["data"], "properties": {**parts, "data": data}}
    stream = {"text/event-stream": {"schema": event}}
    found = _get(text, stream, ("last_event_id",), run=True)
    found["get"]["responses"]["204"] = {"description": "The run has ended, with that last event."}
    header = {"name": "Last-Event-ID", "in": "header", "required": False, "description": "Go on after this dwell."}
    found["get"]["parameters"].append(header | {"schema": described("last_event_id")["schema"]})
    return found


def _json(model: str) -> dict[str, Any]:
    return {"application/json": {"schema": {"$ref": _REF.format(model=model)}}}


def _page(metric: str) -> dict[str, Any]:
    rows = {"type": "array", "items": {"$ref": _REF.format(model=PAGES[metric].__name__)}}
    parts: dict[str, Any] = {
        "rows": rows,
        "next": {"type": ["string", "null"], "description": "Where the next rows are."},
    }
    if metric == "runs":
        parts["total"] = {"type": "integer", "description": "Rows of all pages together."}
    schema = {"type": "object", "required": list(parts), "additionalProperties": False, "properties": parts}
    return {"application/json": {"schema": schema}}


def _problem(text: str) -> dict[str, Any]:
    schema = {"$ref": _REF.format(model="ProblemDocument")}
    return {"description": text, "content": {problem_documents.MEDIA_TYPE: {"schema": schema}}}
