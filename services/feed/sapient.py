"""SAPIENT (BSI Flex 335 v2.0): the radar as a node that registers, says how it is, and reports its tracks.

A message is framed by its length, 4 octets, the lowest first. Identifiers of reports and objects are ULIDs
(https://github.com/ulid/spec), those of nodes are UUIDs. The messages are those of the package `sapient-proto`.
"""

import os
from collections.abc import Iterator
from hashlib import blake2b
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track
from cogradar.shared.scenario.scenario import SiteSection

VERSION = "BSI Flex 335 v2.0"
STATUS_S = 5.0  # of the dwells' time, between reports of the radar's status
MODE = "search and track"
MAX_BYTES = 1 << 20  # of a message that is answered
FIELD_DEG = 180.0  # of view, around the boresight
SEEN = "time since detection"
DEGREE_M = 6_371_000.0 * np.pi / 180.0  # along a meridian
NO_TASKS = "this radar takes no tasks by SAPIENT; use `cogradar command` with the certificate of a commander"
# Of the enumerations of units and datums: degrees and metres on the ellipsoid WGS 84, degrees from true north, m/s.
_WGS84 = _DEGREES = _TRUE_NORTH = _M_S = 1
_LETTERS = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"


class Sapient(Format):
    """A report for each track in each picture, once the other side has accepted the radar; a last one when it ends."""

    def __init__(self) -> None:
        """Raises BadInput if the package with the messages is missing."""
        try:
            from sapient_msg.bsi_flex_335_v2_0 import sapient_message_pb2
        except ImportError:
            raise BadInput("--to sapient: needs its messages: pip install 'cogradar[sapient]'") from None
        self._message = sapient_message_pb2.SapientMessage
        self._newest: Picture | None = None
        self._shown: dict[str, Track] = {}  # by object
        self._is_accepted = self._is_told = False
        self._status_s = float("-inf")
        self._heard = b""

    def encode(self, picture: Picture) -> list[Output]:
        """Reports, each a message. Raises RunFailed if the other side refuses the radar."""
        before, self._newest = self._newest, picture
        if before is not None and before.run != picture.run:
            return [Output(self.greeting())]  # the radar has said goodbye; it may be elsewhere now
        if not self._is_accepted:
            return []
        shown = {_object(picture.run, track.number): track for track in picture.tracks}
        ended = [(name, track) for name, track in self._shown.items() if name not in shown]
        self._shown = shown
        found = list(self._status(picture))
        found += [self._report(picture, name, track, is_lost=True) for name, track in ended]
        return found + [self._report(picture, name, track, is_lost=False) for name, track in shown.items()]

    def greeting(self) -> bytes:
        """The registration; what was told on another connection is told anew. Nothing is known before a picture."""
        self._is_accepted = self._is_told = False
        self._status_s, self._heard, self._shown = float("-inf"), b"", {}
        if self._newest is None:
            return b""
        message = self._begun(self._newest)
        _register(message.registration, self._newest)
        return _framed(message)

    def answer(self, data: bytes) -> bytes:
        """What is to be said to what the other side said: tasks are refused. Raises RunFailed, as `encode`."""
        self._heard += data
        said = b""
        while len(self._heard) >= 4:
            n = int.from_bytes(self._heard[:4], "little")
            if n > MAX_BYTES:
                raise RunFailed(f"SAPIENT: a message of {n} bytes, at most {MAX_BYTES} are read")
            if len(self._heard) < 4 + n:
                break
            payload, self._heard = self._heard[4 : 4 + n], self._heard[4 + n :]
            said += self._answer(payload)
        return said

    def _answer(self, payload: bytes) -> bytes:
        from google.protobuf.message import DecodeError

        try:
            message = self._message.FromString(payload)
        except DecodeError as error:
            raise RunFailed(f"SAPIENT: what was received is no message: {error}") from None
        if message.HasField("registration_ack"):
            if not message.registration_ack.acceptance:
                reasons = "; ".join(message.registration_ack.ack_response_reason) or "without a reason"
                raise RunFailed(f"SAPIENT: the radar was refused: {reasons[:300]!r}")
            self._is_accepted = True
        if message.HasField("task") and self._newest is not None:
            said = self._begun(self._newest)
            said.destination_id = message.node_id
            said.task_ack.task_id = message.task.task_id
            said.task_ack.task_status = said.task_ack.TASK_STATUS_REJECTED
            said.task_ack.reason.append(NO_TASKS)
            return _framed(said)
        return b""

    def _begun(self, picture: Picture) -> Any:
        message = self._message(node_id=_node(picture.site))
        message.timestamp.FromMilliseconds(round(1e3 * picture.utc_s))
        return message

    def _status(self, picture: Picture) -> Iterator[Output]:
        if not picture.is_last and 0.0 <= picture.utc_s - self._status_s < STATUS_S:
            return
        self._status_s = float("-inf") if picture.is_last else picture.utc_s
        message = self._begun(picture)
        status, site = message.status_report, picture.site
        status.report_id, status.mode = _ulid(picture.utc_s, os.urandom(10)), MODE
        status.system = status.SYSTEM_GOODBYE if picture.is_last else status.SYSTEM_OK
        status.info, self._is_told = status.INFO_UNCHANGED if self._is_told else status.INFO_NEW, True
        _place(status.node_location, site.latitude_deg, site.longitude_deg)
        status.node_location.z = site.height_m
        view = status.field_of_view.range_bearing
        view.azimuth, view.horizontal_extent = site.boresight_deg, FIELD_DEG
        view.coordinate_system, view.datum = _DEGREES, _TRUE_NORTH
        yield Output(_framed(message))

    def _report(self, picture: Picture, name: str, track: Track, *, is_lost: bool) -> Output:
        message = self._begun(picture)
        report = message.detection_report
        report.report_id, report.object_id = _ulid(picture.utc_s, os.urandom(10)), name
        report.state = "lost" if is_lost else "confirmed" if track.confirmed else "tentative"
        _place(report.location, track.latitude, track.longitude)
        east, east_rate, north, north_rate = np.sqrt(np.maximum(np.diag(track.covariance), 0.0)).tolist()
        report.location.x_error = east / (DEGREE_M * max(np.cos(np.radians(track.latitude)), 1e-6))
        report.location.y_error = north / DEGREE_M
        report.enu_velocity.east_rate, report.enu_velocity.north_rate = track.velocity
        report.enu_velocity.east_rate_error, report.enu_velocity.north_rate_error = east_rate, north_rate
        if track.existence is not None:
            report.detection_confidence = 0.0 if is_lost else track.existence
        report.track_info.add(type=SEEN, value=f"{track.seen_s:g}")
        return Output(_framed(message))


