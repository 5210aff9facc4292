"""A PostgreSQL server of the tests, on a socket in a folder of its own; Debian's package `postgresql` has it."""

import atexit
import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from copy import copy
from functools import cache
from itertools import count
from pathlib import Path

import psycopg
import pytest
from psycopg import sql

PACKAGE = "postgresql"
PAGE_BYTES = 8192
_FAST = {"fsync": "off", "listen_addresses": "''", "shared_buffers": "16MB", "max_connections": "30"}


def programs() -> Path | None:
    """The folder with `initdb`, as Debian has it, or on the PATH."""
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    found = shutil.which("initdb") if not debian else str(debian[-1])
    return None if found is None else Path(found).parent


class Server:
    """A server, with one database."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self._folder, self._programs, self._user = folder, programs, _user()
        if self._user is not None:
            shutil.chown(folder, self._user)
        self._schemas = count()
        subprocess.run(["cp", "-a", _made(programs) / "data", folder], check=True)
        with (folder / "data" / "postgresql.conf").open("a") as file:
            file.writelines(f"{name} = {value}\n" for name, value in _FAST.items())
            file.write(f"unix_socket_directories = '{folder}'\n")

    def configure(self, **settings: str) -> None:
        """Settings of its next start."""
        with (self._folder / "data" / "postgresql.conf").open("a") as file:
            file.writelines(f"{name} = '{value}'\n" for name, value in settings.items())

    def keep(self, name: str, text: str, mode: int = 0o600) -> Path:
        """Write a file that is the server's own."""
        file = self._folder / "data" / name
        file.write_text(text)
        file.chmod(mode)
        if self._user is not None:
            shutil.chown(file, self._user, self._user)
        return file

    def back_up(self) -> None:
        """Keep its files as they are, while it is stopped."""
        subprocess.run(["cp", "-a", self._folder / "data", self._folder / "kept"], check=True)

    def restore(self) -> None:
        """Put the files in place that were kept, while it is stopped."""
        shutil.rmtree(self._folder / "data")
        (self._folder / "kept").rename(self._folder / "data")

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self._run("pg_ctl", "-w", "-l", str(self._folder / "log"), "start")

    def promote(self) -> None:
        """Let a hot standby be a server of its own."""
        self._run("pg_ctl", "-w", "promote")

    def standby(self, folder: Path) -> "Server":
        """A hot standby of this server, which is not started yet."""
        copied = copy(self)
        copied._folder = folder
        if self._user is not None:
            shutil.chown(folder, self._user)
        copied._run("pg_basebackup", "-R", "-X", "stream", "-c", "fast", "-h", str(self._folder), "-U", "radar")
        copied.configure(unix_socket_directories=str(folder))
        return copied

    def stop(self, mode: str = "fast") -> None:
        """Stop it; "immediate" as if it was killed."""
        self._run("pg_ctl", "-w", "-m", mode, "stop")

    def spoil(self, url: str, table: str, *runs: str) -> None:
        """Change a byte of each page of a table that has rows of these runs only, while the server is stopped."""
        with psycopg.connect(url.partition("&schema")[0]) as db:
            db.execute(f"SET search_path TO {url.partition('schema=')[2]}".encode())
            rows = sql.SQL("SELECT (ctid::text::point)[0]::int, run FROM {}").format(sql.Identifier(table))
            found = db.execute(rows).fetchall()
            pages = {page for page, run in found if run in runs} - {page for page, run in found if run not in runs}
            ((name,),) = db.execute("SELECT pg_relation_filepath(%s)", [table]).fetchall()
        self._change(name, pages)

    def spoil_long(self, url: str, table: str) -> None:
        """The same in all pages of the values of a table that are too long for its own pages (TOAST)."""
        with psycopg.connect(url.partition("&schema")[0]) as db:
            db.execute(f"SET search_path TO {url.partition('schema=')[2]}".encode())
            query = (
                "SELECT pg_relation_filepath(reltoastrelid), pg_relation_size(reltoastrelid) / %s"
                " FROM pg_class WHERE oid = %s::regclass"
            )
            ((name, n),) = db.execute(query, [PAGE_BYTES, table]).fetchall()
        self._change(name, range(n))

    def spoil_all(self, url: str, relation: str) -> None:
        """The same in all pages of a table, or of an index."""
        with psycopg.connect(url.partition("&schema")[0]) as db:
            db.execute(f"SET search_path TO {url.partition('schema=')[2]}".encode())
            query = "SELECT pg_relation_filepath(%s), pg_relation_size(%s::regclass) / %s"
            ((name, n),) = db.execute(query, [relation, relation, PAGE_BYTES]).fetchall()
        self._change(name, range(n))

    def _change(self, name: str, pages: Collection[int]) -> None:
        assert pages
        self.stop()
        with (self._folder / "data" / name).open("r+b") as file:
            for page in pages:
                at = PAGE_BYTES * (page + 1) - 100
                file.seek(at)
                (before,) = file.read(1)
                file.seek(at)
                file.write(bytes([before ^ 1]))
        self.start()

    def url(self, schema: str | None = None, *standbys: "Server") -> str:
        """The address of a store; a new one if no schema is named. With standbys: of the one that can be written."""
        name = schema or f"s{next(self._schemas)}"
        hosts = ",".join(str(one._folder) for one in (self, *standbys))
        writable = "&target_session_attrs=read-write" if standbys else ""
        return f"postgresql://radar@/postgres?host={hosts}{writable}&schema={name}"

    def _run(self, program: str, *arguments: str) -> None:
        _run(self._programs / program, self._folder, self._user, *arguments)


def _run(program: Path, folder: Path, user: str | None, *arguments: str) -> None:
    asked, quiet = [str(program), "-D", str(folder / "data"), *arguments], subprocess.DEVNULL
    group = None if user is None else pwd.getpwnam(user).pw_gid
    groups = None if group is None else [group]
    owner = subprocess.Popen(
        asked, cwd=folder, stdin=quiet, stdout=quiet, stderr=quiet, user=user, group=group, extra_groups=groups
    )
    assert owner.wait() == 0, asked


@cache
def _made(programs: Path) -> Path:
    """A folder with the data of a server that was never started, which takes seconds to make and a moment to copy."""
    folder, user = Path(tempfile.mkdtemp(prefix="pg-made-")), _user()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    if user is not None:
        shutil.chown(folder, user)
    _run(programs / "initdb", folder, user, "-A", "trust", "-U", "radar", "-E", "UTF8", "--no-locale", "-N", "-k")
    return folder


def _user() -> str | None:
    """Whom a server runs as: root is none that it accepts."""
    return next(name for name in ("postgres", "nobody") if _is_there(name)) if os.geteuid() == 0 else None


def _is_there(name: str) -> bool:
    try:
        pwd.getpwnam(name)
    except KeyError:
        return False
    return True


@contextmanager
def running() -> Iterator[Server]:
    """A server; the test is skipped where there is none."""
    if (there := programs()) is None:
        pytest.skip(f"no PostgreSQL server: apt install {PACKAGE}")
    with tempfile.TemporaryDirectory(prefix="pg-") as name:
        server = Server(Path(name), there)
        server.start()
        try:
            yield server
        finally:
            server.stop("immediate")
