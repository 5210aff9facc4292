"""A process goes by its certificate: another role's is refused, and a planner's says for which tracks it plans."""

import json
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from services import process
from services.certs import authority, names
from services.cli.app import app
from services.errors import BadInput
from services.topology import Start
from shared.protocol.topics import Role
from shared.wire.session import CONFIG_VARIABLE, BadConfig, own_certificate


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "certs"
    authority.create(folder, 2)
    authority.issue(folder, ["planner.a@0-7", "observer.wall"], [], 1)
    return folder


@pytest.mark.parametrize(
    ("certificate", "name", "found"),
    [
        ("planner.a", "p", "p"),
        ("planner.a", "p@0-7", "p@0-7"),  # who may plan for all may limit itself
        ("planner.a@0-7", "p", "p@0-7"),
        ("planner.a@0-7", "p@0-7", "p@0-7"),
        ("radar.example", "p", "p"),
        ("", "p", "p"),
    ],
)
def test_a_planner_has_the_slots_of_its_certificate(certificate: str, name: str, found: str) -> None:
    assert names.of_process(Role.PLANNER, name, certificate) == found


def test_a_process_that_the_router_would_not_listen_to_does_not_start() -> None:
    with pytest.raises(BadInput, match=r"that of planner\.a@0-7, not of one of role recorder"):
        names.of_process(Role.RECORDER, "r", "planner.a@0-7")
    with pytest.raises(BadInput, match=r"--name 'p@0-3': behind @ must be 0-7, as on its certificate"):
        names.of_process(Role.PLANNER, "p@0-3", "planner.a@0-7")


def test_a_service_with_another_roles_certificate_ends_with_code_2_and_says_why(folder: Path) -> None:
    config = str(folder / "observer.wall" / names.SETTINGS)
    done = CliRunner().invoke(app, ["service", "planner", "--zenoh-config", config])
    assert (done.exit_code, done.stdout) == (2, "")
    assert "the certificate of --zenoh-config is that of observer.wall, not of one of role planner" in done.stderr


def test_a_limited_planner_connects_under_a_name_with_its_slots(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CONFIG_VARIABLE, str(folder / "planner.a@0-7" / names.SETTINGS))
    served: list[str] = []
    monkeypatch.setattr(process, "_serve", lambda _service, start, *_: served.append(start.name))
    process.be(Role.PLANNER, Start("p"), connect="", listen="", stop=threading.Event())
    assert served == ["p@0-7"]


def test_a_certificate_may_be_a_file_or_none_at_all(folder: Path, tmp_path: Path) -> None:
    issued = own_certificate(str(folder / "planner.a@0-7" / names.SETTINGS))
    assert issued is not None
    (tmp_path / "own.pem").write_bytes(issued)
    settings = tmp_path / "zenoh.json5"

    def told(**tls: str) -> str:
        settings.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
        return str(settings)

    assert own_certificate(told(connect_certificate=str(tmp_path / "own.pem"))) == issued
    assert own_certificate(told()) is None
    with pytest.raises(BadConfig, match=r"none\.pem: no such file"):
        own_certificate(told(connect_certificate=str(tmp_path / "none.pem")))
    with pytest.raises(BadConfig, match="connect_certificate_base64: not Base64"):
        own_certificate(told(connect_certificate_base64="a"))
    with pytest.raises(BadInput, match="is none"):
        authority.name_on(b"nothing")
