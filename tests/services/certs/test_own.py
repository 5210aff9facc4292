"""Who shows a certificate of another role than it needs is told so, and a planner's says for which tracks it plans."""

import datetime
import json
import os
import subprocess
import sys
import threading
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from cogradar.services import process
from cogradar.services.certs import authority, names, own
from cogradar.services.errors import BadInput
from cogradar.services.topology import Start
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.session import CONFIG_VARIABLE

HERE, OPEN = "tls/127.0.0.1:1", "tcp/127.0.0.1:1"
Told = Callable[..., None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "certs"
    authority.create(folder, 2)
    holders = [*(f"{role}.a" for role in Role), "planner.a@0-7", "planner.a@0-15", "observer.wall"]
    authority.issue(folder, holders, ["127.0.0.1"], 1)
    return folder


@pytest.fixture
def is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    return lambda name: monkeypatch.setenv(CONFIG_VARIABLE, str(folder / name / names.SETTINGS))


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Told:
    """Settings of TLS in a file of one's own."""

    def tell(**tls: Any) -> None:
        file = tmp_path / "zenoh.json5"
        file.write_text(json.dumps({"transport": {"link": {"tls": {"enable_mtls": True} | tls}}}))
        monkeypatch.setenv(CONFIG_VARIABLE, str(file))

    return tell


def foreign(tmp_path: Path, name: str, issuer: str) -> str:
    """A certificate of somebody else's authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
        .issuer_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, issuer)]))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .sign(key, hashes.SHA256())
    )
    file = tmp_path / "foreign.pem"
    file.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    return str(file)


@pytest.mark.parametrize("role", Role)
def test_each_role_starts_with_its_own(role: Role, is_told: Callable[[str], None]) -> None:
    is_told(f"{role}.a")
    assert own.process_name(role, "p", HERE) == f"{role}.a"


@pytest.mark.parametrize(
    ("certificate", "name"),
    [
        ("planner.a", "p"),
        ("planner.a", "p@0-15"),
        ("planner.a@0-15", "p"),
        ("planner.a@0-7", "p"),
        ("planner.a@0-7", "p@0-7"),
    ],
)
def test_a_planner_has_the_name_and_the_slots_of_its_certificate(
    certificate: str, name: str, is_told: Callable[[str], None]
) -> None:
    is_told(certificate)
    assert own.process_name(Role.PLANNER, name, HERE) == certificate


@pytest.mark.parametrize(("certificate", "slots"), [("planner.a@0-7", "0-7"), ("planner.a", "0-15")])
def test_other_slots_than_on_the_certificate_are_refused(
    certificate: str, slots: str, is_told: Callable[[str], None]
) -> None:
    is_told(certificate)
    with pytest.raises(BadInput, match=f"--name: behind @ must be {slots} as on the certificate, {certificate};"):
        own.process_name(Role.PLANNER, "p@0-3", HERE)


def test_a_service_starts_under_the_name_with_its_slots(
    is_told: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    is_told("planner.a@0-7")
    served: list[str] = []
    monkeypatch.setattr(process, "_serve", lambda _service, start, *_: served.append(start.name))
    process.be(Role.PLANNER, Start("p"), connect=f"{OPEN},{HERE}", listen=OPEN, stop=threading.Event())
    assert served == ["planner.a@0-7"]


@pytest.mark.parametrize(
    ("certificate", "arguments", "needed"),
    [
        ("observer.wall", ["service", "planner"], "planner.NAME"),
        ("planner.a", ["query", "runs"], "operator.NAME or metrics.NAME or observer.NAME or commander.NAME"),
        ("observer.wall", ["cancel", "r"], "operator.NAME"),
        ("observer.wall", ["command", "r", "end"], "operator.NAME or commander.NAME"),
        ("observer.wall", ["run", "smoke"], "operator.NAME"),
        ("observer.wall", ["run", "smoke", "--detach"], "operator.NAME"),
    ],
)
def test_a_command_with_another_roles_certificate_ends_with_code_2_and_says_why(
    certificate: str, arguments: list[str], needed: str, folder: Path
) -> None:
    environment = os.environ | {"COGRADAR_CONNECT": HERE, CONFIG_VARIABLE: str(folder / certificate / names.SETTINGS)}
    command = [sys.executable, "-m", "cogradar", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    said = f"--zenoh-config: its certificate is {certificate}'s; this needs one of {needed}\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)


def test_a_certificate_that_is_not_shown_or_not_ours_says_nothing(
    told: Told, is_told: Callable[[str], None], tmp_path: Path
) -> None:
    is_told("observer.wall")
    for endpoint in (OPEN, f"{HERE}#connect_certificate_file=other.pem"):
        assert own.process_name(Role.PLANNER, "p", endpoint) == "p"
    ours = foreign(tmp_path, "metrics.lan", authority.AUTHORITY)
    told(connect_certificate=ours, enable_mtls=False)
    assert own.process_name(Role.PLANNER, "p", HERE) == "p"
    told(connect_certificate=ours)
    with pytest.raises(BadInput, match=r"is metrics\.lan's"):
        own.process_name(Role.PLANNER, "p", HERE)
    told(connect_certificate=foreign(tmp_path, "metrics.lan", "a company"))
    assert own.process_name(Role.PLANNER, "p", HERE) == "p"
    told()
    assert own.process_name(Role.PLANNER, "p", HERE) == "p"


def test_a_router_is_known_by_what_it_listens_with(told: Told, folder: Path, tmp_path: Path) -> None:
    files = {name: tmp_path / f"{name}.pem" for name in ("router.a", "operator.a")}
    for name, file in files.items():
        settings = json.loads((folder / name / names.SETTINGS).read_text())["transport"]["link"]["tls"]
        file.write_bytes(b64decode(settings["connect_certificate_base64"]))
    told(listen_certificate=str(files["router.a"]), connect_certificate=str(files["operator.a"]))
    assert own.process_name(Role.ROUTER, "router", HERE) == "router.a"
    assert own.check(HERE, own.ASKING) == "operator.a"


def test_a_certificate_that_cannot_be_read_is_named_with_its_key(told: Told, tmp_path: Path) -> None:
    (tmp_path / "none.pem").write_text("nothing")
    for tls, said in (
        ({"connect_certificate": "nowhere.pem"}, r"tls/connect_certificate = nowhere\.pem: no such file or directory$"),
        ({"connect_certificate_base64": "a"}, r"zenoh\.json5: transport/link/tls/connect_certificate: "),
        ({"connect_certificate": str(tmp_path / "none.pem")}, "what it has for a certificate is none"),
    ):
        told(**tls)
        with pytest.raises(BadInput, match=said):
            own.process_name(Role.PLANNER, "p", HERE)
