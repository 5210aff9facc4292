"""SAPIENT as other programs read it: `sapient-pydantic` refuses what lacks a mandatory field, or a wrong identifier."""

import math
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage as Message
from sapient_msg.bsi_flex_335_v2_0.status_report_pb2 import StatusReport
from sapient_msg_pydantic.bsi_flex_335_v2_0.sapient_message import SapientMessage

from cogradar.services.errors import RunFailed
from cogradar.services.feed.sapient.node import STATUS_S, Sapient
from cogradar.services.feed.sapient.tasking import NO_TASKS
from cogradar.services.feed.transport import Tcp
from tests.services.feed.made import SITE, UTC_S, crowd, picture, track

FUSION = "0b6ee3d8-3bd5-4bb1-8a40-6dba1c8a7d3b"
TASK = "01J00000000000000000000000"


def messages(data: bytes) -> Iterator[Any]:
    """What was framed, read by the library."""
    while data:
        n = int.from_bytes(data[:4], "little")
        yield SapientMessage.from_pb2(Message.FromString(data[4 : 4 + n]))
        data = data[4 + n :]


def framed(**content: Any) -> bytes:
    message = Message(node_id=FUSION, **content)
    message.timestamp.FromMilliseconds(round(1e3 * UTC_S))
    SapientMessage.from_pb2(message)  # it is one
    payload: bytes = message.SerializeToString()
    return len(payload).to_bytes(4, "little") + payload


ACCEPTED = framed(registration_ack={"acceptance": True})


def sent(form: Sapient, *made: Any) -> list[Any]:
    return [message for one in made for output in form.encode(one) for message in messages(output.data)]


def registered() -> Sapient:
    form = Sapient(None, print)
    assert sent(form, picture(t=0)) == []
    (hello,) = messages(form.greeting())
    assert hello.registration.icd_version == "BSI Flex 335 v2.0"
    assert form.answer(ACCEPTED[:7]) + form.answer(ACCEPTED[7:]) == b""  # in two parts
    return form


def test_each_track_is_a_report_with_an_object_of_its_own() -> None:
    made = crowd(300, seed=8)
    status, *reports = sent(registered(), made)
    assert (status.status_report.system, status.status_report.node_location.z) == (1, SITE.height_m)
    assert len({message.detection_report.report_id for message in reports}) == 300
    assert len({message.detection_report.object_id for message in reports}) == 300
    for message, of in zip(reports, made.tracks, strict=True):
        report = message.detection_report
        assert message.node_id == status.node_id
        assert message.timestamp.timestamp() == pytest.approx(made.utc_s, abs=1e-3)
        assert (report.location.x, report.location.y) == (of.longitude, of.latitude)
        assert report.location.y_error * 111_195.0 == pytest.approx(math.sqrt(of.covariance[2, 2]), rel=1e-5)
        assert (report.enu_velocity.east_rate, report.enu_velocity.north_rate) == of.velocity
        assert report.detection_confidence == pytest.approx(of.existence)
        assert report.state == ("confirmed" if of.confirmed else "tentative")


def test_a_track_that_ends_is_lost_once_and_the_radar_says_goodbye() -> None:
    made = [picture(track(1), track(2)), picture(track(2), t=2), picture(track(2), t=3), picture(t=4).without_tracks()]
    found = sent(registered(), *made)
    reports = [message.detection_report for message in found if message.detection_report is not None]
    assert [report.state for report in reports] == ["confirmed", "confirmed", "lost", "confirmed", "confirmed", "lost"]
    assert reports[0].object_id == reports[2].object_id != reports[1].object_id == reports[5].object_id
    assert [message.status_report.system for message in found if message.status_report is not None] == [
        StatusReport.SYSTEM_OK,
        StatusReport.SYSTEM_GOODBYE,
    ]


def test_the_status_is_told_now_and_then() -> None:
    found = sent(registered(), *(picture(t=t) for t in range(1, 21)))
    assert len(found) == 20 / STATUS_S
    assert [message.status_report.info for message in found] == [1, 2, 2, 2]


def test_nothing_is_reported_before_the_radar_is_accepted() -> None:
    form = Sapient(None, print)
    assert sent(form, picture(track(1))) == []
    with pytest.raises(RunFailed, match="refused: 'no room'"):
        form.answer(framed(registration_ack={"acceptance": False, "ack_response_reason": ["no room"]}))
    with pytest.raises(ConnectionError, match="at most"):
        form.answer(b"\xff\xff\xff\xff")


def test_a_task_is_refused_and_told_why() -> None:
    (message,) = messages(registered().answer(framed(task={"task_id": TASK, "control": "CONTROL_START"})))
    assert message.destination_id == FUSION
    assert (message.task_ack.task_id, message.task_ack.task_status) == (TASK, 2)
    assert message.task_ack.reason == [NO_TASKS]


def test_another_run_registers_anew() -> None:
    found = sent(registered(), picture(track(1)), picture(track(1), run="r-2"), picture(track(1), run="r-2"))
    assert [message.registration is not None for message in found] == [False, False, True]


def test_over_a_connection_it_registers_waits_and_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.feed.transport.RETRY_S", 0.0)
    form = Sapient(None, print)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        way = Tcp("127.0.0.1", server.getsockname()[1], form, print)
        for i in range(2):  # connections
            way.send(form.encode(picture(track(1))))
            other, _ = server.accept()
            other.settimeout(5.0)
            (hello,) = messages(other.recv(1 << 16))
            assert hello.registration is not None
            other.sendall(ACCEPTED)
            for _ in range(2):
                way.send(form.encode(picture(track(1))))
            status, report = messages(other.recv(1 << 16))
            assert status.status_report is not None
            assert report.detection_report is not None
            other.close()
            if i == 0:
                way.send(form.encode(picture(track(1))))  # finds the connection gone
        way.close()
