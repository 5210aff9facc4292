"""What a PostgreSQL server cannot read: an index by its name, with the cure; a table that is made anew from its other
pages.
"""

import re
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any, Protocol

from cogradar.services.errors import Damaged, DamagedIndex, NoRoom, StoreFailed
from cogradar.shared.scenario.faults import printable

_FILE = re.compile(r"(?:base/\d+|pg_tblspc/\d+/\w+/\d+)/(\d+)")  # as a server names the file of a relation
_INDEX = re.compile(r'index "([^"]+)"')
MOST_ROWS = 300  # of a block of 8 KiB
_OF_ALL = {"run", "leader"}  # without an index of these tables no run can be read
_QUERY = (
    "SELECT index.relname::text, kept.relname::text FROM pg_index JOIN pg_class AS index ON index.oid = indexrelid"
    " JOIN pg_class AS kept ON kept.oid = indrelid WHERE index.relnamespace = to_regnamespace($1)"
    " AND (index.relfilenode = $2 OR index.relname = $3)"
)
_GRANTS = (
    "SELECT 'GRANT ' || string_agg(privilege_type, ', ') || ' ON {table} TO '"
    " || CASE grantee WHEN 0 THEN 'PUBLIC' ELSE grantee::regrole::text END"
    " FROM pg_class, aclexplode(relacl) WHERE pg_class.oid = '{old}'::regclass AND grantee <> relowner GROUP BY grantee"
)


class Session(Protocol):
    """A session with a server in which a transaction goes on."""

    def rows(self, query: str, parameters: list[Any]) -> list[Any]:
        """Rows of a SELECT."""

    def execute(self, statement: str, parameters: list[Any]) -> int:
        """Execute a statement; the number of rows that it changed."""

    def part(self) -> AbstractContextManager[None]:
        """What is done within is undone alone if bytes of the store prove to be damaged."""


def index_damage(db: Any, store: str, schema: str, said: str, run: str) -> DamagedIndex | None:
    """What to say of an index, and what makes it whole, if a server's error is about one of this schema.

    db : a session without a failed transaction
    """
    file, name = _FILE.search(said), _INDEX.search(said)
    asked = [f'"{schema}"', int(file[1]) if file else 0, name[1] if name else ""]
    for index, table in db.execute(_QUERY, asked).fetchall():
        run = "" if table in _OF_ALL else run
        where = f"{f'run {run!r}, ' if run else ''}index {index} of table {table}"
        cure = f'`REINDEX INDEX "{schema}"."{index}"` makes the index anew from its table'
        return DamagedIndex(printable(f"{store}: {where}: {said}. {cure}"), run)
    return None


def made_anew(session: Session, table: str) -> str:
    """Replace a table by its rows that can be read. The old one stays: another program may read more of it.

    Returns the name that it has from now on. Raises NoRoom if that may not be done.
    """
    old = f"{table}_unreadable_{time.time_ns() // 1_000_000}"
    try:
        session.execute(f"ALTER TABLE {table} RENAME TO {old}", [])
        session.execute(f"CREATE TABLE {table} (LIKE {old} INCLUDING ALL)", [])
        for (grant,) in session.rows(_GRANTS.format(table=table, old=old), []):
            session.execute(grant, [])
        size = f"SELECT pg_relation_size('{old}') / current_setting('block_size')::bigint"
        if not (n_block := int(session.rows(size, [])[0][0])):
            raise NoRoom(f"table {table}: its file is missing")
        for first, end in _ranges(session, old, 0, n_block):
            copied = f"INSERT INTO {table} SELECT * FROM {old} WHERE ctid >= '{first}' AND ctid < '{end}'"
            session.execute(copied, [])
    except (NoRoom, Damaged):
        raise
    except StoreFailed as error:
        raise NoRoom(f"table {table} has pages that cannot be read, and could not be made anew: {error}") from None
    return old


def _ranges(session: Session, old: str, first: int, end: int) -> Iterator[tuple[str, str]]:
    """Ranges of row addresses that can be read, from one block up to one before another; single rows where a range
    of one block cannot be read at once.
    """
    if _can_read(session, old, low := f"({first},0)", high := f"({end},0)"):
        yield low, high
    elif end - first > 1:
        middle = (first + end) // 2
        yield from _ranges(session, old, first, middle)
        yield from _ranges(session, old, middle, end)
    elif _can_read(session, old, low, high, "*"):  # a row may have a long value on a page of its own
        rows = ((f"({first},{i})", f"({first},{i + 1})") for i in range(MOST_ROWS))
        yield from (one for one in rows if _can_read(session, old, *one))


def _can_read(session: Session, old: str, first: str, end: str, what: str = "") -> bool:
    """Whether rows can be read: all of them, or as much as is to be counted."""
    what = what or f"md5({old}::text)"
    try:
        with session.part():
            session.rows(f"SELECT COUNT({what}) FROM {old} WHERE ctid >= '{first}' AND ctid < '{end}'", [])
    except DamagedIndex:
        raise
    except Damaged:
        return False
    return True
