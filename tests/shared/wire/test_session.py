"""Sessions: settings of Zenoh's own, endpoints, and a router that says whether it is open."""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from cogradar.shared.wire.queries import ask_expositions
from cogradar.shared.wire.session import CONFIG_VARIABLE, BadConfig, check_config, free_port, open_session, run_router

pytestmark = pytest.mark.zenoh


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file or directory"),
        (b"\xff\xfe\x00", "not a text file"),
        (b"{ mode: ", "not a configuration of Zenoh"),
        (b"{ transport: { link: { tls: { enable_mtsl: true } } } }", "not a configuration of Zenoh"),
    ],
)
def test_a_file_that_zenoh_does_not_take_is_named(content: bytes | None, said: str, tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(BadConfig) as refused:
        check_config(str(file))
    assert str(refused.value).startswith(f"{file}: ")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_ours_come_on_top_of_a_file_and_the_environment_may_name_it(
    router: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session with the file's identity, as a client of the router that we name."""
    file = tmp_path / "zenoh.json5"
    file.write_text("{ id: 'c0ffee', mode: 'peer', connect: { endpoints: ['tcp/127.0.0.1:1'] } } // JSON5")
    with open_session([router], 10.0, lambda: None, file=str(file)) as session:
        assert str(session.zid()) == "c0ffee"
        assert len(session.info.routers_zid()) == 1
    monkeypatch.setenv(CONFIG_VARIABLE, str(file))
    with open_session([router], 10.0, lambda: None) as session:
        assert str(session.zid()) == "c0ffee"


def test_other_links_of_zenoh_are_taken(tmp_path: Path) -> None:
    for endpoint in (
        f"unixsock-stream/{tmp_path}/router",
        f"udp/127.0.0.1:{free_port()}",
        f"ws/127.0.0.1:{free_port()}",
    ):
        _while_listening(endpoint, lambda at: open_session([at], 10.0, lambda: None).close())


def _while_listening(endpoint: str, act: Callable[[str], None]) -> None:
    stop = threading.Event()
    thread = threading.Thread(target=run_router, args=(endpoint, stop))
    thread.start()
    try:
        act(endpoint)
    finally:
        stop.set()
        thread.join()


def test_a_router_without_certificates_says_that_it_is_open(caplog: pytest.LogCaptureFixture) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with caplog.at_level(logging.WARNING):
        _while_listening(endpoint, lambda at: open_session([at], 10.0, lambda: None).close())
    assert f"{endpoint} is open: any client may read and send everything" in caplog.text


def test_who_may_do_what_needs_certificates() -> None:
    with pytest.raises(BadConfig, match="rights are told by certificates, so it must be tls/HOST:PORT"):
        run_router("tcp/127.0.0.1:0", threading.Event(), access={"enabled": True})


def test_of_a_session_that_is_closed_no_process_answers(router: str) -> None:
    """As a page still asks while metrics ends: its log had a traceback."""
    session = open_session([router], 10.0, lambda: None)
    session.close()
    assert list(ask_expositions(session, 1.0, 1000)) == []
