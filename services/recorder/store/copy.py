"""Copying a store into an empty one, from a file to a server or back: all rows, or none."""

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any

from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.recorder.store.database import Database
from cogradar.services.recorder.store.tables import described, statements

AT_ONCE = 512  # rows; a message has at most 4 MiB, most have some kB
_KEYS = {
    re.findall(r"CREATE TABLE (\w+)", text)[0]: re.findall(r"PRIMARY KEY \((.*?)\)|(\w+) \w+ PRIMARY KEY", text)
    for text in statements()
}


def copy(source: str, target: str, report: Callable[[str, int], None] = lambda *_: None) -> dict[str, int]:
    """Copy what is committed at this moment; how many rows each table has.

    The copy is read again, and compared row by row, before it is committed.

    report : gets the table and how many rows of it are copied; what it raises ends the copy; the target is then empty

    Raises BadInput if the target is not empty, StoreFailed.
    """
    with closing(Database(source, read_only=True)) as theirs, closing(Database(target, owner="cogradar store")) as ours:
        tables = {table.name: [column.name for column in columns] for table, columns in described()}
        if full := [name for name in tables if ours.rows(f"SELECT 1 FROM {name} LIMIT 1")]:
            raise BadInput(f"{ours.path}: its table {full[0]} has rows: copy to a new file or an empty schema")
        try:
            theirs.hold_still()
            counts = dict.fromkeys(tables, 0)
            digests = hashlib.sha256(), hashlib.sha256()
            for name, columns in tables.items():
                insert = f"INSERT INTO {name} VALUES ({','.join('?' * len(columns))})"
                for rows in _pages(theirs, name, columns):
                    ours.write_many(insert, rows)
                    _add(digests[0], rows)
                    counts[name] += len(rows)
                    report(name, counts[name])
            for name, columns in tables.items():
                for rows in _pages(ours, name, columns):
                    _add(digests[1], rows)
            if digests[0].digest() != digests[1].digest():
                raise StoreFailed(
                    f"{ours.path}: does not give back what was copied from {theirs.path}; nothing was kept"
                )
            ours.commit()
        except BaseException:
            ours.rollback()
            raise
    return counts


def _pages(store: Database, table: str, columns: Sequence[str]) -> Iterator[list[tuple[Any, ...]]]:
    """Rows of a table in the order of its key, some at a time."""
    key = [name.strip() for found in _KEYS[table] for part in found for name in part.split(",") if part]
    listed, at = ", ".join(columns), [columns.index(name) for name in key]
    order = f"ORDER BY {', '.join(key)} LIMIT {AT_ONCE}" if key else ""
    after = f"({', '.join(key)}) > ({','.join('?' * len(key))})"
    rows = store.rows(f"SELECT {listed} FROM {table} {order}")
    while rows:
        yield [tuple(row) for row in rows]
        if not key or len(rows) < AT_ONCE:
            return
        rows = store.rows(f"SELECT {listed} FROM {table} WHERE {after} {order}", [rows[-1][i] for i in at])


def _add(digest: Any, rows: Sequence[tuple[Any, ...]]) -> None:
    for row in rows:
        for value in row:
            told = value if isinstance(value, bytes) else repr(value).encode()
            digest.update(f"{type(value).__name__} {len(told)} ".encode())
            digest.update(told)
