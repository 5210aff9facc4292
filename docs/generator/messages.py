"""Topics and messages: who says what to whom, and what is in it."""

import inspect
import re
from types import NoneType
from typing import get_args, get_origin, get_type_hints

from pydantic.fields import FieldInfo

from cogradar.shared.protocol import fields
from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.topics import ALIVE, CLAIM, QUERYABLES, TOPICS, Role
from docs.generator.markdown import code, prose, table

_ARRAYS = {
    "Ints": "int32, 1 axis",
    "Beams": "int32, 2 axes",
    "Cells": "int32, 1 axis",
    "Chances": "float64, 1 axis",
    "Gate": "float64, 1 axis",
    "Floats": "float64, 1 axis",
    "Measured": "float64, 1 axis; 0, or 1e-60 .. 1e60",
    "FloatLists": "float64, 2 axes",
    "State": "float64, (4,)",
    "States": "float64, 2 axes",
    "Covariance": "float64, (4, 4)",
    "Particles": "float64, 2 axes",
    "Complexes": "complex64, 1 axis",
    "Factor": "complex64, 2 axes",
    "RunId": "text",
    "Index": "whole number from 0",
    "Seed": "whole number from 0 below 2^63",
}
_FIELD = re.compile(r"^    (\w+): (.*?)(?:\s+# (.*))?$", re.MULTILINE)


def topics() -> str:
    """A row per topic."""
    rows = [
        (code(topic.name), code(topic.key), str(topic.producer), ", ".join(map(str, topic.readers))) for topic in TOPICS
    ]
    return table(("message", "key", "sender", "readers"), rows)


def readers() -> str:
    """Who sends what to whom: a row per sender, a column per reader."""
    roles = [role for role in Role if any(role in topic.readers for topic in TOPICS)]
    senders = [role for role in Role if any(topic.producer is role for topic in TOPICS)]
    rows = [
        (
            f"**{sender}**",
            *(
                ", ".join(topic.name for topic in TOPICS if topic.producer is sender and reader in topic.readers)
                for reader in roles
            ),
        )
        for sender in senders
    ]
    return table(("from \\ to", *map(str, roles)), rows)


def keys() -> str:
    """Keys that are no topic of a run."""
    rows = [
        (code(ALIVE), "liveliness token of a process"),
        (code(CLAIM), "liveliness token of a process that wants to be the only one of its role"),
        *((code(queryable.key), f"queryable: {queryable.meaning}") for queryable in QUERYABLES),
    ]
    return table(("key", "what it is"), rows)


def messages() -> str:
    """A part per message, with a row per field."""
    return "\n".join(f"### {topic.message.__name__}\n\n{_message(topic.message)}" for topic in TOPICS)


def _message(message: type[Message]) -> str:
    hints = get_type_hints(message, include_extras=True)
    comments: dict[str, str] = {}
    for kind in reversed(message.__mro__[:-1]):
        if issubclass(kind, Message):
            comments |= {name: text for name, _, text in _FIELD.findall(inspect.getsource(kind))}
    rows = [
        (code(name), _type(hints[name], field.annotation), _default(field), prose(comments.get(name, "")))
        for name, field in message.model_fields.items()
    ]
    text = "\n\n".join(prose(paragraph) for paragraph in inspect.cleandoc(message.__doc__ or "").split("\n\n"))
    return f"{text}\n\n{table(('field', 'type', 'if left out', 'meaning'), rows)}"


def _type(hint: object, plain: object) -> str:
    parts = get_args(hint)
    if len(parts) == 2 and parts[1] is NoneType:
        return f"{_type(parts[0], next(iter(get_args(plain)), plain))}, or none"
    if get_origin(plain) is list:
        return f"list: {_type(*get_args(plain) * 2)}"
    known = next((text for name, text in _ARRAYS.items() if getattr(fields, name) == hint), None)
    if known:
        return known
    if isinstance(plain, type) and not str(plain).startswith("dict"):
        return {"int": "whole number", "float": "number", "bool": "true, false", "str": "text"}.get(
            plain.__name__, code(plain.__name__)
        )
    return code(re.sub(r"typing\.|shared\.protocol\.fields\.", "", str(plain)))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    return (
        ("none" if field.default_factory is list else "zeros") if field.default_factory else code(repr(field.default))
    )
