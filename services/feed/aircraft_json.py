"""aircraft.json and receiver.json, the files that tar1090 and other pages for receivers of ADS-B draw.

Their fields: https://github.com/wiedehopf/readsb/blob/dev/README-json.md
"""

import json
from typing import Any

import numpy as np

from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track

AIRCRAFT, RECEIVER = "aircraft.json", "receiver.json"
KNOT = 1852.0 / 3600.0  # in m/s
WITHIN_95 = 2.4477  # standard deviations of a circular Gaussian, 95 % of which is nearer
REFRESH_MS = 1000  # between two looks of the page at aircraft.json
NEW = 1 << 24  # addresses of 24 bits
GONE_S = 60.0  # a page takes an aircraft away 58 s after its last message, by the time of the files alone
LEAST_S = 0.001  # from one file to the next, or a page does not read it


class AircraftJson(Format):
    """Both files, as far as they change."""

    def __init__(self) -> None:
        self._told: Any = None  # site of the receiver's file
        self._n = 0  # pictures, which stand for the messages of a receiver
        self._now_s = 0.0  # of the last file
        self._run, self._before, self._highest = "", 0, 0  # addresses of earlier runs; the last one of this run

    def encode(self, picture: Picture) -> list[Output]:
        """The newest file of aircraft; of the receiver, if it is another one than before."""
        self._n += 1
        if picture.run != self._run:  # a page joins the trails of equal addresses
            self._run, self._before, self._highest = picture.run, self._before + self._highest, 0
        self._highest = max(self._highest, *(track.number for track in picture.tracks), 0)
        self._now_s = max(picture.utc_s + GONE_S * picture.is_last, self._now_s + LEAST_S)
        aircraft = {
            "now": round(self._now_s, 3),
            "messages": self._n,
            "aircraft": [_aircraft(track, self._before + track.number, self._n) for track in picture.tracks],
        }
        found = [Output(_json(aircraft), AIRCRAFT)]
        if picture.site != self._told:
            self._told = picture.site
            site = {"lat": picture.site.latitude_deg, "lon": picture.site.longitude_deg}
            receiver = {"version": "cogradar", "refresh": REFRESH_MS, "history": 0, **site}
            found.insert(0, Output(_json(receiver), RECEIVER))
        return found


def _aircraft(track: Track, address: int, n: int) -> dict[str, Any]:
    """A track as an aircraft whose address (~) is none of ICAO's. It has no altitude: none is measured."""
    largest = float(np.linalg.eigvalsh(track.covariance[::2, ::2])[-1])
    return {
        "hex": f"~{address % NEW:06x}",
        "type": "other",
        "flight": f"T{track.number}",
        "lat": round(track.latitude, 6),
        "lon": round(track.longitude, 6),
        "gs": round(track.speed / KNOT, 1),
        "track": round(track.course_deg, 2) % 360.0,
        "rc": round(WITHIN_95 * max(largest, 0.0) ** 0.5),
        "seen": round(track.seen_s, 1),
        "seen_pos": round(track.seen_s, 1),
        "messages": n,
    }


def _json(document: dict[str, Any]) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode() + b"\n"
