"""GeoJSON (RFC 7946): a collection of points, one for each track, after each dwell."""

import json
from datetime import UTC, datetime
from typing import Any

import numpy as np

from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track

FILE = "tracks.geojson"


class GeoJson(Format):
    """A line for each picture, or a file with the newest."""

    def encode(self, picture: Picture) -> list[Output]:
        """The collection of a picture's tracks."""
        collection = {
            "type": "FeatureCollection",
            "run": picture.run,
            "t": picture.t,
            "utc": datetime.fromtimestamp(picture.utc_s, UTC).isoformat(timespec="milliseconds"),
            "features": [_feature(track) for track in picture.tracks],
        }
        return [Output(json.dumps(collection, separators=(",", ":")).encode() + b"\n", FILE)]


def _feature(track: Track) -> dict[str, Any]:
    sigmas = np.sqrt(np.maximum(np.diag(track.covariance), 0.0)).tolist()
    return {
        "type": "Feature",
        "id": track.number,
        "geometry": {"type": "Point", "coordinates": [round(track.longitude, 7), round(track.latitude, 7)]},
        "properties": {
            "track": track.number,
            "confirmed": track.confirmed,
            "existence": track.existence,
            "speed_m_s": round(track.speed, 2),
            "course_deg": round(track.course_deg, 2),
            "east_sigma_m": round(sigmas[0], 1),
            "north_sigma_m": round(sigmas[2], 1),
            "seen_s": track.seen_s,
        },
    }
