"""A whole run as a recording of rerun (https://rerun.io), by its own SDK, dwell by dwell."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.dwell_range import ALL, Dwells, check, is_among
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export.scene import Layer, attitude, layers
from cogradar.services.analysis.export.times import timed
from cogradar.services.analysis.export.whole import as_os_error
from cogradar.services.analysis.optional import library

PLOTTED = ("share", "existence", "gain")  # columns of the tracks, curves over the dwells


@as_os_error()
def write(
    result: Result,
    file: Path,
    report: Callable[[int], object],
    dwells: Dwells = ALL,
) -> int:
    """Write a run; returns how many dwells. The SDK writes while dwells are logged, and keeps an index of the chunks.

    report : told the number of dwells after each
    dwells : t of the first and the last, None: of the run

    Raises BadInput without the library `rerun-sdk`, if no scan is stored, or if there is none of the dwells.
    """
    rerun = library("rerun", "rerun", "rrd")
    check(result, dwells)
    n = 0
    recording = rerun.RecordingStream("cogradar", recording_id=result.run)
    recording.save(file, default_blueprint=_views(has_map=result.scenario.site is not None))
    try:
        of_run = {"strategy": str(result.strategy), "seed": str(result.seed), "digest": str(result.digest)}
        document = result.scenario.model_dump_json(indent=1)
        recording.log(
            "run", rerun.TextDocument(document, media_type="text/plain"), rerun.AnyValues(**of_run), static=True
        )
        recording.log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rotation = rerun.Quaternion(xyzw=attitude(result.scenario))
        recording.log("map/radar", rerun.Transform3D(quaternion=rotation), static=True)
        for at_s, is_utc, dwell in timed(result.dwells(), acquisition_scans=result.acquisition_scans):
            if not is_among(dwell.t, dwells):
                continue
            recording.set_time("dwell", sequence=dwell.k)
            if is_utc:
                recording.set_time("utc", timestamp=at_s)
            else:
                recording.set_time("time", duration=at_s)
            for path, archetype in _of_dwell(rerun, dwell):
                recording.log(path, archetype)
            n += 1
            report(n)
        recording.flush()
    finally:
        recording.disconnect()
    return n


def _of_dwell(rerun: Any, dwell: Dwell) -> Iterable[tuple[str, Any]]:
    for layer in layers(dwell):
        yield from _of_layer(rerun, layer)
    for row in dwell.tracks():
        for name in PLOTTED:
            if np.isfinite(row[name]):
                yield f"{name}/track_{row['track']}", rerun.Scalars(float(row[name]))
    looks = dwell.detections(all_looks=True)
    yield "looks/tested", rerun.Scalars(float(len(looks)))
    yield "looks/over_limit", rerun.Scalars(float(looks["is_over"].sum()))


def _of_layer(rerun: Any, layer: Layer) -> Iterable[tuple[str, Any]]:
    """Empty lists, too: they take away what was drawn before."""
    half, names = 0.5 * layer.size_km, layer.names or None
    yield f"map/radar/{layer.name}", rerun.Points3D(layer.points, radii=half, colors=layer.colors, labels=names)
    colors = [layer.colors[i % len(layer.colors)] if layer.colors else None for i in range(len(layer.lines))]
    known = None if None in colors else colors
    yield f"map/radar/{layer.name}/lines", rerun.LineStrips3D(layer.lines, colors=known)
    if layer.geo is not None:
        yield f"earth/{layer.name}", rerun.GeoPoints(lat_lon=layer.geo, colors=layer.colors)


def _views(*, has_map: bool) -> Any:
    """What the viewer shows at first."""
    blueprint = library("rerun.blueprint", "rerun", "rrd")
    maps = [blueprint.MapView(origin="earth", name="map")] if has_map else []
    pictures = blueprint.Tabs(blueprint.Spatial3DView(origin="map", name="scope"), *maps)
    curves = [blueprint.TimeSeriesView(origin=name, name=name) for name in (*PLOTTED, "looks")]
    return blueprint.Blueprint(blueprint.Horizontal(pictures, blueprint.Vertical(*curves)))
