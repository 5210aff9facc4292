"""Tasks of a fusion node, as it sends them over a connection, and what becomes of them."""

import socket
from concurrent.futures import Future
from typing import Any

import pytest
from sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2 import SapientMessage as Message

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.picture import Picture
from cogradar.services.feed.sapient.node import Sapient
from cogradar.services.feed.sapient.tasking import ACCEPTED, COMPLETED, FAILED, MAX_TASKS, REJECTED, Asked
from cogradar.services.feed.transport import Tcp
from cogradar.services.skies.place import Place
from cogradar.shared.protocol.words.orders import text_of
from tests.services.feed.fusion import PAUSE, START, STOP, TASK, Fusion
from tests.services.feed.made import SITE, UTC_S, picture, track
from tests.services.feed.test_sapient import ACCEPTED as WELCOME
from tests.services.feed.test_sapient import FUSION, framed, messages

NOTICE = 5  # dwells until an order is in force
OF_INTEREST, IGNORED, BOUNDARY = 1, 2, 3
DEGREES, RADIANS, TRUE, MAGNETIC = 1, 2, 1, 2


class Radar:
    """Grants commands some dwells later, or fails."""

    def __init__(self) -> None:
        self.asked = list[tuple[str, int]]()
        self.k = 0  # newest dwell
        self.error: Exception | None = None

    def __call__(self, asked: Asked) -> Future[dict[str, Any]]:
        assert asked.asker == f"SAPIENT {FUSION}"
        self.asked.append((text_of(asked.action), asked.at))
        answer = Future[dict[str, Any]]()
        if self.error is not None:
            answer.set_exception(self.error)
        else:
            answer.set_result({"action": text_of(asked.action), "k": max(self.k + NOTICE, asked.at)})
        return answer


class Node:
    """The radar's end, without a connection: tasks in, acknowledgements out."""

    def __init__(self) -> None:
        self.radar, self.dropped = Radar(), list[str]()
        self.form = Sapient(self.radar, self.dropped.append)
        self.form.encode(self.at(0))
        (hello,) = messages(self.form.greeting())
        self.name = hello.node_id
        assert self.form.answer(WELCOME) == b""
        self.pass_to(1)

    def at(self, k: int, *, is_paused: bool = False) -> Picture:
        self.radar.k = k
        return picture(track(7), t=k)._replace(k=k, is_paused=is_paused)

    def task(self, control: int = START, name: int = 0, **content: Any) -> list[tuple[int, str]]:
        """What is said of a task at once."""
        return acks(self.form.answer(framed(task={"task_id": TASK.format(name), "control": control, **content})))

    def pass_to(self, k: int, *, is_paused: bool = False) -> list[tuple[int, str]]:
        """What is said of tasks with the picture of a dwell."""
        return acks(b"".join(output.data for output in self.form.encode(self.at(k, is_paused=is_paused))))

    def object(self) -> str:
        """The only track's."""
        (output,) = (o for o in self.form.encode(self.at(1)) if b"confirmed" in o.data)
        (report,) = messages(output.data)
        return str(report.detection_report.object_id)


def acks(data: bytes) -> list[tuple[int, str]]:
    found = [message for message in messages(data) if message.task_ack is not None]
    assert {message.destination_id for message in found} <= {FUSION}
    return [(message.task_ack.task_status, message.task_ack.reason[0]) for message in found]


def cone(azimuth: float, extent: float | None = None, units: int = DEGREES, datum: int = TRUE, **more: Any) -> Any:
    width = {} if extent is None else {"horizontal_extent": extent}
    return {"range_bearing": {"azimuth": azimuth, "coordinate_system": units, "datum": datum, **width, **more}}


def places(*at: tuple[float, float], units: int = 1) -> Any:
    """Places by x and y in km."""
    found = [Place.of(SITE).position(x, y) for x, y in at]
    told = [{"x": lon, "y": lat, "coordinate_system": units, "datum": 1} for lat, lon in found]
    return {"location_list": {"locations": told}}


def region(area: Any, kind: int = OF_INTEREST, **more: Any) -> Any:
    name = {"region_id": TASK.format("R"), "region_name": "R"}
    return {"region": [{"type": kind, **name, "region_area": area, **more}]}


def command(**content: Any) -> Any:
    return {"command": content}


def time(s: float) -> Any:
    return {"seconds": round(UTC_S + s)}


