"""What is wrong with a document, one line per fault: the key, its value, and what may stand there."""

import reprlib
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

Loc = Sequence[int | str]  # path of a value: keys, and indices into lists

MAX_EXPLAINED = 20  # faults of one document
_NOUN = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "an integer",
    "number": "a number",
    "object": "a table",
    "string": "a string",
}
_LIMIT = {  # of a JSON schema
    "minimum": ">= {}",
    "exclusiveMinimum": "> {}",
    "maximum": "<= {}",
    "exclusiveMaximum": "< {}",
    "minItems": "at least {} long",
    "maxItems": "at most {} long",
    "maxLength": "at most {} characters long",
    "pattern": "matching {}",
}


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Explain the first error that `model` found, and say how many more there are."""
    more = error.error_count() - 1
    return explain_all(error, model)[0] + (f" (and {more} more)" if more else "")


def explain_all(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Explain every error that `model` found, a line each; of very many the first ones, and how many more there are."""
    # A misspelt key is both missing and unknown: the unknown one is what its author must see.
    errors = sorted(error.errors(include_url=False), key=lambda item: item["type"] != "extra_forbidden")
    lines = [_explained(item, model) for item in errors[:MAX_EXPLAINED]]
    more = len(errors) - len(lines)
    return [*lines, f"and {more} more"] if more else lines


def _explained(error: ErrorDetails, model: type[BaseModel]) -> str:
    kind, loc, value = error["type"], error["loc"], error["input"]
    shown = "" if kind == "missing" or isinstance(value, dict) else f" = {_shown(value)}"
    match kind:
        case "extra_forbidden":
            text = f"unknown key, must be one of {', '.join(_schema_at(loc[:-1], model)['properties'])}"
        case "missing":
            text = f"missing, {_allowed(_schema_at(loc, model))}"
        case "invalid_key":
            loc, shown, text = loc[:-1], "", f"keys must be strings, not {_shown(value)}"
        case "value_error":
            text = error["msg"].removeprefix("Value error, ")
        case _:
            text = _allowed(_schema_at(loc, model))
    prefix = f"{_key(loc)}{shown}: " if loc else ""
    return printable(f"{prefix}{text}")


def printable(text: str) -> str:
    """Keep it one line that a terminal shows as it is, whatever a key or a file name holds."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _key(loc: Loc) -> str:
    """`array.n_tx`; `targets #2, state`: entries of a list count from 1."""
    key = ""
    for part in loc:
        if isinstance(part, int):
            key += f" #{part + 1},"
        else:
            key += f" {part}" if key.endswith(",") else f".{part}" if key else part
    return key.removesuffix(",")


def _shown(value: object) -> str:
    short = reprlib.Repr()
    short.maxlevel, short.maxstring, short.maxother, short.maxlong = 2, 60, 60, 60
    try:
        return short.repr(value)
    except ValueError:  # Python prints no integer of thousands of digits
        return "(too large to show)"


def _schema_at(loc: Loc, model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of the value at `loc`."""
    root: dict[str, Any] = model.model_json_schema()
    schema = root
    for part in loc:
        schema = schema["items"] if isinstance(part, int) else schema["properties"][part]
        if "anyOf" in schema:  # of something or nothing
            schema = schema["anyOf"][0]
        if "$ref" in schema:
            schema = root["$defs"][schema["$ref"].rsplit("/", 1)[-1]]
    return schema


def _allowed(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return f"must be one of {', '.join(schema['enum'])}"
    limits = [text.format(schema[name]) for name, text in _LIMIT.items() if name in schema]
    return f"must be {_NOUN[schema['type']]} {' and '.join(limits)}".rstrip()
