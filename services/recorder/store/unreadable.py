"""What a server or SQLite cannot read: an index of a server by its name, with the cure; a table that is made anew from
its other pages.
"""

import re
import time
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

from cogradar.services.errors import Damaged, DamagedIndex, NoRoom, StoreFailed
from cogradar.shared.scenario.faults import printable

_FILE = re.compile(r"(?:base/\d+|pg_tblspc/\d+/\w+/\d+)/(\d+)")  # as a server names the file of a relation
KEPT = re.compile(r"(\w+)_unreadable_\d+")  # what a table is called that was made anew
_INDEX = re.compile(r'index "([^"]+)"')
BLOCK_HEADER_BYTES, ROW_BYTES = 24, 28  # of a server's block, and of a row at least: 24 of its header, 4 to find it
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
    """A session with a store."""

    def rows(self, query: str, parameters: list[Any]) -> list[Any]:
        """Rows of a SELECT."""

    def execute(self, statement: str, parameters: list[Any]) -> int:
        """Execute a statement; the number of rows that it changed."""


class Intact(NamedTuple):
    """What can be read of a table."""

    ranges: list[tuple[Any, Any]]  # of addresses of rows, each up to one before another
    lost: str  # how much is not among them


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


def made_anew(session: Session, table: str, create: str, which: str, intact: Intact) -> str:
    """Replace a table by its rows that can be read. The old one stays: another program may read more of it.

    create : makes the new one, named {table}, where the {old} one is there
    which  : the rows from one address up to one before another

    Returns the name that the old one has from now on. Raises NoRoom if that may not be done.
    """
    old = f"{table}_unreadable_{time.time_ns() // 1_000_000}"
    try:
        session.execute(f"ALTER TABLE {table} RENAME TO {old}", [])
        session.execute(create.format(table=table, old=old), [])
        for one in intact.ranges:
            session.execute(f"INSERT INTO {table} SELECT * FROM {old} WHERE {which.format(*one)}", [])
    except (NoRoom, Damaged):
        raise
    except StoreFailed as error:
        raise NoRoom(f"table {table} has pages that cannot be read, and could not be made anew: {error}") from None
    return old


def made_anew_on_server(session: Session, table: str, intact: Intact) -> str:
    """The same on a server; rights that others have on the table are granted on the new one."""
    create = "CREATE TABLE {table} (LIKE {old} INCLUDING ALL)"
    old = made_anew(session, table, create, "ctid >= '{}' AND ctid < '{}'", intact)
    for (grant,) in session.rows(_GRANTS.format(table=table, old=old), []):
        session.execute(grant, [])
    return old


def intact_blocks(session: Session, table: str) -> Intact:
    """What can be read of a table on a server, where no transaction goes on. Raises NoRoom."""
    sizes = f"SELECT pg_relation_size('{table}'), current_setting('block_size')::bigint"
    ((n_byte, block_bytes),) = session.rows(sizes, [])
    n_block = int(n_byte) // int(block_bytes)
    if not n_block:
        raise NoRoom(f"table {table}: its file is missing")
    found, bad = list[tuple[Any, Any]](), set[int]()

    def search(first: int, end: int) -> None:
        """From one block up to one before another; single rows where a range of one block cannot be read at once."""
        if _can_read(session, table, low := f"({first},0)", high := f"({end},0)"):
            found.append((low, high))
        elif end - first > 1:
            search(first, middle := (first + end) // 2)
            search(middle, end)
        elif _can_read(session, table, low, high, "*"):  # a row may have a long value on a page of its own
            rows = ((f"({first},{i})", f"({first},{i + 1})") for i in range(1, 1 + most_rows(int(block_bytes))))
            found.extend(one for one in rows if _can_read(session, table, *one))
        else:
            bad.add(first)

    search(0, n_block)
    return Intact(found, f"{len(bad)} of {n_block} pages of {block_bytes} bytes")


def most_rows(block_bytes: int) -> int:
    """Rows that a block of a server can have at most: each takes a header and a pointer, after the block's own."""
    return (block_bytes - BLOCK_HEADER_BYTES) // ROW_BYTES


def _can_read(session: Session, table: str, first: str, end: str, what: str = "") -> bool:
    """Whether rows can be read: all of them, or as much as is to be counted."""
    what = what or f"md5(({table}.*)::text)"
    try:
        session.rows(f"SELECT COUNT({what}) FROM {table} WHERE ctid >= '{first}' AND ctid < '{end}'", [])
    except DamagedIndex:
        raise
    except Damaged:
        return False
    return True


def intact_rows(session: Session, table: str) -> Intact:
    """What can be read of a table in a file, row by row, where no transaction goes on. Raises Damaged.

    Its index is whole as a rule, and knows all rows.
    """
    found, there = list[tuple[Any, Any]](), session.rows(f"SELECT rowid FROM {table} ORDER BY run", [])
    for (row,) in there:
        with suppress(Damaged):
            session.rows(f"SELECT * FROM {table} WHERE rowid = ?", [row])
            found.append((row, row + 1))
    return Intact(found, f"{len(there) - len(found)} of {len(there)} rows")
