"""A store in a schema of a PostgreSQL server: `Connection` of `database`.

One session at a time may write. It has an advisory lock of the server, which goes with the session: the server ends the
session of a process that died, that is cut off, or that is silent for its lease. What such a process had not committed
is undone by then, so that no commit of its can come after one of its successor. The row of the leader is locked in each
transaction besides, for servers behind something that shares sessions.

A server is trusted as a machine is: a role that may change its tables may change more. What it holds is not trusted.
"""

import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar
from zlib import crc32

import psycopg
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from psycopg.types.numeric import Int8Dumper
from psycopg.types.string import StrDumper

from cogradar.services.errors import BadInput, Damaged, Failure, InUse, NoRoom, NoStoreYet, StoreFailed, Unreachable
from cogradar.services.recorder.store.address import FORM, Address
from cogradar.services.recorder.store.seal import damage, run_asked
from cogradar.services.recorder.store.tables import KINDS, SCHEMA_VERSION, definitions, described, numbered
from cogradar.services.recorder.store.unreadable import Intact, index_damage, intact_blocks, made_anew_on_server
from cogradar.shared.scenario.faults import printable

OLDEST = 14  # version of the server: the first one that ends silent sessions
TAKE_WITHIN_S = 2.0  # for the lock of a process that was killed: its session ends at once, but not before that
POLL_S, RETRY_S = 0.05, 0.5
LOCK_S = 5  # that a transaction may wait for another one
CONNECT_WITHIN_S = 3
CLASS = 0x636F6772  # "cogr": of our advisory locks
# Within 11 s both ends know that the other machine is gone, whatever the system's own patience.
_ALIVE = {"keepalives_idle": 5, "keepalives_interval": 2, "keepalives_count": 3, "tcp_user_timeout": 10_000}
_SESSION = (
    "SET tcp_keepalives_idle = 5; SET tcp_keepalives_interval = 2; SET tcp_keepalives_count = 3;"
    f" SET lock_timeout = '{LOCK_S}s';"
    # What is acknowledged is on a disk, whatever the server does by itself. More than that is the server's to say.
    " SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
).encode()
# States: lost or ended sessions, a server that begins, a replica, a lock.
_AWAY = re.compile("08|57P|25P03|25006|55P03")
_FULL = re.compile("53|58|XX")  # no room, an I/O error, a fault of the server: another time it may be able to
_DAMAGED = re.compile("XX00[12]|58P01")  # a page, an index, a file of the server that is missing
_Result = TypeVar("_Result")
_Connection = psycopg.Connection[tuple[Any, ...]]


class _Text(StrDumper):
    """Text without the one character that no text of a server can have."""

    def dump(self, obj: str) -> Any:
        return super().dump(obj.replace("\0", "\ufffd"))


