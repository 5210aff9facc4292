"""A store on a server that is copied to a standby, and on one that speaks TLS only."""

import datetime
import socket
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from cogradar.services.errors import BadInput
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store import postgresql
from cogradar.services.runs import in_process
from tests.postgresql import Server, running
from tests.services.faulty_network import FaultyNetwork, play
from tests.services.loop import smoke_start

START = smoke_start(dwells=20)


@pytest.fixture
def pair() -> Iterator[tuple[Server, Server]]:
    """A server, and its hot standby."""
    with running() as server, tempfile.TemporaryDirectory(prefix="pg-") as name:
        standby = server.standby(Path(name))
        standby.start()
        try:
            yield server, standby
        finally:
            standby.stop("immediate")


def _played(url: str) -> str:
    """The digest of a run that a store of this address keeps."""
    with closing(Store(Journal(url))) as store:
        return str(in_process.play(START, store=store).run["digest"])


def test_metrics_and_questions_read_a_hot_standby_and_no_recorder_begins_on_it(pair: tuple[Server, Server]) -> None:
    server, standby = pair
    server.configure(synchronous_standby_names="*", synchronous_commit="remote_apply")
    server.stop()
    server.start()
    expected = _played(server.url("runs"))
    with closing(Store(Journal(standby.url("runs"), read_only=True))) as store:
        assert store.read("SELECT run, digest FROM run") == [{"run": START.run, "digest": expected}]
    with pytest.raises(BadInput, match="a hot standby, which cannot be written: name its primary"):
        Journal(standby.url("runs"))


def test_a_run_goes_on_on_the_standby_with_the_same_digest(
    pair: tuple[Server, Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server is gone for good, its standby is promoted, and the address names both."""
    monkeypatch.setattr(postgresql, "RETRY_S", 0.0)
    expected = in_process.play(START).run["digest"]
    server, standby = pair
    server.configure(synchronous_standby_names="*")
    server.stop()
    server.start()
    url = server.url("runs", standby)
    journal = Journal(url)
    network = FaultyNetwork(START, 2, np.random.default_rng(1), journal=journal)
    network.store = Store(Journal(url, read_only=True))

    def fail_over() -> None:
        server.stop("immediate")
        assert isinstance(network.processes["recorder-0"].core, Recorder)
        standby.configure(synchronous_standby_names="")
        standby.promote()

    try:
        assert play(network, {60: fail_over}) == expected
    finally:
        network.store.close()
        journal.close()
        server.start()


def _certified(server: Server, folder: Path, host: str) -> Path:
    """Give a server a certificate of this host; the file with it."""
    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, host)])
    now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number(), now - day, now + day)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(host)]), critical=False)
        .sign(key, hashes.SHA256())
    )
    text = certificate.public_bytes(serialization.Encoding.PEM).decode()
    own = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()
    server.keep("server.crt", text)
    server.keep("server.key", own)
    (folder / "ca.crt").write_text(text)
    return folder / "ca.crt"


def test_a_server_that_speaks_tls_only(tmp_path: Path) -> None:
    with running() as server, closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        taken.close()
        authority = _certified(server, tmp_path, "localhost")
        server.keep("pg_hba.conf", "local all all trust\nhostssl all all 127.0.0.1/32 trust\n")
        server.configure(listen_addresses="127.0.0.1", port=str(port), ssl="on")
        server.stop()
        server.start()
        url = f"postgresql://radar@localhost:{port}/postgres?hostaddr=127.0.0.1&schema=runs"
        trusted = f"{url}&sslmode=verify-full&sslrootcert={authority}"
        digest = _played(trusted)
        with closing(Store(Journal(trusted, read_only=True))) as store:
            assert store.read("SELECT digest FROM run")[0]["digest"] == digest
        with pytest.raises(BadInput, match=r"no pg_hba\.conf entry|no encryption"):
            Journal(f"{url}&sslmode=disable", read_only=True)
        other = tmp_path / "other"
        other.mkdir()
        with running() as stranger, suppress(OSError), pytest.raises(BadInput, match="certificate verify failed"):
            Journal(f"{url}&sslmode=verify-full&sslrootcert={_certified(stranger, other, 'x')}", read_only=True)
        with pytest.raises(BadInput, match=r'does not match host name "127\.0\.0\.1"'):
            Journal(trusted.replace("@localhost", "@127.0.0.1"), read_only=True)
