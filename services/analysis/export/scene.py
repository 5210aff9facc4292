"""What a viewer draws of a dwell: points, lines and names before the radar, and on the map.

Coordinates are km in a frame with x along boresight, y to its right and z down.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.skies.place import Place
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.scenario import Scenario

Floats = NDArray[np.float64]

LEADER_S = 60.0  # of flight, the line before a track
SIGMAS = 2.0  # of the ellipse around a track
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 25)
_CIRCLE = np.array([np.cos(_ANGLES), np.sin(_ANGLES)])  # (2, 25), closed
Rgb = tuple[float, float, float]
CONFIRMED, TENTATIVE = (0.1, 0.4, 0.9), (0.5, 0.6, 0.8)
TARGETS, DETECTIONS = (0.1, 0.6, 0.2), (0.9, 0.5, 0.1)


class Layer(NamedTuple):
    """Things of one kind; n of them."""

    name: str
    points: Floats  # (n, 3)
    names: list[str]
    colors: list[Rgb]
    size_km: float  # of a point
    lines: list[Floats]  # (points, 3) each
    geo: Floats | None  # (n, 2) latitudes and longitudes, degrees; None: it is not known where the radar is


def layers(dwell: Dwell) -> list[Layer]:
    """Tracks and detections, and targets where there is truth."""
    place = None if dwell.scenario.site is None else Place.of(dwell.scenario.site)
    found = [_tracks(dwell.tracks(), place), _detections(dwell.detections(), dwell.scenario.radar, place)]
    return [*found, _targets(dwell.truth(), place)] if dwell.has_truth else found


def _tracks(rows: Records, place: Place | None) -> Layer:
    points = _points(rows["x_hat"], rows["y_hat"])
    ahead = points + LEADER_S * _points(rows["vx_hat"], rows["vy_hat"])
    lines = [np.stack(pair) for pair in zip(points, ahead, strict=True)]
    for point, covariance in zip(points, rows["covariance"][:, ::2, ::2], strict=True):
        values, vectors = np.linalg.eigh(covariance)
        offsets = SIGMAS * vectors @ (np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * _CIRCLE)
        lines.append(point + _points(*offsets))
    colors = [CONFIRMED if is_confirmed else TENTATIVE for is_confirmed in rows["confirmed"].tolist()]
    return Layer("tracks", points, [str(n) for n in rows["track"].tolist()], colors, 0.6, lines, _geo(points, place))


def _detections(rows: Records, radar: RadarConfig, place: Place | None) -> Layer:
    """Points where a range was measured, else lines as far as the radar looks."""
    nu = np.where(np.isnan(rows["nu_measured"]), rows["nu"], rows["nu_measured"])
    sine = np.clip(2.0 * nu, -1.0, 1.0)
    along = _points(np.sqrt(1.0 - sine**2), sine)
    has_range = ~np.isnan(rows["range_km"])
    points = along[has_range] * rows["range_km"][has_range, np.newaxis]
    lines = [np.array([np.zeros(3), radar.acquisition.range_max_km * one]) for one in along[~has_range]]
    return Layer("detections", points, [], len(points) * [DETECTIONS], 0.3, lines, _geo(points, place))


def _targets(rows: Records, place: Place | None) -> Layer:
    points = _points(rows["x"], rows["y"], rows["z"])
    names = [str(n) for n in rows["target"].tolist()]
    return Layer("targets", points, names, len(points) * [TARGETS], 0.4, [], _geo(points, place))


def _points(x: Floats, y: Floats, up: Floats | float = 0.0) -> Floats:
    return np.stack([x, y, np.broadcast_to(-np.asarray(up), np.shape(x))], axis=-1)


def _geo(points: Floats, place: Place | None) -> Floats | None:
    if place is None:
        return None
    found = place.positions(points[:, 0], points[:, 1])
    return np.stack([found.latitudes, found.longitudes], axis=-1)


def attitude(scenario: Scenario) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) from this frame to a map: x to the east, y to the north, z up.

    Without a site boresight is north.
    """
    bearing = 0.0 if scenario.site is None else scenario.site.boresight_deg
    half = np.radians(90.0 - bearing) / 2.0
    return float(np.cos(half)), float(np.sin(half)), 0.0, 0.0
