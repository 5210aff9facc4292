"""What is wrong with a document, one line per fault: the key, its value, and what may stand there."""

import re
import reprlib
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches
from functools import cache
from itertools import islice
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

Loc = Sequence[int | str]  # path of a value: keys, and indices into lists

_NUMBER = re.compile(r"\s*([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*[^\W\d_]{0,8}\s*")
MAX_EXPLAINED = 20  # faults of one document that have a line each; to explain one takes a fifth of a millisecond
MAX_FURTHER = 250  # entries of a list after the first wrong one that are looked at
MAX_SHOWN = 60  # characters of a key
PRINTED_BITS = 13_000  # of an integer: with more than 4300 digits Python refuses to print it, or prints something else
_SHORT = {"--rule": "radar.planner.rule"}  # options that are short for one key
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
}


class Fault(NamedTuple):
    """One thing that is wrong with a document."""

    loc: Loc
    value: str  # " = 3", or nothing if that would say nothing
    text: str  # what may stand there

    def __str__(self) -> str:
        prefix = f"{_key(self.loc)}{self.value}: " if self.loc else ""
        return printable(f"{prefix}{self.text}")

    def given_by(self, source: str) -> str:
        """The line that names `source`, a file, or a setting which may say key and value itself."""
        option, _, given = source.partition(" ")
        key = _dotted(self.loc)
        is_said = (source.startswith("--") and given.startswith(f"{key}=")) or _SHORT.get(option) == key
        return printable(f"{source}: {self.text if is_said else self}")


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Explain the first error that `model` found, and say how many more there are."""
    more = error.error_count() - 1
    return str(faults(error, model)[0]) + (f" (and {more} more)" if more else "")


def faults(
    error: ValidationError, model: type[BaseModel], document: Any = None, order: Callable[[Loc], Any] | None = None
) -> list[Fault]:
    """All that `model` found: the first MAX_EXPLAINED + 1 with an explanation, the others with their place alone.

    document : in which it was found; with it, entries of lists after the first wrong one are looked at, too
    order    : of places; None: unknown keys first
    """
    found = error.errors(include_url=False, include_context=False)
    found += _further(found, document, model)
    # A misspelt key is both missing and unknown: the unknown one is what its author must see.
    errors = sorted(found, key=lambda item: order(item["loc"]) if order else item["type"] != "extra_forbidden")
    explained: dict[Fault, None] = {}  # each alternative of a value has an error
    while errors and len(explained) <= MAX_EXPLAINED:
        explained.setdefault(_fault(errors.pop(0), model))
    return [*explained, *(Fault(item["loc"], " = ...", "") for item in errors)]


def _further(
    errors: Sequence[ErrorDetails], value: Any, model: type[BaseModel], loc: tuple[int | str, ...] = ()
) -> Iterator[ErrorDetails]:
    """Errors of the list entries behind the first wrong one, where the model stops to save time."""
    for key, field in model.model_fields.items() if isinstance(value, dict) else ():
        place, inner = (*loc, key), value.get(key)
        here = [error for error in errors if error["loc"][: len(place)] == place]
        kinds = (field.annotation, *get_args(field.annotation))
        kind = next((one for one in kinds if isinstance(one, type) and issubclass(one, BaseModel)), None)
        if not here or kind is None:
            continue
        if not isinstance(inner, list):
            yield from _further(here, inner, kind, place)
            continue
        most = max((limit.max_length for limit in field.metadata if hasattr(limit, "max_length")), default=0)
        wrong = [n for error in here for n in error["loc"][len(place) :][:1] if isinstance(n, int)]
        later = islice(range(max(wrong), len(inner)), MAX_FURTHER) if wrong and len(inner) <= most else ()
        for i in later:
            fresh = [error for error in here if error["loc"][len(place)] == i]
            if i > max(wrong):
                fresh = _errors_of(inner[i], kind, (*place, i))
                yield from fresh
            yield from _further(fresh, inner[i], kind, (*place, i))


def _errors_of(value: Any, model: type[BaseModel], loc: tuple[int | str, ...]) -> list[ErrorDetails]:
    try:
        model.model_validate(value)
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False)
        return [{**item, "loc": (*loc, *item["loc"])} for item in found]
    return []


def unknown_keys(document: Any, model: type[BaseModel]) -> tuple[list[Fault], int]:
    """The first MAX_EXPLAINED unknown keys of a document, and one more, and how many there are.

    They are counted without an error for each, which takes a microsecond and some memory.
    """
    found, n = list[Fault](), 0
    for loc, table, known in _tables(document, _schema(model), (), model):
        unknown = [key for key in table if key not in known] if len(table.keys() - known) else []
        n += len(unknown)
        for key in unknown[: MAX_EXPLAINED + 1 - len(found)]:
            found.append(_unknown((*loc, str(key)), model)._replace(value=_said(table[key])))
    return found, n


def _tables(
    value: Any, schema: dict[str, Any], loc: tuple[int | str, ...], model: type[BaseModel]
) -> Iterator[tuple[tuple[int | str, ...], dict[Any, Any], Any]]:
    """Each table within a value that may have no other keys: its path, itself, the keys that there are."""
    schema = _resolved(schema, model)
    if isinstance(value, dict) and "properties" in schema:
        known = schema["properties"]
        yield loc, value, known.keys()
        for key, inner in known.items():
            if isinstance(value.get(key), dict | list):
                yield from _tables(value[key], inner, (*loc, key), model)
    elif isinstance(value, list) and len(value) <= schema.get("maxItems", 0) and "items" in schema:
        items = _resolved(schema["items"], model)
        for i, entry in enumerate(value if "properties" in items else ()):
            yield from _tables(entry, items, (*loc, i), model)


def _fault(error: ErrorDetails, model: type[BaseModel]) -> Fault:
    kind, loc, value = error["type"], error["loc"], error["input"]
    while kind != "extra_forbidden" and loc and _alternatives(loc[:-1], model):
        loc = loc[:-1]  # the last part says which alternative it is the error of
    shown = "" if kind == "missing" else _said(value)
    match kind:
        case "extra_forbidden":
            return _unknown(loc, model)._replace(value=shown)
        case "missing":
            text = f"missing, {allowed(_schema_at(loc, model))}"
        case "invalid_key":
            loc, shown, text = loc[:-1], "", f"keys must be strings, not {_shown(value)}"
        case "value_error":
            text = plain(error)
        case _:
            schema = _schema_at(loc, model)
            text = allowed(schema) + _without_unit(schema, value)
    return Fault(loc, shown, text)


def _unknown(loc: Loc, model: type[BaseModel]) -> Fault:
    known = ", ".join(_schema_at(loc[:-1], model)["properties"])
    return Fault(loc, "", f"unknown key{_nearest(loc, model)}, must be one of {known}")


def _without_unit(schema: dict[str, Any], value: object) -> str:
    """The cure for a number that is written as a text, such as "72 dB"; nothing for anything else."""
    if schema.get("type") not in ("number", "integer") or not isinstance(value, str):
        return ""
    found = _NUMBER.fullmatch(value[:40])
    return f"; write {found[1]}, without quotes and unit" if found else ""


def _nearest(loc: Loc, model: type[BaseModel]) -> str:
    """The key that was probably meant: a similar one in the same table, else one of that name elsewhere."""
    last = str(loc[-1])
    if len(last) > MAX_SHOWN:
        return ""
    siblings = list(_schema_at(loc[:-1], model)["properties"])
    if close := get_close_matches(last, siblings, n=1):
        found = [_dotted([*loc[:-1], close[0]])]
    else:
        paths = _paths(model)
        found = [paths[name] for name in get_close_matches(last, paths, n=1, cutoff=0.8)]
    return f" (did you mean {found[0]}?)" if found else ""


@cache
def _paths(model: type[BaseModel]) -> dict[str, str]:
    """Dotted keys by their last part, of all that is no list's entry."""
    found: dict[str, str] = {}
    todo: list[Loc] = [()]
    while todo:
        loc = todo.pop(0)
        for key in _schema_at(loc, model).get("properties", ()):
            found[key] = _dotted([*loc, key])
            todo.append([*loc, key])
    return found


@cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def _dotted(loc: Loc) -> str:
    """`world.targets.2.state`, as a setting has it."""
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in loc)


def printable(text: str) -> str:
    """Keep it one line that a terminal shows as it is, whatever a key or a file name holds."""
    return "".join(c if c.isprintable() else "?" for c in text)


def printable_lines(text: str) -> str:
    """The same of several lines: what others said may hold what moves a terminal's cursor or renames its window."""
    return "\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n"))


def listed(names: Sequence[str], most: int) -> str:
    """Names with commas, the first ones of many and how many more there are: never one, which is as short to name."""
    shown = names if len(names) <= most + 1 else names[:most]
    return ", ".join(shown) + (f" and {len(names) - len(shown)} more" if len(names) > len(shown) else "")


def no_text(error: UnicodeDecodeError) -> str:
    """Where a file is no text, and the cure."""
    line = error.object[: error.start].count(b"\n") + 1
    return f"line {line}: byte 0x{error.object[error.start]:02x} is no UTF-8: save the file as UTF-8"


def _key(loc: Loc) -> str:
    """`array.n_tx`; `targets #2, state`: entries of a list count from 1."""
    key = ""
    for part in loc:
        if isinstance(part, int):
            key += f" #{part + 1},"
        else:
            short = part if len(part) <= MAX_SHOWN else f"{part[:MAX_SHOWN]}..."
            key += f" {short}" if key.endswith(",") else f".{short}" if key else short
    return key.removesuffix(",")


