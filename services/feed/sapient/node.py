"""The radar as a node: it registers, says how it is, reports its tracks, and acknowledges tasks.

A message is framed by its length, 4 octets, the lowest first. Identifiers of reports and objects are ULIDs
(https://github.com/ulid/spec), identifiers of nodes are UUIDs. The messages are from the package `sapient-proto`.
"""

import os
import re
from collections import deque
from collections.abc import Callable, Iterator
from hashlib import blake2b
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track
from cogradar.services.feed.sapient.tasking import COMPLETED, MAX_TASKS, Ack, Command, Tasking
from cogradar.services.feed.sapient.tasks import LOOK_S, MODE, PAUSED
from cogradar.shared.protocol.words.orders import forms
from cogradar.shared.scenario.scenario import SiteSection

VERSION = "BSI Flex 335 v2.0"
MAX_ACKS = 4 * MAX_TASKS  # acknowledgements that are kept
REPEATED_S = 300.0  # of the dwells' time: those that are younger when a connection is lost are said again
STATUS_S = 5.0  # of the dwells' time, between reports of the radar's status
MAX_BYTES = 1 << 20  # of a message that is answered
FIELD_DEG = 180.0  # of view, around the boresight
SEEN = "time since detection"
DEGREE_M = 6_371_000.0 * np.pi / 180.0  # along a meridian
NOTICE_S = 0.5  # until a command takes effect, in real time
# Of the enumerations of units and datums: degrees and metres on the ellipsoid WGS 84, degrees from true north, m/s.
_WGS84 = _DEGREES = _TRUE_NORTH = _M_S = 1
_LETTERS = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
_TOLD = {"registration", "status"}  # requests of no commander
_ULID = re.compile(f"[{_LETTERS}{_LETTERS.lower()}]{{26}}")