def acceptance() -> bytes:
    """What the other side says to accept a radar, where it is to be played."""
    from sapient_msg.bsi_flex_335_v2_0 import sapient_message_pb2

    return _framed(sapient_message_pb2.SapientMessage(registration_ack={"acceptance": True}))


def _register(registration: Any, picture: Picture) -> None:
    """Say what the radar is and what it reports."""
    registration.icd_version, registration.name = VERSION, "cogradar"
    registration.node_definition.add(node_type=registration.NODE_TYPE_RADAR)
    registration.capabilities.add(category="radar", type="tracks", value="horizontal")
    registration.config_data.add(manufacturer="cogradar", model="simulated" if picture.is_simulated else "radar")
    status = registration.status_definition
    status.status_interval.units, status.status_interval.value = registration.TIME_UNITS_SECONDS, STATUS_S
    mode = registration.mode_definition.add(mode_name=MODE, mode_type=registration.MODE_TYPE_PERMANENT)
    mode.settle_time.units, mode.settle_time.value = registration.TIME_UNITS_SECONDS, 0.0
    mode.scan_type, mode.tracking_type = registration.SCAN_TYPE_STEERABLE, registration.TRACKING_TYPE_TRACK
    detection = mode.detection_definition.add()
    detection.location_type.location_units, detection.location_type.location_datum = _DEGREES, _WGS84
    detection.velocity_type.enu_velocity_units.east_north_rate_units = _M_S
    detection.velocity_type.location_datum = _WGS84
    error = detection.geometric_error
    error.type, error.units, error.variation_type = "standard deviation", "degrees", "each report"
    detection.detection_report.add(category=registration.DETECTION_REPORT_CATEGORY_TRACK, type=SEEN, units="s")
    mode.task.concurrent_tasks = 0
    region = mode.task.region_definition
    region.region_type.append(registration.REGION_TYPE_AREA_OF_INTEREST)
    region.region_area.add(range_bearing_units=_DEGREES, range_bearing_datum=_TRUE_NORTH)


def _place(location: Any, latitude: float, longitude: float) -> None:
    location.x, location.y = longitude, latitude
    location.coordinate_system, location.datum = _DEGREES, _WGS84


def _framed(message: Any) -> bytes:
    payload: bytes = message.SerializeToString()
    return len(payload).to_bytes(4, "little") + payload


def _node(site: SiteSection) -> str:
    """The same for a radar in the same place."""
    return str(uuid5(NAMESPACE_URL, f"cogradar {site.latitude_deg} {site.longitude_deg} {site.height_m}"))


def _object(run: str, number: int) -> str:
    """The same whenever the feed begins."""
    return _ulid(0.0, blake2b(f"{run} {number}".encode(), digest_size=10).digest())


def _ulid(utc_s: float, rest: bytes) -> str:
    """A ULID of a time and 10 octets."""
    value = (round(max(utc_s, 0.0) * 1e3) % (1 << 48)) << 80 | int.from_bytes(rest, "big")
    return "".join(_LETTERS[value >> shift & 31] for shift in range(125, -1, -5))
