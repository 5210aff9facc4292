"""JSON Schema (2020-12) of the messages in the form that they have in JSON, with meanings, shapes and units."""

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import DEFAULT_REF_TEMPLATE, GenerateJsonSchema
from pydantic_core.core_schema import TaggedUnionSchema

from cogradar.shared.protocol.messages import SCHEMA, Message
from cogradar.shared.protocol.roster import Compared
from cogradar.shared.protocol.topics import KINDS, PROTOCOL, name_of, schema_of
from cogradar.shared.wire.codec import ARRAY
from cogradar.shared.wire.contract.meanings import meanings, shape, unit

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ROOT = f"urn:cogradar:{PROTOCOL}"
Schema = dict[str, Any]


class _Generator(GenerateJsonSchema):
    """Without titles that repeat a field's name, and without OpenAPI's discriminator, which means something else in
    AsyncAPI: what tells kinds apart is a constant.
    """

    def tagged_union_schema(self, schema: TaggedUnionSchema) -> Schema:
        made = super().tagged_union_schema(schema)
        made.pop("discriminator", None)
        return made

    def field_title_should_be_set(self, *_: object) -> bool:
        return False


def envelope(kind: type[Message], body: Schema) -> Schema:
    """Schema of a message whose body has a schema."""
    return {
        "title": kind.__name__,
        "description": _text(kind),
        "type": "object",
        "properties": {
            "v": {"const": SCHEMA, "description": "version of the envelope"},
            "topic": {"const": name_of(kind), "description": "kind of message"},
            "body": body,
        },
        "required": ["v", "topic", "body"],
        "additionalProperties": False,
    }


def described(kind: type[Message], template: str = DEFAULT_REF_TEMPLATE) -> tuple[Schema, dict[str, Schema]]:
    """Schema of a message's body, and of the types that it refers to, by name."""
    schema = kind.model_json_schema(ref_template=template, schema_generator=_Generator)
    shared: dict[str, Schema] = schema.pop("$defs", {})
    known = {part.__name__: part for part in Compared.__subclasses__()}
    for name, part in shared.items():
        if name in known:
            _explain(known[name], part)
    _explain(kind, schema)
    return schema, shared


def document() -> Schema:
    """A schema for every message, each with an identifier of its own, in one document."""
    schemas = {}
    for kind in KINDS:
        body, shared = described(kind)
        parts = {"$defs": shared} if shared else {}
        schemas[name_of(kind)] = {"$id": schema_of(kind), **envelope(kind, body), **parts}
    return {
        "$schema": DIALECT,
        "$id": ROOT,
        "title": f"Messages of cogradar, protocol {PROTOCOL}",
        "description": (
            "A message is MessagePack. It has the same maps, lists, numbers and texts in JSON, with two exceptions: an"
            f" array is an extension value of type {ARRAY} in MessagePack, an object with dtype, shape and values in"
            " JSON; bytes are an object with base64. A schema cannot say how fields depend on each other: receivers"
            " check that, too."
        ),
        "oneOf": [{"$ref": schema_of(kind)} for kind in KINDS],
        "$defs": schemas,
    }


def _explain(kind: type[BaseModel], schema: Schema) -> None:
    """Put into a schema what the comments of its fields say."""
    texts = meanings(kind)
    parts = {name: part for part, names in getattr(kind, "PARTS", {}).items() for name in names}
    for name, field in schema.get("properties", {}).items():
        said = [texts[name]] if name in texts else []
        if name in parts:
            said.append(f"part {parts[name]!r}, whose fields are all there or none")
        if "const" in field and "default" in field:
            schema["required"] = [name, *schema.get("required", ())]
        if said:
            field["description"] = "; ".join(text.rstrip(",.") for text in said)
        if axes := shape(texts.get(name, "")):
            field["x-shape"] = axes
        if dimension := unit(name):
            field["x-unit"] = dimension
    schema["description"] = _text(kind)


def _text(kind: type[BaseModel]) -> str:
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in (kind.__doc__ or "").split("\n\n"))
