"""A whole run as an MCAP file (https://mcap.dev), dwell by dwell: a topic per table, and what viewers draw.

Messages are JSON with their schemas in the file.
"""

import json
import math
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.dwell_range import ALL, Dwells, check, is_among
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export import schemas
from cogradar.services.analysis.export.scene import Layer, Rgb, attitude, layers
from cogradar.services.analysis.export.times import timed
from cogradar.services.analysis.optional import library

FRAME, MAP = "radar", "map"
DELETE_ALL, LINE_STRIP = 1, 0  # of Foxglove's schemas
_STRAIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
_IDENTITY = {"position": _ORIGIN, "orientation": _STRAIGHT}
Message = dict[str, Any]


class Moment(NamedTuple):
    """A dwell, and what all topics say of it in the same way."""

    dwell: Dwell
    timestamp: Message
    layers: list[Layer]


Said = tuple[schemas.Schema, Message] | None  # None: the topic has nothing to say


class Topic(NamedTuple):
    """A topic: a message about a dwell, with its schema."""

    name: str
    of: Callable[[Moment], Said]


def write(
    result: Result,
    file: Path,
    report: Callable[[int], object],
    dwells: Dwells = ALL,
) -> int:
    """Write a run; returns how many dwells. One dwell at a time is in memory, and an index of some bytes per MiB.

    report : told the number of dwells after each
    dwells : t of the first and the last, None: of the run

    Raises BadInput without the library `mcap`, if no scan is stored, or if there is none of the dwells.
    """
    writing = library("mcap.writer", "mcap", "mcap")
    check(result, dwells)
    n = 0
    with file.open("wb") as stream:
        writer = writing.Writer(stream)
        writer.start(profile="", library=f"cogradar {version('cogradar')}")
        writer.add_metadata("cogradar", _of_run(result))
        channels = dict[str, int]()
        for at_s, _, dwell in timed(result.dwells(), acquisition_scans=result.acquisition_scans):
            if not is_among(dwell.t, dwells):
                continue
            at_ns = round(1e9 * at_s)
            now = Moment(dwell, {"sec": at_ns // 10**9, "nsec": at_ns % 10**9}, layers(dwell))
            for topic in TOPICS:
                if (found := topic.of(now)) is None:
                    continue
                schema, message = found
                if topic.name not in channels:
                    schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
                    channels[topic.name] = writer.register_channel(topic.name, "json", schema_id)
                data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
                writer.add_message(
                    channels[topic.name], log_time=at_ns, data=data, publish_time=at_ns, sequence=dwell.k
                )
            n += 1
            report(n)
        writer.finish()
    return n


def _of_run(result: Result) -> dict[str, str]:
    document = json.dumps(result.scenario.model_dump(mode="json"), sort_keys=True)
    of_run = {"run": result.run, "strategy": result.strategy, "seed": result.seed, "digest": result.digest}
    return {name: str(value) for name, value in of_run.items()} | {"scenario": document}


def _table(name: str, title: str, rows_of: Callable[[Dwell], Records | None]) -> Topic:
    def message(now: Moment) -> Said:
        if (rows := rows_of(now.dwell)) is None:
            return None
        found = {"timestamp": now.timestamp, "k": now.dwell.k, "t": now.dwell.t, "rows": list(_objects(rows))}
        return schemas.of_table(title, rows), found

    return Topic(name, message)


def _objects(rows: Records) -> Iterator[Message]:
    """Rows as objects; matrices row by row; what is not finite is left out."""
    columns = dict[str, list[Any]]()
    for name in rows.dtype.names or ():
        values = np.asarray(rows[name])
        parts = (values.real, values.imag) if values.dtype.kind == "c" else (values,)
        for part, one in zip(schemas.parts_of(name, values.dtype.kind), parts, strict=True):
            flat = one.reshape(len(rows), math.prod(one.shape[1:]))
            known = np.isfinite(flat).all(axis=1).tolist()
            listed = (flat if one.ndim > 1 else one).tolist()
            columns[part] = [value if is_known else None for value, is_known in zip(listed, known, strict=True)]
    for row in zip(*columns.values(), strict=True):
        yield {name: value for name, value in zip(columns, row, strict=True) if value is not None}


def _scene(now: Moment) -> Said:
    """All that is drawn in place of what was drawn: a viewer that jumps to a dwell shows that one."""
    entities = [
        {
            "timestamp": now.timestamp,
            "frame_id": FRAME,
            "id": layer.name,
            "lifetime": {"sec": 0, "nsec": 0},
            "frame_locked": True,
            "metadata": [],
            "spheres": [_sphere(*one, layer.size_km) for one in zip(layer.points.tolist(), layer.colors, strict=True)],
            "lines": [_line(line.tolist(), _colour_of(layer, i)) for i, line in enumerate(layer.lines)],
            "texts": [_label(*one) for one in zip(layer.points.tolist(), layer.names, strict=False)],
            **{name: [] for name in schemas.UNUSED},
        }
        for layer in now.layers
    ]
    deletions = [{"timestamp": now.timestamp, "type": DELETE_ALL, "id": ""}]
    return schemas.SCENE_UPDATE, {"deletions": deletions, "entities": entities}


def _colour_of(layer: Layer, line: int) -> Rgb:
    """Colour of a line: each thing has as many lines, one after the other."""
    return layer.colors[line % len(layer.colors)] if layer.colors else (0.9, 0.5, 0.1)


def _xyz(point: list[float]) -> Message:
    return dict(zip("xyz", point, strict=True))


def _rgba(color: Rgb) -> Message:
    return dict(zip("rgba", (*color, 1.0), strict=True))


def _sphere(point: list[float], color: Rgb, size: float) -> Message:
    pose = {"position": _xyz(point), "orientation": _STRAIGHT}
    return {"pose": pose, "size": _xyz([size, size, size]), "color": _rgba(color)}


def _line(points: list[list[float]], color: Rgb) -> Message:
    return {
        "type": LINE_STRIP,
        "pose": _IDENTITY,
        "thickness": 1.5,
        "scale_invariant": True,  # in pixels
        "points": [_xyz(point) for point in points],
        "color": _rgba(color),
        "colors": [],
        "indices": [],
    }


def _label(point: list[float], text: str) -> Message:
    return {
        "pose": {"position": _xyz(point), "orientation": _STRAIGHT},
        "billboard": True,
        "font_size": 14.0,
        "scale_invariant": True,
        "color": _rgba((0.5, 0.5, 0.5)),
        "text": text,
    }


def _frame(now: Moment) -> Said:
    rotation = dict(zip("xyzw", attitude(now.dwell.scenario), strict=True))
    frames = {"timestamp": now.timestamp, "parent_frame_id": MAP, "child_frame_id": FRAME}
    return schemas.FRAME_TRANSFORM, {**frames, "translation": _ORIGIN, "rotation": rotation}


def _map(now: Moment) -> Said:
    if now.dwell.scenario.site is None:
        return None
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
            "properties": {"name": f"{layer.name} {name}", "style": {"color": _hex(color)}},
        }
        for layer in now.layers
        if layer.geo is not None and layer.names
        for (latitude, longitude), name, color in zip(layer.geo.tolist(), layer.names, layer.colors, strict=True)
    ]
    return schemas.GEO_JSON, {"geojson": json.dumps({"type": "FeatureCollection", "features": features})}


def _hex(color: Rgb) -> str:
    return "#" + "".join(f"{round(255 * value):02x}" for value in color)


TOPICS = (
    _table("/looks", "cogradar.Looks", lambda dwell: dwell.detections(all_looks=True)),
    _table("/tracks", "cogradar.Tracks", Dwell.tracks),
    _table("/plans", "cogradar.Plans", Dwell.requests),
    _table("/waveform", "cogradar.Waveform", Dwell.waveforms),
    _table("/truth", "cogradar.Truth", lambda dwell: dwell.truth() if dwell.has_truth else None),
    Topic("/scene", _scene),
    Topic("/tf", _frame),
    Topic("/map", _map),
)