class PostgresqlConnection:
    """One schema of a server."""

    # A recorder that takes the lead waits for each transaction of another one, and the other way round.
    begin = "BEGIN; LOCK TABLE leader IN ROW SHARE MODE"
    begin_to_lead = "BEGIN; LOCK TABLE leader IN EXCLUSIVE MODE"
    hold_still = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"
    stamp = "UPDATE store SET version = version"
    has_temporary = False

    def __init__(self, name: str, owner: str, *, read_only: bool) -> None:
        """A writer takes the lock in the name of `owner`, and makes an empty schema a store.

        Raises BadInput, with all as it was, if the schema is something else or another process writes it.
        """
        self._address = Address.of(name)
        self.name = self._address.shown
        self._owner, self._read_only = owner, read_only
        self._begun = self._has_lock = False
        self._in_part = False  # of the transaction, which can be undone alone
        self._lease_s = 0.0
        self._retry_s, self._fault = 0.0, ""
        try:
            self._db = self._connected()
        except Unreachable as error:
            raise NoStoreYet(str(error)) from None
        try:
            if not read_only:
                self._take_lock_soon()
                self._make()
            self._check()
        except (Failure, psycopg.Error) as error:
            self.close()
            fault = self._failure(error)
            if isinstance(fault, Unreachable):
                raise NoStoreYet(str(fault)) from None
            raise fault if isinstance(fault, BadInput) else BadInput(str(fault)) from None

    def _connected(self) -> _Connection:
        """A new session. Raises Unreachable."""
        if time.monotonic() < self._retry_s:
            raise Unreachable(self._fault)
        who = f"{self._owner} (process {os.getpid()} on {socket.gethostname()})"
        told: dict[str, Any] = {
            "application_name": who[:63],
            "client_encoding": "UTF8",
            "connect_timeout": CONNECT_WITHIN_S,
        } | _ALIVE
        try:  # what the address says itself has precedence
            info = make_conninfo(**{**told, **conninfo_to_dict(self._address.url)})
            db = psycopg.connect(info, autocommit=True, cursor_factory=psycopg.RawCursor)
            try:
                db.adapters.register_dumper(int, Int8Dumper)  # one statement for all numbers, not one for each size
                db.adapters.register_dumper(str, _Text)
                self._begin_session(db)
            except BaseException:
                db.close()
                raise
        except psycopg.ProgrammingError as error:
            raise BadInput(f"{self.name}: {self._said(error)}; must be {FORM}") from None
        except psycopg.Error as error:
            self._retry_s = time.monotonic() + RETRY_S
            self._fault = f"{self.name}: {self._said(error)}"
            raise Unreachable(self._fault) from None
        return db

    def _begin_session(self, db: _Connection) -> None:
        if db.info.server_version < OLDEST * 10_000:
            raise BadInput(
                f"{self.name}: a server of version {db.info.server_version // 10_000}, must be {OLDEST} or newer"
            )
        if (encoding := db.info.parameter_status("server_encoding")) != "UTF8":
            raise BadInput(f"{self.name}: a database of encoding {encoding}, must be UTF8")
        # A question about one run looks at no page without rows of it, which may be damaged. Where there is no index,
        # the server takes the question for so dear then that it would compile it each time, for a tenth of a second.
        path = f'SET search_path TO "{self._address.schema}"; SET enable_seqscan TO off; SET jit TO off'
        db.execute(path.encode())
        if self._read_only:
            db.execute("SET default_transaction_read_only TO on")
            return
        if db.info.parameter_status("in_hot_standby") == "on":  # it may be about to be promoted
            raise psycopg.OperationalError(
                "a hot standby, which cannot be written: name its primary, or all servers with "
                "target_session_attrs=read-write"
            )
        db.execute(_SESSION)
        if self._lease_s:
            db.execute(self._lease)

    def close(self) -> None:
        """Let others write."""
        if self._has_lock and not self._db.closed:
            self._quietly("SELECT pg_advisory_unlock_all()")
        self._has_lock = False
        self._db.close()

    def expire_after(self, seconds: float) -> None:
        """Let the server end this session if it is silent for so long; a process that is frozen seems to be alive."""
        if seconds != self._lease_s:
            self._lease_s = seconds
            self._run(lambda db: db.execute(self._lease))

    @property
    def _lease(self) -> bytes:
        names = ("idle_in_transaction_session_timeout", "idle_session_timeout")
        return "; ".join(f"SET {name} = {int(1000 * self._lease_s)}" for name in names).encode()

    # The lock.

    @property
    def _lock(self) -> tuple[int, int]:
        return CLASS, crc32(self._address.schema.encode()) - 2**31

    def _take_lock(self) -> bool:
        (found,) = self._db.execute("SELECT pg_try_advisory_lock($1::int, $2::int)", self._lock).fetchone() or (False,)
        self._has_lock = bool(found)
        return self._has_lock

    def _take_lock_soon(self) -> None:
        until = time.monotonic() + TAKE_WITHIN_S
        while not self._take_lock():
            if time.monotonic() > until:
                with suppress(NoStoreYet):  # it may be about to be made
                    self._check()  # what is no store is said now, not when the lock is free
                raise InUse(f"{self.name}: in use by {self._holder()}")
            time.sleep(POLL_S)

    def _holder(self) -> str:
        query = (
            "SELECT application_name, to_char(backend_start AT TIME ZONE 'UTC', 'YYYY-MM-DD HH24:MI:SS') FROM pg_locks"
            " JOIN pg_stat_activity USING (pid) WHERE locktype = 'advisory' AND granted"
            " AND datname = current_database() AND classid = $1::bigint AND objid = $2::bigint"
        )
        found = self._db.execute(query, (self._lock[0], self._lock[1] % 2**32)).fetchone()
        return printable(f"{found[0]}, since {found[1]} UTC") if found and found[0] else "another process"

    # What the schema holds.

    def _make(self) -> None:
        """Make an empty schema a store, in one transaction."""
        if self._db.execute("SELECT 1 FROM pg_namespace WHERE nspname = $1", [self._address.schema]).fetchone() is None:
            self._db.execute(f'CREATE SCHEMA IF NOT EXISTS "{self._address.schema}"'.encode())
        if self._db.execute("SELECT 1 FROM pg_class WHERE relnamespace = current_schema()::regnamespace").fetchone():
            return
        with self._db.transaction():
            for statement in definitions():
                self._db.execute(statement.encode())
            self._db.execute("INSERT INTO store VALUES ($1)", [SCHEMA_VERSION])

    def _check(self) -> None:
        """Raises BadInput if the schema is no store of this version."""
        query = (
            "SELECT table_name::text, column_name::text, data_type::text FROM information_schema.columns"
            " WHERE table_schema = current_schema() ORDER BY table_name, ordinal_position"
        )
        found = self._db.execute(query).fetchall()
        if not found:
            raise NoStoreYet(
                f"{self.name}: no store of runs in schema {self._address.schema} that {self._user} may read"
            )
        if ("store", "version", "bigint") not in found:
            raise BadInput(f"{self.name}: schema {self._address.schema} holds something else, no store of runs")
        ((version,), *_) = [*self._db.execute("SELECT version FROM store").fetchall(), (0,)]
        if version != SCHEMA_VERSION:
            raise BadInput(f"{self.name}: store of version {version}, this program reads version {SCHEMA_VERSION}")
        wanted = [("store", "version", "bigint")]
        wanted += [(one.name, column.name, KINDS[column.kind]) for one, columns in described() for column in columns]
        for table in dict.fromkeys(row[0] for row in wanted):
            if [row for row in found if row[0] == table] != [row for row in wanted if row[0] == table]:
                raise BadInput(f"{self.name}: table {table!r} is not as version {SCHEMA_VERSION} makes it")

    @property
    def _user(self) -> str:
        return self._db.info.user

    # Statements.

    @property
    def in_transaction(self) -> bool:
        """Whether something was written that is not committed. If the session is lost, so is that: it is for
        `rollback` to say so, for a commit of nothing would look like one of all.
        """
        return self._begun

    def execute(self, statement: str, parameters: Sequence[Any]) -> int:
        """Execute a statement; the number of rows that it changed."""
        if statement in {self.begin, self.begin_to_lead, self.hold_still}:
            return self._begin(statement)
        if statement == "COMMIT":
            return self._commit()
        if statement == "ROLLBACK":
            self._begun = False
            self._quietly("ROLLBACK")
            if self._lease_s:  # it is undone, too, if it was set in this transaction
                self._quietly(self._lease.decode())
            return 0
        return self._write(lambda db: db.execute(numbered(statement), parameters)).rowcount

    def execute_many(self, statement: str, rows: Sequence[Sequence[Any] | dict[str, Any]]) -> None:
        """Execute a statement for each of these rows, which wait for one answer together."""
        self._write(lambda db: db.cursor().executemany(numbered(statement), rows))

    def _write(self, ask: Callable[[_Connection], _Result]) -> _Result:
        """Ask the server to write. Damage ends the whole transaction, unless it is met in a part of one."""
        try:
            return self._run(ask)
        except Damaged as error:
            if self._in_part:
                raise
            raise NoRoom(str(error)) from None

    @contextmanager
    def part(self) -> Iterator[None]:
        """What is done within is undone alone if bytes of the store prove to be damaged: the transaction goes on."""
        if not self._begun or self._in_part:
            yield
            return
        self._run(lambda db: db.execute("SAVEPOINT part"))
        self._in_part = True
        try:
            yield
        except Damaged:
            self._run(lambda db: db.execute("ROLLBACK TO part"))
            raise
        finally:
            self._in_part = False
            self._quietly("RELEASE part")

    def rows(self, query: str, parameters: Sequence[Any]) -> list[Any]:
        """Rows of a SELECT."""
        return self._select(query, parameters).fetchall()

    def _select(self, query: str, parameters: Sequence[Any]) -> psycopg.Cursor[tuple[Any, ...]]:
        """Ask for rows. A page that cannot be read is damage of the run that is asked for."""
        with self.part():
            return self._run(lambda db: db.execute(numbered(query), parameters), run_asked(query, parameters))

    def read(self, query: str, parameters: Sequence[Any]) -> list[dict[str, Any]]:
        """Rows of a SELECT."""
        cursor = self._select(query, parameters)
        names = [column.name for column in cursor.description or ()]
        return [dict(zip(names, row, strict=True)) for row in cursor]

    def intact(self, table: str) -> Intact:
        """What can be read of a table, where no transaction goes on."""
        return intact_blocks(self, table)

    def made_anew(self, table: str, intact: Intact) -> str:
        """Put the rows of a table that can be read in its place; what the old one is called from now on."""
        return made_anew_on_server(self, table, intact)

    def faults(self) -> list[str]:
        """The server looks after its pages, where it has checksums of them."""
        return []

    def n_byte(self) -> int:
        """Bytes of its tables."""
        query = (
            "SELECT COALESCE(SUM(pg_total_relation_size(oid)), 0)::bigint FROM pg_class"
            " WHERE relnamespace = current_schema()::regnamespace AND relkind = 'r'"
        )
        return int(self.rows(query, ())[0][0])

    def check_place(self) -> None:
        """Raises Unreachable if the session is known to be lost; a reader begins another one."""
        if self._read_only:
            self.rows("SELECT 1", ())
        elif self._db.closed:
            raise Unreachable(f"{self.name}: {self._fault or 'the connection is lost'}")

    def check_room(self) -> None:
        """Begin another session, if this one is lost, with the lock. Raises Unreachable."""
        if self._db.closed:
            self._db, self._has_lock = self._connected(), False
        if not self._has_lock and not self._run(lambda _: self._take_lock()):
            raise Unreachable(f"{self.name}: in use by {self._run(lambda _: self._holder())}")

    def _begin(self, statement: str) -> int:
        if not self._has_lock and not self._read_only:
            raise Unreachable(f"{self.name}: {self._fault or 'the connection is lost'}")
        try:
            self._run(lambda db: db.execute(statement.encode()))
        except Failure:
            self._quietly("ROLLBACK")
            raise
        self._begun = True
        return 0

    def _commit(self) -> int:
        """A server answers the COMMIT of a transaction that has failed with a word, and not with an error."""
        done = self._run(lambda db: db.execute("COMMIT").statusmessage)
        self._begun = False
        if done != "COMMIT":
            raise StoreFailed(f"{self.name}: the transaction had failed, and was undone")
        return 0

    def _run(self, ask: Callable[[_Connection], _Result], run: str = "") -> _Result:
        """Ask the server. A reader begins another session if this one is lost; a writer does so in `check_room`:
        what another machine may have by then is not what this process has in mind.
        """
        try:
            return ask(self._db)
        except psycopg.Error as error:
            if not (self._read_only and self._db.closed and not self._begun):
                raise self._failure(error, run) from None
        self._db = self._connected()
        try:
            return ask(self._db)
        except psycopg.Error as error:
            raise self._failure(error, run) from None

    def _quietly(self, statement: str) -> None:
        with suppress(psycopg.Error):  # with a lost session it is undone by the server
            self._db.execute(statement.encode())

    def _failure(self, error: Exception, run: str = "") -> Failure:
        if isinstance(error, Failure):
            return error
        state = getattr(error, "sqlstate", None) or ""
        text = f"{self.name}: {self._said(error)}"
        if self._db.closed:
            self._has_lock, self._fault = False, self._said(error)
            return Unreachable(text)
        if _AWAY.match(state):
            return Unreachable(text)
        if _DAMAGED.match(state):
            return self._damage(self._said(error), run)
        return NoRoom(text) if _FULL.match(state) else StoreFailed(text)

    def _damage(self, said: str, run: str) -> Damaged:
        """What cannot be read. An index is asked for in another session: a transaction here has failed."""
        with suppress(Failure, psycopg.Error), self._connected() as other:
            if (found := index_damage(other, self.name, self._address.schema, said, run)) is not None:
                return found
        return damage(self.name, f"run {run!r}: {said}" if run else said, run)

    def _said(self, error: Exception) -> str:
        """The first line of what the server, or its library, says, without a password."""
        said = " ".join(str(error).strip().splitlines()[:1]) or type(error).__name__
        return printable(self._address.masked(said))[:300]
