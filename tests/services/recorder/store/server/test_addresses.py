"""Addresses of servers: what they may say, and that nothing says a password."""

import sys

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.address import Address
from cogradar.services.recorder.store.tables import numbered


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://radar:hunter2@127.0.0.1:1/db",
        "postgresql://radar@127.0.0.1:1/db?password=hunter2",
        "postgresql://radar:hunter2@127.0.0.1:port/db",
        "postgresql://radar:hunter2@127.0.0.1:1/db?nonsense=1",
        "postgresql://radar:hunter2@127.0.0.1:1/db?schema=Hunter",
        "postgresql://[radar:hunter2@/db",
        *(f"postgresql://radar:hunter2{end}x@127.0.0.1:1/db" for end in ("/", "#", "?", "@", "?schema=")),
        "postgresql://radar:x/hunter2@127.0.0.1:1/db",
    ],
)
def test_no_password_is_said(url: str) -> None:
    done = CliRunner().invoke(app, ["query", "runs", "--store", url])
    assert (done.exit_code, len(done.output.splitlines()), "hunter2" in done.output) == (2, 1, False)


@pytest.mark.parametrize(
    "name",
    [
        "postgresql://radar:hunter2@127.0.0.1:1/db",
        "Recorded:postgresql://radar:hunter2@127.0.0.1:1/db",
        "recorded: postgresql://radar:hunter2@127.0.0.1:1/db",
        "recorded:postgresql:/radar:hunter2@127.0.0.1:1/db",
        "recorded:postgresql://radar@127.0.0.1:1/db?password=top#hunter2",
    ],
)
def test_no_password_of_an_address_at_a_wrong_place_is_said(name: str) -> None:
    done = CliRunner().invoke(app, ["run", "smoke", "--in-process", "--front-end", name])
    assert (done.exit_code, len(done.output.splitlines()), "hunter2" in done.output) == (2, 1, False)


def test_addresses() -> None:
    found = Address.of("postgresql://me:a%40b@h1,h2:5/db?schema=x&sslmode=require")
    assert found.shown == "postgresql://me@h1,h2:5/db?schema=x&sslmode=require"
    assert (found.url, found.schema, found.password) == (
        "postgresql://me:a%40b@h1,h2:5/db?sslmode=require",
        "x",
        "a@b",
    )
    assert Address.of("postgresql://me@h/db?password=a%40b").password == found.password
    local = Address.of("postgres:///db?host=/run/pg&options=-c%20geqo%3Doff&schema=y")
    assert local.url == "postgresql:///db?host=/run/pg&options=-c%20geqo%3Doff"
    assert repr(found) == f"Address({found.shown!r})"
    assert numbered("SELECT * FROM main.score WHERE a = ? AND b = ?") == b"SELECT * FROM score WHERE a = $1 AND b = $2"


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cogradar.services.recorder.store.postgresql", None)
    with pytest.raises(BadInput, match=r"pip install 'cogradar\[postgres\]'"):
        Journal("postgresql://radar@127.0.0.1:1/db")