DONE = [
    (command(look_at=cone(72.5)), "look 12.5 10 0.2"),
    (command(look_at=cone(1.2653637076958888, 0.1, RADIANS)), "look 12.5 10 0.2"),
    (command(look_at=places((50.0, 10.0))), "look 11.3099 10 0.2"),
    (command(look_at=cone(345.0)) | {"task_end_time": time(31.0)}, "look -75 30 0.2"),
    (region(cone(60.0, 20.0)), "sector double -10 10"),
    (region(cone(60.0, 180.0)), "sector double -90 90"),
    (region(places((50.0, 0.0), (50.0, 50.0), (40.0, -40.0))), "sector double -45 45"),
    (region(cone(30.0, 10.0), IGNORED), "sector blank -35 -25"),
    (command(mode_change="pause"), "pause"),
    (command(mode_change="pause") | {"task_end_time": time(21.0)}, "pause 20"),
    (command(mode_change="search and track"), "resume"),
    (command(request="Stop"), "pause"),
    (command(request="start"), "resume"),
    (command(request="power 0.5"), "power 0.5"),
    (command(request="drop 7"), "drop 7"),
]


@pytest.mark.parametrize(("content", "words"), DONE)
def test_a_task_becomes_a_command(content: Any, words: str) -> None:
    node = Node()
    assert node.task(**content) == []
    assert node.radar.asked == [(words, 0)]
    assert node.pass_to(2) == [(ACCEPTED, f"{words} from dwell 6 on")]


REFUSED = [
    ({}, "either one region or one command"),
    (region(cone(60.0, 20.0)) | command(mode_change="pause"), "either one region or one command"),
    (command(look_at=cone(160.0)), "100 degrees from boresight: must be -90 .. 90"),
    (command(look_at=cone(float("nan"))), "nan degrees from boresight"),
    (command(look_at=cone(72.5, units=3, datum=MAGNETIC)), "datum: must be RANGE_BEARING_DATUM_TRUE"),
    (command(look_at=places((50.0, 1.0), (50.0, 2.0))), "2 locations: must be one"),
    (command(look_at=places((50.0, 1.0), units=3)), "must be latitude and longitude"),
    (command(look_at=places((-50.0, 1.0))), "degrees from boresight"),
    (command(look_at=cone(72.5)) | {"task_end_time": time(1e6)}, "dwells = "),
    (command(detection_threshold=2), "detection_threshold: this radar takes look_at, follow, mode_change, request"),
    (command(move_to=places((50.0, 1.0))["location_list"]), "move_to: this radar takes"),
    (command(follow={"follow_object_id": TASK.format(1)}), "is no object of the newest reports"),
    (command(mode_change="sleep"), "mode_change: 'sleep': must be 'search and track' or 'pause'"),
    (command(request="reset"), "must be one of power SHARE"),
    (command(request="power 2"), "share"),
    (command(request="power 0.5") | {"task_end_time": time(50.0)}, "nothing takes back `power 0.5`"),
    (command(mode_change="pause", command_parameter="now"), "command_parameter"),
    (command(mode_change="pause") | {"task_end_time": time(0.0)}, "task_end_time"),
    (region(cone(60.0, 20.0), BOUNDARY), "must be an area of interest or one to be ignored"),
    (region(cone(60.0, 20.0, range=9e3), IGNORED), "blanked at all ranges"),
    (region(cone(60.0)), "horizontal_extent: 0 degrees"),
    (region(cone(140.0, 30.0)), "95 degrees from boresight"),
    (region(places((50.0, 1.0))), "must be 2 or more"),
    (region(places((50.0, 1.0), (60.0, 1.2))), "from_deg must be below to_deg"),
]


@pytest.mark.parametrize(("content", "words"), REFUSED)
def test_what_cannot_be_done_is_said(content: Any, words: str) -> None:
    node = Node()
    ((status, reason),) = node.task(**content)
    assert (status, node.radar.asked) == (REJECTED, [])
    assert words in reason


def test_a_region_is_searched_until_its_task_is_stopped() -> None:
    node = Node()
    area = region(cone(60.0, 20.0))
    assert node.task(**area) == []
    assert node.task(**area) == []  # sent again: it is asked once
    assert node.pass_to(2) == [(ACCEPTED, "sector double -10 10 from dwell 6 on")]
    assert node.task(**area) == [(ACCEPTED, "sector double -10 10 from dwell 6 on")]
    ((status, reason),) = node.task(**region(cone(60.0, 30.0)))
    assert (status, "another task of this identifier" in reason) == (REJECTED, True)
    assert node.task(PAUSE)[0][0] == node.task(STOP, 1)[0][0] == REJECTED
    assert node.pass_to(3) == node.task(STOP) == node.pass_to(4) == []
    assert node.radar.asked == [("sector double -10 10", 0), ("sector normal -10 10", 6)]  # not before it begins
    assert node.pass_to(5) == [(COMPLETED, "sector normal -10 10 from dwell 9 on")]
    assert node.task(STOP) == [(REJECTED, "no task of this identifier goes on")]