def _said(value: object) -> str:
    return "" if isinstance(value, dict) else f" = {_shown(value)}"


def _shown(value: object) -> str:
    short = _Short()
    short.maxlevel, short.maxstring, short.maxother, short.maxlong = 2, 60, 60, 60
    return short.repr(value)


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        return super().repr_int(x, level) if x.bit_length() <= PRINTED_BITS else "(too large to show)"


def _schema_at(loc: Loc, model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of the value at `loc`."""
    schema = _schema(model)
    for part in loc:
        schema = _resolved(schema["items"] if isinstance(part, int) else schema["properties"][part], model)
    return schema


def _resolved(schema: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """A part of a model's schema, without what refers to another part."""
    if "anyOf" in schema and len(some := [one for one in schema["anyOf"] if one.get("type") != "null"]) == 1:
        schema = some[0]  # of something or nothing
    if "$ref" in schema:
        resolved: dict[str, Any] = _schema(model)["$defs"][schema["$ref"].rsplit("/", 1)[-1]]
        return resolved
    return schema


def _alternatives(loc: Loc, model: type[BaseModel]) -> bool:
    """Whether the value at `loc` may be of several kinds."""
    return bool(loc) and "anyOf" in _schema_at(loc, model)


def plain(error: ErrorDetails) -> str:
    """What one of our own checks said, without what pydantic puts before it."""
    return error["msg"].removeprefix("Value error, ")


def allowed(schema: dict[str, Any]) -> str:
    """What may stand where a JSON schema describes it: "must be ..."; a pattern's `description` says it in words."""
    if "anyOf" in schema:
        return "must be " + " or ".join(allowed(one).removeprefix("must be ") for one in schema["anyOf"])
    if "const" in schema:
        return f'must be "{schema["const"]}"'
    if "pattern" in schema:
        return f"must be {schema['description']}"
    if "enum" in schema:
        return f"must be one of {', '.join(schema['enum'])}"
    if "minItems" in schema and schema["minItems"] == schema.get("maxItems"):
        return f"must be a list of {schema['minItems']}"
    limits = [text.format(schema[name]) for name, text in _LIMIT.items() if name in schema]
    return f"must be {_NOUN[schema['type']]} {' and '.join(limits)}".rstrip()