class Sapient(Format):
    """A report for each track in each picture, once the other side has accepted the radar; a last one when it ends."""

    def __init__(self, command: Command | None, notify: Callable[[str], None]) -> None:
        """Raises BadInput if the package with the messages is missing.

        command : sends the commands of tasks; None: tasks are refused
        notify : is told of messages that are dropped
        """
        try:
            from sapient_msg.bsi_flex_335_v2_0 import sapient_message_pb2
        except ImportError:
            raise BadInput("--to sapient: needs its messages: pip install 'cogradar[sapient]'") from None
        self._message = sapient_message_pb2.SapientMessage
        self._newest: Picture | None = None
        self._shown: dict[str, Track] = {}  # by object
        self._is_accepted = False
        self._status_s, self._told = float("-inf"), ("", "")  # of the newest status: when, mode and task
        self._heard = b""
        self._tasking, self._acks = Tasking(command), deque[Ack](maxlen=MAX_ACKS)  # those that are still to be said
        self._said = deque[tuple[float, Ack]](maxlen=MAX_ACKS)  # on this connection, and when
        self._notify, self._dropped = notify, 0

    @property
    def is_accepted(self) -> bool:
        """Whether the fusion node has accepted the registration."""
        return self._is_accepted

    def encode(self, picture: Picture) -> list[Output]:
        """Reports, each a message. Raises RunFailed if the other side refuses the radar."""
        before, self._newest = self._newest, picture
        shown = {_object(picture.run, track.number): track for track in picture.tracks}
        self._acks += self._tasking.due(picture, shown)
        if before is not None and before.run != picture.run:
            self._forget()
            return [Output(self._registration(picture))]  # the radar has said goodbye; it may be elsewhere now
        if not self._is_accepted:
            return []
        ended = [(name, track) for name, track in self._shown.items() if name not in shown]
        self._shown = shown
        found = [Output(self._acknowledged(picture, ack)) for ack in self._acks]
        self._acks.clear()
        found += self._status(picture)
        found += [self._report(picture, name, track, is_lost=True) for name, track in ended]
        return found + [self._report(picture, name, track, is_lost=False) for name, track in shown.items()]

    def greeting(self) -> bytes:
        """The registration; what was told on another connection is told anew. Nothing is known before a picture."""
        self._forget()
        self._heard = b""
        return b"" if self._newest is None else self._registration(self._newest)

    def lost(self) -> None:
        """Whether the last acknowledgements have arrived is not known: they are repeated on the next connection."""
        self._forget()
        now_s = 0.0 if self._newest is None else self._newest.utc_s
        again = [*(ack for said_s, ack in self._said if now_s - said_s < REPEATED_S), *self._acks]
        self._said.clear()
        self._acks = deque({(ack.node, ack.task): ack for ack in again}.values(), MAX_ACKS)  # the newest of each task

    def _forget(self) -> None:
        """Begin anew with the other side; tasks go on."""
        self._is_accepted, self._shown = False, {}
        self._status_s, self._told = float("-inf"), ("", "")

    def answer(self, data: bytes) -> bytes:
        """What is to be said at once to what the other side said. A message that makes no sense is dropped.

        Raises RunFailed if the radar is refused, ConnectionError if the connection is no use any more.
        """
        self._heard += data
        said = b""
        while len(self._heard) >= 4:
            n = int.from_bytes(self._heard[:4], "little")
            if n > MAX_BYTES:
                raise ConnectionError(f"a message of {n} bytes was announced, at most {MAX_BYTES} are read")
            if len(self._heard) < 4 + n:
                break
            payload, self._heard = self._heard[4 : 4 + n], self._heard[4 + n :]
            said += self._answer(payload)
        return said

    def _answer(self, payload: bytes) -> bytes:
        from google.protobuf.message import DecodeError

        try:
            message = self._message.FromString(payload)
        except DecodeError:
            return self._drop(f"{len(payload)} bytes that are no message")
        if message.HasField("registration_ack"):
            if not message.registration_ack.acceptance:
                reasons = "; ".join(message.registration_ack.ack_response_reason) or "without a reason"
                raise RunFailed(f"SAPIENT: the radar was refused: {reasons[:300]!r}")
            self._is_accepted = True
        if message.HasField("error"):
            reasons = "; ".join(message.error.error_message)
            return self._drop(f"the other side reports an error: {reasons[:300]!r}")
        return self._task(message, self._newest) if message.HasField("task") else b""

    def _task(self, message: Any, picture: Picture | None) -> bytes:
        """What is to be said of a task at once."""
        name = message.task.task_id
        if picture is None or not self._is_accepted or message.destination_id.lower() not in {"", _node(picture.site)}:
            return self._drop("a task for another node, or before the radar has registered")
        if not _ULID.fullmatch(name):
            return self._drop(f"a task whose identifier is no ULID: {name[:40]!r}")
        asked = message.task.command.request.strip().lower()
        if message.task.control == message.task.CONTROL_START and asked in _TOLD:
            self._status_s = float("-inf")  # with the next picture
            ack = self._acknowledged(picture, Ack(message.node_id, name, COMPLETED, f"{asked} is told"))
            return (self._registration(picture) if asked == "registration" else b"") + ack
        at_once = self._tasking.take(message.node_id, message.task, picture, self._shown)
        return b"" if at_once is None else self._acknowledged(picture, at_once)

    def _drop(self, what: str) -> bytes:
        """Count what is dropped, and tell of the first, the tenth, the hundredth..."""
        self._dropped += 1
        if str(self._dropped).rstrip("0") == "1":
            self._notify(f"SAPIENT: {what}; {self._dropped} messages dropped so far")
        return b""

    def _registration(self, picture: Picture) -> bytes:
        message = self._begun(picture)
        _register(message.registration, picture, self._tasking.most)
        return _framed(message)

    def _acknowledged(self, picture: Picture, ack: Ack) -> bytes:
        self._said.append((picture.utc_s, ack))
        message = self._begun(picture)
        message.destination_id = ack.node
        message.task_ack.task_id, message.task_ack.task_status = ack.task, ack.status
        message.task_ack.reason.append(ack.reason)
        return _framed(message)

    def _begun(self, picture: Picture) -> Any:
        message = self._message(node_id=_node(picture.site))
        message.timestamp.FromMilliseconds(round(1e3 * picture.utc_s))
        return message

    def _status(self, picture: Picture) -> Iterator[Output]:
        told = PAUSED if picture.is_paused else MODE, self._tasking.active
        if told == self._told and not picture.is_last and 0.0 <= picture.utc_s - self._status_s < STATUS_S:
            return
        self._status_s = float("-inf") if picture.is_last else picture.utc_s
        message = self._begun(picture)
        status, site = message.status_report, picture.site
        status.report_id, status.mode = _ulid(picture.utc_s, os.urandom(10)), told[0]
        if told[1]:
            status.active_task_id = told[1]
        status.system = status.SYSTEM_GOODBYE if picture.is_last else status.SYSTEM_OK
        status.info = status.INFO_UNCHANGED if told == self._told else status.INFO_NEW
        self._told = told
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


