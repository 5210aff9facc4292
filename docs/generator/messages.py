"""Topics and messages: senders, readers and contents."""

from collections.abc import Callable
from typing import Any

from cogradar.shared.protocol.topics import ALIVE, CLAIM, KINDS, QUERYABLES, SHARE, TOPICS, Role, Topic
from cogradar.shared.wire.contract.json_schema import Schema, described
from docs.generator.markdown import code, prose, table

_ROUND = {2**31 - 1: "2^31 - 1", 2**48: "2^48", 2**62: "2^62", 2**63: "2^63"}


def topics() -> str:
    """A row per topic."""
    rows = [
        (code(topic.name), code(topic.key), str(topic.producer), ", ".join(map(str, topic.readers))) for topic in TOPICS
    ]
    return table(("message", "key", "sender", "readers"), rows)


def readers() -> str:
    """Topics by sender and reader: a row per sender, a column per reader."""
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
        (code(SHARE), "liveliness token of a process of a pool, for each shard of the runs that it serves"),
        *((code(queryable.key), f"queryable: {queryable.meaning}") for queryable in QUERYABLES),
    ]
    return table(("key", "what it is"), rows)


def messages() -> str:
    """A part per message, with a row per field."""
    deliveries = {topic.message: _delivery(topic) for topic in TOPICS}
    return "\n".join(
        f"### {kind.__name__}\n\n{_fields(described(kind)[0])}\n{deliveries.get(kind, '')}" for kind in KINDS
    )


def parts() -> str:
    """A part per type that messages have fields of, with a row per field."""
    shared: dict[str, Schema] = {}
    for kind in KINDS:
        shared |= described(kind)[1]
    kinds = {name: schema for name, schema in sorted(shared.items()) if "properties" in schema}
    return "\n".join(f"### {name}\n\n{_fields(schema)}" for name, schema in kinds.items())


def _delivery(topic: Topic) -> str:
    return f"*Delivery:* {prose(topic.delivery.until)} *A process that joins late:* {prose(topic.delivery.late)}\n"


def _fields(schema: Schema) -> str:
    rows = [
        (code(name), words(field), _default(name, field, schema), prose(field.get("description", "")))
        for name, field in schema["properties"].items()
    ]
    text = "\n\n".join(prose(paragraph) for paragraph in schema["description"].split("\n\n"))
    return f"{text}\n\n{table(('field', 'type', 'if left out', 'meaning'), rows)}"


def words(schema: Schema) -> str:
    """What a schema allows, in words."""
    if choices := schema.get("anyOf") or schema.get("oneOf"):
        texts = [words(choice) for choice in choices if choice != {"type": "null"}]
        return ", ".join(texts) + (", or none" if {"type": "null"} in choices else "")
    if "enum" in schema or "const" in schema:
        return ", ".join(code(value) for value in schema.get("enum", [schema.get("const")]))
    if "title" in schema or "$ref" in schema:
        return str(schema.get("title")) if "title" in schema else code(schema["$ref"].rpartition("/")[2])
    return _WORDS[schema["type"]](schema)


def _list(schema: Schema) -> str:
    most = f" of at most {schema['maxItems']}" if "maxItems" in schema else ""
    return f"list{most}: {words(schema['items'])}"


def _text(schema: Schema) -> str:
    return f"text of at most {schema['maxLength']} characters" if "maxLength" in schema else "text"


def _limits(schema: Schema) -> str:
    low, high, below = (schema.get(name) for name in ("minimum", "maximum", "exclusiveMaximum"))
    if low is None:
        return ""
    if high is None and below is None:
        return f", {_number(low)} or more"
    return (
        f", {_number(low)} .. {_number(high)}" if high is not None else f", from {_number(low)}, below {_number(below)}"
    )


_WORDS: dict[str, Callable[[Schema], str]] = {
    "array": _list,
    "boolean": lambda _: "true, false",
    "integer": lambda schema: f"whole number{_limits(schema)}",
    "number": lambda schema: f"number{_limits(schema)}",
    "object": lambda _: "map",
    "string": _text,
}


def _number(value: Any) -> str:
    return _ROUND.get(value, f"{value:g}" if isinstance(value, float) else str(value))


def _default(name: str, field: Schema, schema: Schema) -> str:
    if name in schema.get("required", ()):
        return ""
    if "default" not in field:
        return "none" if field.get("type") == "array" else "zeros"
    default = field["default"]
    return "none" if default is None else code(str(default).lower() if isinstance(default, bool) else repr(default))
