"""Datagrams and connections, read at their other end."""

import socket
import time
from collections.abc import Iterator

import pytest

from cogradar.services.errors import BadInput
from cogradar.services.feed.feed import Tally, feed
from cogradar.services.feed.geojson import GeoJson
from cogradar.services.feed.output import Output
from cogradar.services.feed.picture import Picture
from cogradar.services.feed.sapient.node import Sapient
from cogradar.services.feed.transport import GAP_S, Tcp, Udp
from tests.services.feed.made import picture, track


def _nothing(_: str) -> None: ...


def test_datagrams_are_paced_and_none_is_joined() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        way = Udp("127.0.0.1", receiver.getsockname()[1], _nothing)
        began = time.monotonic()
        for i in range(0, 50, 5):  # pictures of five
            way.send([Output(bytes((j,)) * 1400) for j in range(i, i + 5)])
        assert time.monotonic() - began >= 49 * GAP_S
        assert [receiver.recv(2000) for _ in range(50)] == [bytes((i,)) * 1400 for i in range(50)]
        way.close()


def test_a_network_that_takes_no_datagrams_is_told_of_once_and_no_fault() -> None:
    said = list[str]()
    way = Udp("127.0.0.1", 9, said.append)
    way._socket.close()
    for _ in range(3):
        assert not way.send([Output(b"x"), Output(b"y")])
    assert said == ["udp://127.0.0.1:9: bad file descriptor; going on"]


def test_what_a_server_says_is_read_and_all_that_is_sent_last_arrives() -> None:
    """With data unread, a connection that is closed is reset, and the other end loses what was under way."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        way = Tcp("127.0.0.1", server.getsockname()[1], GeoJson(), _nothing)
        way.send([Output(b"<a/>")])
        other, _ = server.accept()
        other.settimeout(5.0)
        other.sendall(b"welcome" * 1000)
        time.sleep(0.1)
        way.send([Output(b"<b/>" * 10_000)])
        other.sendall(b"news" * 1000)
        way.close()
        heard = b""
        while data := other.recv(1 << 16):
            heard += data
        assert heard == b"<a/>" + b"<b/>" * 10_000
        other.close()


def test_a_connection_that_is_lost_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.feed.transport.RETRY_S", 0.0)
    said = list[str]()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        way = Tcp("127.0.0.1", server.getsockname()[1], GeoJson(), said.append)
        way.send([Output(b"<a/>"), Output(b"<b/>")])
        first, _ = server.accept()
        assert first.recv(100) == b"<a/><b/>"
        first.close()
        deadline = time.monotonic() + 5.0
        server.settimeout(0.05)
        while time.monotonic() < deadline:
            way.send([Output(b"<c/>")])
            try:
                second, _ = server.accept()
                break
            except TimeoutError:
                continue
        assert second.recv(100).startswith(b"<c/>")
        second.close()
        way.close()


def test_without_a_server_it_says_so_once_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.feed.transport.RETRY_S", 0.0)
    said = list[str]()
    way = Tcp("127.0.0.1", 9, GeoJson(), said.append)
    assert not way.send([Output(b"x")])
    assert not way.send([Output(b"y")])
    assert said == ["tcp://127.0.0.1:9: connection refused; trying again"]


class _Greeted(GeoJson):
    def greeting(self) -> bytes:
        return b"hello"


def test_a_picture_that_a_greeting_replaced_was_not_sent() -> None:
    tally = Tally()
    with socket.create_server(("127.0.0.1", 0)) as server:
        way = Tcp("127.0.0.1", server.getsockname()[1], _Greeted(), _nothing)
        feed([picture(track(1), t=t) for t in (1, 2, 3)], _Greeted(), way, 0.0, tally)
        other, _ = server.accept()
        assert other.recv(1 << 16).startswith(b"hello{")
        way.close()
        other.close()
    assert tally == Tally(3, 2)


def test_pictures_that_no_fusion_node_has_accepted_were_not_sent() -> None:
    tally, form = Tally(), Sapient(None, _nothing)
    with socket.create_server(("127.0.0.1", 0)) as server:
        way = Tcp("127.0.0.1", server.getsockname()[1], form, _nothing)
        feed([picture(track(1), t=t) for t in (1, 2, 3)], form, way, 0.0, tally)
        way.close()
    assert tally == Tally(3, 0)


def test_after_a_server_that_closes_at_once_its_pictures_are_lost() -> None:
    """Those that were made, and none of those without tracks at an end."""
    tally = Tally()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def pictures() -> Iterator[Picture]:
            yield picture(track(1))
            server.accept()[0].close()
            server.close()
            time.sleep(0.1)
            yield from (picture(track(1), t=t) for t in (2, 3))

        way = Tcp("127.0.0.1", server.getsockname()[1], GeoJson(), _nothing)
        feed(pictures(), GeoJson(), way, 0.0, tally)
        way.close()
    assert tally.words(way) == f"1 of 3 pictures {way.done}; the others were lost"


def test_a_host_that_there_is_not_is_bad_input() -> None:
    with pytest.raises(BadInput, match=r"--out udp://no\.such\.host\.invalid:1: "):
        Udp("no.such.host.invalid", 1, _nothing)
    with pytest.raises(BadInput, match=r"--out udp://a\.\.b:1: "):
        Udp("a..b", 1, _nothing)
