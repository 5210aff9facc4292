"""A router that asks for certificates, in this process, and one of every role that may connect to it."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from cogradar.services.certs import access, authority, names
from cogradar.shared.protocol.permissions import HOLDERS
from cogradar.shared.wire.session import Session, free_port, open_session, run_router

HOST = "127.0.0.1"
LIMITED = "planner.here@8-15"


class Secured(NamedTuple):
    """A router, and the folder of those that it lets in: HOLDER.here."""

    endpoint: str
    folder: Path

    def file(self, holder: str) -> str:
        """What a holder's session is told."""
        return str(self.folder / f"{holder}.here" / names.SETTINGS)

    def session(self, holder: str) -> Session:
        """A session with a holder's certificate."""
        return open_session([self.endpoint], 10.0, lambda: None, file=self.file(holder))

    def limited(self) -> Session:
        """A session with the certificate of a planner for some slots of tracks."""
        return open_session([self.endpoint], 10.0, lambda: None, file=str(self.folder / LIMITED / names.SETTINGS))


@pytest.fixture(scope="package")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    folder = tmp_path_factory.mktemp("certificates") / "certs"
    authority.create(folder, 2)
    authority.issue(folder, [*(f"{holder}.here" for holder in HOLDERS), LIMITED], [HOST], 1)
    found = Secured(f"tls/{HOST}:{free_port()}", folder)
    rules = access.access_control(names.allowed(str(folder / names.ALLOWED)))
    stop = threading.Event()
    settings = {"access": rules, "file": found.file("router")}
    thread = threading.Thread(target=run_router, args=(found.endpoint, stop), kwargs=settings)
    thread.start()
    yield found
    stop.set()
    thread.join()


def until(condition: Callable[[], object], within_s: float = 10.0) -> bool:
    """Whether a condition came true in time."""
    deadline = time.monotonic() + within_s
    while not (is_true := bool(condition())) and time.monotonic() < deadline:
        time.sleep(0.02)
    return is_true
