"""Where HTTP is served: what was asked for, or the next port that is free."""

import socket
import time
from pathlib import Path

import httpx
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web.address import HERE, HOSTS_VARIABLE, allowed, inherited, is_loopback, listen, url
from cogradar.services.web.server import ServedMetrics, Server


def _port(listener: socket.socket | None) -> int:
    assert listener is not None
    return int(listener.getsockname()[1])


def test_the_next_free_port_is_taken() -> None:
    first = listen("127.0.0.1:0")
    second = listen(f"127.0.0.1:{_port(first)}")
    assert first is not None
    assert second is not None
    with first, second:
        assert _port(first) < _port(second) <= _port(first) + 50
        assert url(second) == f"http://127.0.0.1:{_port(second)}"


def test_it_may_be_off() -> None:
    assert listen("") is listen("off") is None


@pytest.mark.parametrize(
    "text",
    ["8080", "localhost", "127.0.0.1:http", "127.0.0.1:70000", "192.0.2.1:8080", "no.such.host.invalid:1", "::1"],
)
def test_what_is_no_address_of_this_machine_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match=f"--http {text}: "):
        listen(text)


def test_only_an_explicit_address_is_reached_from_outside() -> None:
    for text, here in (("127.0.0.1:0", True), ("localhost:0", True), ("0.0.0.0:0", False)):
        listener = listen(text)
        assert listener is not None
        with listener:
            assert is_loopback(listener) == here
            assert url(listener).startswith("http://127.0.0.1:" if "localhost" not in text else "http://")


def test_a_socket_of_the_parent_is_served_on() -> None:
    ours = listen("127.0.0.1:0")
    assert ours is not None
    theirs = listen(inherited(ours, "localhost:0"))
    assert theirs is not None
    assert theirs.getsockname() == ours.getsockname()
    theirs.detach()
    ours.close()


def test_a_server_that_is_closed_frees_its_port(core: MetricsCore) -> None:
    listener = listen("127.0.0.1:0")
    assert listener is not None
    port, address = _port(listener), url(listener)
    server = Server(core, listener)
    assert httpx.get(f"{address}/healthz", timeout=30.0).status_code == 200
    began = time.monotonic()
    server.close()
    assert time.monotonic() - began < 2.0
    again = listen(f"127.0.0.1:{port}")
    assert again is not None
    with again:
        assert _port(again) == port


def test_the_names_that_it_is_asked_under_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(HOSTS_VARIABLE, raising=False)
    here, everywhere = listen("127.0.0.1:0"), listen("0.0.0.0:0")
    assert here is not None
    assert everywhere is not None
    with here, everywhere:
        assert allowed(here, "127.0.0.1:0") == set(HERE)
        assert allowed(here, "MyHost:8080") == {*HERE, "myhost"}
        assert allowed(here, inherited(here, "myhost:8080")) == {*HERE, "myhost"}
        assert allowed(everywhere, "0.0.0.0:8080") is None
        monkeypatch.setenv(HOSTS_VARIABLE, "localhost, [::1],Radar")
        assert allowed(everywhere, "0.0.0.0:8080") == {"localhost", "[::1]", "radar"}
        assert allowed(here, "127.0.0.1:0") == {*HERE, "radar"}


def test_a_service_serves_the_names_of_its_environment(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(HOSTS_VARIABLE, "radar")
    monkeypatch.setattr("cogradar.services.web.server.listen", lambda text: _kept(listen(text)))
    served: list[socket.socket] = []

    def _kept(listener: socket.socket | None) -> socket.socket | None:
        assert listener is not None
        served.append(listener)
        return listener

    core = ServedMetrics(str(journal), "0.0.0.0:0")
    address = url(served[0])
    found = [httpx.get(f"{address}/healthz", headers={"Host": host}).status_code for host in ("radar", "evil.example")]
    core.close()
    assert found == [200, 421]