def test_a_task_begins_and_ends_at_its_times() -> None:
    node = Node()
    node.task(**region(cone(60.0, 20.0)), task_start_time=time(31.0), task_end_time=time(41.0))
    assert node.radar.asked == [("sector double -10 10", 31)]
    assert [node.pass_to(2)[0][0], *node.pass_to(40)] == [ACCEPTED]
    assert len(node.radar.asked) == 1
    assert node.pass_to(41) == []
    assert node.pass_to(42) == [(COMPLETED, "sector normal -10 10 from dwell 46 on")]


def test_what_ends_by_itself_is_completed_and_cannot_be_stopped() -> None:
    node = Node()
    node.task(**command(look_at=cone(60.0)))
    node.task(name=1, **command(request="drop 7"))
    assert [status for status, _ in node.pass_to(2)] == [ACCEPTED] * 2
    ((status, reason),) = node.task(STOP)
    assert (status, reason) == (REJECTED, "nothing takes back `look 0 10 0.2`")
    assert node.pass_to(5) == []
    assert node.pass_to(6) == [(COMPLETED, "drop 7: done with dwell 6")]
    assert node.pass_to(15) == []
    assert node.pass_to(16) == [(COMPLETED, "look 0 10 0.2: done with dwell 16")]


def test_an_object_is_followed_until_its_track_ends() -> None:
    node = Node()
    assert node.task(**command(follow={"follow_object_id": node.object()})) == []
    assert node.radar.asked == [("priority 7 4", 0)]
    assert node.pass_to(2) == [(ACCEPTED, "priority 7 4 from dwell 6 on")]
    ((status, _),) = acks(b"".join(o.data for o in node.form.encode(picture(t=3)._replace(k=3))))
    assert status == COMPLETED


def test_why_the_run_refuses_or_does_not_answer_is_said() -> None:
    node = Node()
    node.radar.error = BadInput("r-1: refused: there is no track 9")
    node.task(**command(request="drop 9"))
    assert node.pass_to(2) == [(REJECTED, "r-1: refused: there is no track 9")]
    node.radar.error = RunFailed("nobody confirmed")
    node.task(**command(request="drop 9"))
    assert node.pass_to(3) == [(FAILED, "nobody confirmed")]
    node.radar.error = None
    node.task(**command(mode_change="pause"))
    assert node.pass_to(4)[0][0] == ACCEPTED
    node.radar.error = RunFailed("nobody confirmed")
    assert node.task(STOP) == node.pass_to(5) == []
    assert node.pass_to(6) == [(FAILED, "it goes on, and may be stopped again: nobody confirmed")]
    node.radar.error = None
    assert node.task(STOP) == node.pass_to(7) == []
    assert node.pass_to(8)[0][0] == COMPLETED


def test_with_the_run_its_tasks_end() -> None:
    node = Node()
    node.task(**command(mode_change="pause"))
    node.pass_to(2)
    last = node.at(3).without_tracks()
    ((status, _),) = acks(b"".join(output.data for output in node.form.encode(last)))
    assert status == FAILED
    assert node.task(**command(mode_change="pause")) == [(REJECTED, "the radar has said goodbye")]


def test_a_task_whose_order_another_one_replaces_is_over() -> None:
    node = Node()
    node.task(**command(mode_change="pause"))
    node.task(name=1, **region(cone(60.0, 20.0)))
    assert [status for status, _ in node.pass_to(2)] == [ACCEPTED] * 2
    assert node.pass_to(6) == []
    node.task(name=2, **command(mode_change="search and track"))
    node.task(name=3, **region(cone(60.0, 60.0)))
    assert [status for status, _ in node.pass_to(7)] == [ACCEPTED] * 2
    assert node.pass_to(10) == []
    replaced = (COMPLETED, "a later task or command has replaced it")
    assert node.pass_to(11) == [replaced, replaced, (COMPLETED, "resume: done with dwell 11")]
    assert node.task(STOP) == [(REJECTED, "no task of this identifier goes on")]


def test_a_pause_that_somebody_else_ends_is_over() -> None:
    node = Node()
    node.task(**command(mode_change="pause"))
    node.pass_to(2)
    assert [node.pass_to(k, is_paused=paused) for k, paused in ((6, False), (7, True), (8, True))] == [[]] * 3
    assert node.pass_to(9) == [(COMPLETED, "a later task or command has replaced it")]


def test_so_many_tasks_go_on_at_a_time() -> None:
    node = Node()
    for i in range(MAX_TASKS):
        name = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"[i]
        assert acks(node.form.answer(framed(task={"task_id": TASK.format(name), "control": 1, **DONE[4][0]}))) == []
    ((status, reason),) = acks(
        node.form.answer(framed(task={"task_id": TASK.format("0")[::-1], "control": 1, **DONE[4][0]}))
    )
    assert (status, reason) == (REJECTED, f"{MAX_TASKS} tasks go on, which is the most: stop one")


