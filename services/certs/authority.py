"""A private authority in a folder, and the certificates that it issues.

FOLDER/ca.key, ca.crt: the authority. FOLDER/ROLE.NAME/zenoh.json5: all that one process needs, unreadable for others:
its key, its certificate and the authority's, as Zenoh takes them. FOLDER/allowed: the names, for the router.
"""

import datetime
import ipaddress
import json
import os
import shutil
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from cogradar.services.certs.names import ALLOWED, SETTINGS, holder_of
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.topics import Role

AUTHORITY = "cogradar"  # its name
EARLIER = datetime.timedelta(minutes=5)  # clocks differ


class Authority(NamedTuple):
    """The authority: its key and certificate."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate


def create(folder: Path, days: int) -> None:
    """Make the authority of a folder. Raises BadInput if there is one, or the folder cannot be written."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(AUTHORITY)
    signed = (
        _dated(name, days)
        .issuer_name(name)
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(folder / "ca.key", _pem_of_key(key))
        _write(folder / "ca.crt", _pem(signed))
    except OSError as error:
        raise BadInput(_fault(error)) from None


def issue(folder: Path, names: Sequence[str], hosts: Sequence[str], days: int) -> list[Path]:
    """Issue a certificate for each name; the files for Zenoh. Raises BadInput before the first one is written.

    hosts : names and addresses at which the others connect to a router, which their sessions compare
    """
    authority = _open(folder)
    for name in names:
        if holder_of(name) == Role.ROUTER and not hosts:
            raise BadInput(f"{name}: needs --host, the name or address at which the others connect to it")
        if (folder / name).exists():
            raise BadInput(f"{folder / name}: is there already; remove it to issue another one")
    left = authority.certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    if days > left.days:
        raise BadInput(f"--days {days}: the authority in {folder} is valid for {max(left.days, 0)} more days")
    written = []
    for name in names:
        try:
            written.append(_issue(folder, authority, name, hosts, days))
        except OSError as error:
            shutil.rmtree(folder / name, ignore_errors=True)
            raise BadInput(_fault(error)) from None
    return written


def end_of(certificate: bytes) -> float:
    """When a certificate, PEM, ends, in seconds since 1970. Raises BadInput if it is none."""
    return _read(certificate).not_valid_after_utc.timestamp()


def name_on(certificate: bytes) -> str:
    """The name on a certificate, PEM; empty if another authority issued it. Raises BadInput if it is none."""
    found = _read(certificate)
    try:
        issuer, name = (
            [str(one.value) for one in of.get_attributes_for_oid(NameOID.COMMON_NAME)]
            for of in (found.issuer, found.subject)
        )
    except (ValueError, TypeError):  # in other letters than ours
        return ""
    return name[0] if issuer == [AUTHORITY] else ""


def _read(certificate: bytes) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(certificate)
    except (ValueError, x509.InvalidVersion):
        raise BadInput("--zenoh-config: what it has for a certificate is none") from None


def _issue(folder: Path, authority: Authority, name: str, hosts: Sequence[str], days: int) -> Path:
    is_router = holder_of(name) == Role.ROUTER
    key = ec.generate_private_key(ec.SECP256R1())
    # A process whose only part is to connect cannot pass for a router.
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if is_router else [])]
    builder = (
        _dated(_name(name), days)
        .issuer_name(authority.certificate.subject)
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), critical=False)
    )
    if is_router:
        builder = builder.add_extension(x509.SubjectAlternativeName([_place(host) for host in hosts]), critical=False)
    signed = builder.sign(authority.key, hashes.SHA256())
    (folder / name).mkdir(mode=0o700)
    file = folder / name / SETTINGS
    _write(file, _settings(authority, key, signed, is_router=is_router))
    descriptor = os.open(folder / ALLOWED, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    with os.fdopen(descriptor, "a", encoding="utf-8") as listed:
        listed.write(f"{name}\n")
    return file


def _settings(
    authority: Authority, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate, *, is_router: bool
) -> bytes:
    own = b64encode(_pem_of_key(key)).decode(), b64encode(_pem(certificate)).decode()
    tls: dict[str, object] = {
        "root_ca_certificate_base64": b64encode(_pem(authority.certificate)).decode(),
        "enable_mtls": True,
        "connect_private_key_base64": own[0],
        "connect_certificate_base64": own[1],
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    if is_router:
        tls |= {"listen_private_key_base64": own[0], "listen_certificate_base64": own[1]}
    return json.dumps({"transport": {"link": {"tls": tls}}}, indent=1).encode() + b"\n"


def _open(folder: Path) -> Authority:
    """The authority of a folder. Raises BadInput."""
    try:
        key = serialization.load_pem_private_key((folder / "ca.key").read_bytes(), None)
        certificate = x509.load_pem_x509_certificate((folder / "ca.crt").read_bytes())
        certificate.verify_directly_issued_by(certificate)
    except OSError as error:
        raise BadInput(f"{_fault(error)}; `cogradar certs init` makes an authority") from None
    except (ValueError, TypeError, InvalidSignature):
        raise BadInput(f"{folder}: ca.key or ca.crt is not what `cogradar certs init` wrote") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise BadInput(f"{folder}: ca.key is not the key of ca.crt")
    return Authority(key, certificate)


def _dated(name: x509.Name, days: int) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLIER)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _place(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _pem_of_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(file: Path, content: bytes) -> None:
    """Write a file that only its owner may read. Raises FileExistsError rather than to overwrite one."""
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as opened:
        opened.write(content)


def _fault(error: OSError) -> str:
    if isinstance(error, FileExistsError):
        return f"{error.filename}: is there already; nothing is overwritten"
    return f"{error.filename}: {(error.strerror or 'cannot be used').lower()}"