def _register(registration: Any, picture: Picture, most: int) -> None:
    """Say what the radar is, what it reports, and which tasks it takes; most : tasks that may go on at a time."""
    registration.icd_version, registration.name = VERSION, "cogradar"
    registration.node_definition.add(node_type=registration.NODE_TYPE_RADAR)
    registration.capabilities.add(category="radar", type="tracks", value="horizontal")
    registration.config_data.add(manufacturer="cogradar", model="simulated" if picture.is_simulated else "radar")
    status = registration.status_definition
    status.status_interval.units, status.status_interval.value = registration.TIME_UNITS_SECONDS, STATUS_S
    for name in (MODE, PAUSED) if most else (MODE,):
        mode = registration.mode_definition.add(mode_name=name)
        mode.mode_type = registration.MODE_TYPE_PERMANENT if name == MODE else registration.MODE_TYPE_TEMPORARY
        mode.settle_time.units, mode.settle_time.value = registration.TIME_UNITS_SECONDS, 0.0
        mode.scan_type, mode.tracking_type = registration.SCAN_TYPE_STEERABLE, registration.TRACKING_TYPE_TRACK
        _define_detections(registration, mode.detection_definition.add())
        _define_tasks(registration, mode.task, most)


def _define_detections(registration: Any, detection: Any) -> None:
    detection.location_type.location_units, detection.location_type.location_datum = _DEGREES, _WGS84
    detection.velocity_type.enu_velocity_units.east_north_rate_units = _M_S
    detection.velocity_type.location_datum = _WGS84
    error = detection.geometric_error
    error.type, error.units, error.variation_type = "standard deviation", "degrees", "each report"
    detection.detection_report.add(category=registration.DETECTION_REPORT_CATEGORY_TRACK, type=SEEN, units="s")


def _define_tasks(registration: Any, task: Any, most: int) -> None:
    task.concurrent_tasks = most
    region = task.region_definition  # mandatory, also without tasks
    region.region_type.append(registration.REGION_TYPE_AREA_OF_INTEREST)
    region.region_area.add(range_bearing_units=_DEGREES, range_bearing_datum=_TRUE_NORTH)
    if not most:
        return
    region.region_type.append(registration.REGION_TYPE_IGNORE)
    region.region_area.add(location_units=_DEGREES, location_datum=_WGS84)
    for kind, units, seconds in (
        (registration.COMMAND_TYPE_LOOK_AT, "degrees from true north, or latitude and longitude", LOOK_S),
        (registration.COMMAND_TYPE_FOLLOW, "object of a detection report", NOTICE_S),
        (registration.COMMAND_TYPE_MODE_CHANGE, f"{MODE}; {PAUSED}", NOTICE_S),
        (registration.COMMAND_TYPE_REQUEST, "; ".join(("Registration", "Status", "Start", "Stop", *forms())), NOTICE_S),
    ):
        offered = task.command.add(type=kind, units=units)
        offered.completion_time.units, offered.completion_time.value = registration.TIME_UNITS_SECONDS, seconds


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