def test_what_is_no_message_is_dropped_counted_and_told() -> None:
    node = Node()
    other = framed(task={"task_id": TASK.format(0), "control": START, **DONE[0][0]})
    for bad in (
        b"\xff\xff",
        b"hello",
        Message(destination_id=TASK, task={"task_id": TASK.format(0)}).SerializeToString(),
    ):
        assert node.form.answer(len(bad).to_bytes(4, "little") + bad) == b""
    nameless = Message(node_id=FUSION, task={"task_id": "u" * 26, "control": START}).SerializeToString()
    for _ in range(7):
        assert node.form.answer(len(nameless).to_bytes(4, "little") + nameless) == b""
    assert node.dropped == [
        "SAPIENT: 2 bytes that are no message; 1 messages dropped so far",
        f"SAPIENT: a task whose identifier is no ULID: {'u' * 26!r}; 10 messages dropped so far",
    ]
    assert node.form.answer(other[:9]) + node.form.answer(other[9:]) == b""
    assert node.radar.asked == [("look 12.5 10 0.2", 0)]


def test_registration_and_status_are_told_again_to_whoever_asks() -> None:
    node = Node()
    hello, ack = messages(
        node.form.answer(framed(task={"task_id": TASK.format(0), "control": 1, "command": {"request": "Registration"}}))
    )
    assert (hello.node_id, ack.task_ack.task_status) == (node.name, COMPLETED)
    (mode, paused) = hello.registration.mode_definition
    assert (mode.mode_name, paused.mode_name) == ("search and track", "pause")
    assert [offered.type for offered in mode.task.command] == [6, 9, 5, 1]
    assert mode.task.concurrent_tasks == MAX_TASKS


def test_over_a_connection_a_task_is_done_and_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.feed.transport.RETRY_S", 0.0)
    radar, said = Radar(), list[str]()
    form = Sapient(radar, said.append)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        way = Tcp("127.0.0.1", server.getsockname()[1], form, said.append)

        def dwell(k: int, *, is_paused: bool = False) -> None:
            radar.k = k
            way.send(form.encode(picture(track(7), t=k)._replace(k=k, is_paused=is_paused)))

        dwell(1)
        fusion = Fusion(server)
        fusion.send()
        fusion.task(0, command={"mode_change": "pause"})
        dwell(2)  # in which it is read
        dwell(3)
        assert fusion.until("task_ack", task_status=ACCEPTED).reason == ["pause from dwell 7 on"]
        assert fusion.until("status_report", mode="search and track").active_task_id == TASK.format(0)
        dwell(7, is_paused=True)
        assert fusion.until("status_report", mode="pause").active_task_id == TASK.format(0)
        fusion.task(0, STOP)
        for k in (8, 9, 10):  # it is read, undone, acknowledged
            dwell(k, is_paused=True)
        assert fusion.until("task_ack", task_status=COMPLETED).reason == ["resume from dwell 14 on"]
        fusion.send(b"\xff\xff\xff\xff and more")  # no length of a message: the connection is made anew
        dwell(11)
        dwell(12)
        again = Fusion(server)
        assert [text for text in said if "4294967295 bytes" in text]
        way.close()
        fusion.close()
        again.close()


def test_acknowledgements_that_an_outage_may_have_taken_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that were sent before it was noticed, and those that were due while no connection could be had."""
    monkeypatch.setattr("cogradar.services.feed.transport.RETRY_S", 0.0)
    radar, said = Radar(), list[str]()
    form = Sapient(radar, said.append)

    def dwell(k: int) -> None:
        radar.k = k
        way.send(form.encode(picture(track(7), t=k)._replace(k=k)))

    server = socket.create_server(("127.0.0.1", 0))
    port = server.getsockname()[1]
    way = Tcp("127.0.0.1", port, form, said.append)
    dwell(1)
    fusion = Fusion(server)
    fusion.send()
    fusion.task(0, **command(look_at=cone(72.5)))
    fusion.task(1, **command(mode_change="pause"))
    dwell(2)  # in which they are read
    fusion.close()
    server.close()
    for k in (3, 12, 16, 17):  # accepted into a connection that is none; the look is over meanwhile
        dwell(k)
    assert said
    with socket.create_server(("127.0.0.1", port)) as server:
        dwell(18)
        again = Fusion(server)
        again.send()
        dwell(19)
        dwell(20)
        assert again.until("task_ack", task_id=TASK.format(0), task_status=ACCEPTED)
        assert again.until("task_ack", task_id=TASK.format(1)).reason == ["pause from dwell 7 on"]
        assert again.until("task_ack").reason == ["look 12.5 10 0.2: done with dwell 17"]
        assert again.until("status_report").active_task_id == TASK.format(1)
        way.close()
        again.close()
