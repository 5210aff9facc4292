"""The authority: what it writes, who may read it, and what it refuses."""

import datetime
import json
import stat
from base64 import b64decode
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from typer.testing import CliRunner

from cogradar.services.certs import authority
from cogradar.services.certs.names import ALLOWED
from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    authority.create(tmp_path / "certs", 30)
    return tmp_path / "certs"


def _certificate(file: Path) -> x509.Certificate:
    tls: dict[str, Any] = json.loads(file.read_text())["transport"]["link"]["tls"]
    return x509.load_pem_x509_certificate(b64decode(tls["connect_certificate_base64"]))


def test_a_certificate_names_its_process_is_signed_and_ends(folder: Path) -> None:
    (file,) = authority.issue(folder, ["planner.host-1"], [], 7)
    made, signer = _certificate(file), x509.load_pem_x509_certificate((folder / "ca.crt").read_bytes())
    made.verify_directly_issued_by(signer)
    assert [name.value for name in made.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == ["planner.host-1"]
    assert made.not_valid_after_utc - made.not_valid_before_utc == datetime.timedelta(days=7, minutes=5)
    assert (folder / ALLOWED).read_text() == "planner.host-1\n"


def test_only_a_router_can_pass_for_a_router(folder: Path) -> None:
    files = authority.issue(folder, ["router.a", "planner.b"], ["radar.example", "10.0.0.1"], 7)
    uses = [_certificate(file).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value for file in files]
    assert [ExtendedKeyUsageOID.SERVER_AUTH in use for use in uses] == [True, False]
    places = _certificate(files[0]).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert places.get_values_for_type(x509.DNSName) == ["radar.example"]
    assert [str(place) for place in places.get_values_for_type(x509.IPAddress)] == ["10.0.0.1"]
    with pytest.raises(x509.ExtensionNotFound):
        _certificate(files[1]).extensions.get_extension_for_class(x509.SubjectAlternativeName)


def test_nobody_else_may_read_what_is_written(folder: Path) -> None:
    authority.issue(folder, ["router.a", "planner.b"], ["a"], 7)
    modes = {path.is_dir(): stat.S_IMODE(path.stat().st_mode) for path in [folder, *folder.rglob("*")]}
    assert modes == {True: 0o700, False: 0o600}
    assert len([path for path in folder.rglob("*") if path.is_file()]) == 5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["init", "planner.a"], "init makes an authority: ROLE.NAME and --host belong to issue"),
        (["init"], "ca.key: is there already; nothing is overwritten"),
        (["issue"], "issue: for whom? ROLE.NAME, such as planner.host-1"),
        (["issue", "pilot.a"], "'pilot.a': must be ROLE.NAME, such as planner.host-1: a role of operator, router,"),
        (["issue", "planner.a/b"], "'planner.a/b': must be ROLE.NAME"),
        (["issue", "router.a"], "router.a: needs --host, the name or address at which the others connect to it"),
        (["issue", "planner.there"], "planner.there: is there already; remove it to issue another one"),
        (["issue", "planner.a", "--days", "31"], "--days 31: the authority in"),
        (["issue", "planner.a", "--folder", "none"], "none/ca.key: no such file or directory; `cogradar certs init`"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line_and_nothing_is_changed(
    folder: Path, arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    authority.issue(folder, ["planner.there"], [], 1)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    done = CliRunner().invoke(app, ["certs", *([] if "--folder" in arguments else ["--folder", "."]), *arguments])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert said in done.stderr
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_an_authority_that_was_tampered_with_signs_nothing(folder: Path, tmp_path: Path) -> None:
    authority.create(tmp_path / "other", 30)
    (folder / "ca.key").write_bytes((tmp_path / "other" / "ca.key").read_bytes())
    with pytest.raises(BadInput, match=r"ca\.key is not the key of ca\.crt"):
        authority.issue(folder, ["planner.a"], [], 1)
    (folder / "ca.key").write_text("nothing")
    with pytest.raises(BadInput, match=r"ca\.key or ca\.crt is not what"):
        authority.issue(folder, ["planner.a"], [], 1)


def test_the_command_says_what_it_wrote(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    for arguments, written in (
        (["init"], ["ca.key", "ca.crt"]),
        (["issue", "planner.a", "observer.b"], ["planner.a/zenoh.json5", "observer.b/zenoh.json5"]),
    ):
        done = CliRunner().invoke(app, ["certs", "--folder", str(folder), *arguments, "--json"])
        assert (done.exit_code, json.loads(done.stdout)) == (0, [str(folder / name) for name in written])
