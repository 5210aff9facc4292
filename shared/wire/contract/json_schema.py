"""JSON Schema (2020-12) of the messages in the form that they have in JSON, with meanings, shapes and units."""

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import DEFAULT_REF_TEMPLATE, GenerateJsonSchema
from pydantic_core.core_schema import TaggedUnionSchema

from cogradar.shared.protocol.messages import SCHEMA, Message
from cogradar.shared.protocol.roster import Compared
from cogradar.shared.protocol.topics import KINDS, PROTOCOL, encoding_of, name_of
from cogradar.shared.wire.codec import ARRAY
from cogradar.shared.wire.contract.meanings import meanings, shape, unit

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ROOT = f"urn:cogradar:{PROTOCOL}"
ENVELOPE = "Message"  # behind the name of what is in it
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


def envelope(kind: type[Message], template: str = DEFAULT_REF_TEMPLATE) -> Schema:
    """Schema of a message; the body is a reference by the name of its kind."""
    return {
        "title": f"{kind.__name__}{ENVELOPE}",
        "description": _text(kind),
        "type": "object",
        "properties": {
            "v": {"const": SCHEMA, "description": "version of the envelope"},
            "topic": {"const": name_of(kind), "description": "kind of message"},
            "body": {"$ref": template.format(model=kind.__name__)},
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
    for part in (schema, *shared.values()):
        _say_how_arrays_are_packed(part)
    return schema, shared


def document() -> Schema:
    """A schema for every message and for all that they refer to, by name, in one document."""
    schemas: dict[str, Schema] = {}
    for kind in KINDS:
        body, shared = described(kind)
        named = {"x-encoding": encoding_of(kind), **envelope(kind)}
        schemas |= {f"{kind.__name__}{ENVELOPE}": named, kind.__name__: body} | shared
    return {
        "$schema": DIALECT,
        "$id": ROOT,
        "title": f"Messages of cogradar, protocol {PROTOCOL}",
        "description": (
            "A message is MessagePack. It has the same maps, lists, numbers and texts in JSON, with two exceptions: an"
            f" array is an extension value of type {ARRAY} in MessagePack, an object with dtype, shape and values in"
            " JSON. Bytes are an object with base64. The key x-msgpack says what the extension value holds. These are"
            " two letters for the kind of its elements, a byte for the number of axes, four for the length of each, and"
            " the elements, the last axis fastest, all little-endian. A schema cannot say how fields depend on each"
            " other: receivers check that, too."
        ),
        "oneOf": [{"$ref": f"#/$defs/{kind.__name__}{ENVELOPE}"} for kind in KINDS],
        "$defs": schemas,
    }


def _say_how_arrays_are_packed(schema: Any) -> None:
    """Add to the schema of each array, which describes its JSON form, its packing in MessagePack."""
    parts = list(schema.values()) if isinstance(schema, dict) else schema if isinstance(schema, list) else []
    if isinstance(schema, dict) and {"dtype", "shape", "values"} == schema.get("properties", {}).keys():
        of = schema["properties"]
        shape = of["shape"]
        n_axes = len(shape["const"]) if "const" in shape else shape["minItems"]
        kind = of["dtype"]["const"]
        schema["x-msgpack"] = {"extensionType": ARRAY, "dtype": kind, "axes": n_axes, "order": "C", "endian": "little"}
        return
    for part in parts:
        _say_how_arrays_are_packed(part)


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
