"""JSON schemas of what an MCAP file holds: tables of our own, and the parts of Foxglove's schemas that are used.

Foxglove's are known to viewers by their names (https://docs.foxglove.dev/docs/sdk/schemas). A schema here has no unions
and no nested arrays, which viewers cannot show.
"""

from typing import Any

from cogradar.services.analysis.arrays.records import Records
from cogradar.services.analysis.export.tables import unit_of

Schema = dict[str, Any]
JSON_TYPES = {"b": "boolean", "i": "integer", "u": "integer", "f": "number", "c": "number", "U": "string"}

_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}


def _object(title: str | None, **properties: Schema) -> Schema:
    named = {} if title is None else {"title": title}
    return {**named, "type": "object", "properties": properties, "required": list(properties)}


def _array(items: Schema) -> Schema:
    return {"type": "array", "items": items}


UNUSED = ("arrows", "cubes", "cylinders", "triangles", "models")  # of an entity: empty lists
_SECONDS: dict[str, Schema] = {
    "sec": {"type": "integer"},
    "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
}
TIME, _DURATION = _object("time", **_SECONDS), _object("duration", **_SECONDS)
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_SPHERE = _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)
_LINE = _object(
    "foxglove.LinePrimitive",
    type={"type": "integer"},
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_array(_POINT),
    color=_COLOR,
    colors=_array(_COLOR),
    indices=_array({"type": "integer"}),
)
_LABEL = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard={"type": "boolean"},
    font_size=_NUMBER,
    scale_invariant={"type": "boolean"},
    color=_COLOR,
    text=_TEXT,
)
_ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    metadata=_array(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    spheres=_array(_SPHERE),
    lines=_array(_LINE),
    texts=_array(_LABEL),
    **{name: _array({"type": "object", "properties": {}}) for name in UNUSED},
)
_DELETION = _object("foxglove.SceneEntityDeletion", timestamp=TIME, type={"type": "integer"}, id=_TEXT)
SCENE_UPDATE = _object("foxglove.SceneUpdate", deletions=_array(_DELETION), entities=_array(_ENTITY))
FRAME_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
GEO_JSON = _object("foxglove.GeoJSON", geojson=_TEXT)


def of_table(title: str, rows: Records) -> Schema:
    """Schema of a dwell's rows of a table; a value that is unknown is left out of its row."""
    properties, needed = dict[str, Schema](), list[str]()
    for name, (kind, *_) in (rows.dtype.fields or {}).items():
        scalar, shape = kind.base.kind, kind.shape
        one: Schema = {"type": JSON_TYPES[scalar]}
        if unit := unit_of(name):
            one["description"] = unit
        for part in parts_of(name, scalar):
            properties[part] = {**_array(one), "description": f"row by row, {shape}"} if shape else one
            needed += [part] if scalar in "biu" and not shape else []
    row = {"title": f"{title}Row", "type": "object", "properties": properties, "required": needed}
    return _object(title, timestamp=TIME, k={"type": "integer"}, t={"type": "integer"}, rows=_array(row))


def parts_of(name: str, kind: str) -> tuple[str, ...]:
    """Names of the values of a column: of complex numbers two."""
    return (f"{name}_real", f"{name}_imag") if kind == "c" else (name,)
