"""Copying a store into an empty one, from a file to a server or back: all rows, or none."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

from cogradar.services.errors import BadInput, StoreFailed
from cogradar.services.recorder.store.address import is_server
from cogradar.services.recorder.store.check import (
    OF_RUNS,
    TABLES,
    check_run,
    check_table,
    damages,
    held_still,
    names,
    pages,
)
from cogradar.services.recorder.store.database import Database
from cogradar.shared.scenario.faults import printable


def copy(
    source: str, target: str, report: Callable[[str, int], None] = lambda *_: None, *, only_intact: bool = False
) -> dict[str, int]:
    """Copy what is committed at this moment; how many rows each table has.

    The copy is read again, and compared row by row, before it is committed.

    report : gets the table and how many rows of it are copied; what it raises ends the copy; the target is then empty
    only_intact : leave out runs with a damaged row

    Raises BadInput if the target is not empty or cannot hold a text, Damaged, StoreFailed.
    """
    with held_still(source) as theirs, closing(Database(target, owner="cogradar store")) as ours:
        if full := [name for name in TABLES if ours.rows(f"SELECT 1 FROM {name} LIMIT 1")]:
            raise BadInput(f"{ours.path}: its table {full[0]} has rows: copy to a new file or an empty schema")
        try:
            runs = list[str | None]()
            for name in names(theirs):
                if not (found := damages(check_run, theirs, name)):
                    runs.append(name)
                elif not only_intact:
                    raise found[0]
            counts = dict.fromkeys(TABLES, 0)
            digests = hashlib.sha256(), hashlib.sha256()
            # A recorder begins without either of these; with a damaged one it would not.
            left_out = {name for name in ("leader", "campaign") if only_intact and damages(check_table, theirs, name)}
            parts = [
                (name, run)
                for name in TABLES
                if name not in left_out
                for run in (runs if only_intact and name in OF_RUNS else [None])
            ]
            for name, run in parts:
                insert = f"INSERT INTO {name} VALUES ({','.join('?' * len(TABLES[name]))})"
                for rows in pages(theirs, name, run):
                    if is_server(target):
                        _check_texts(theirs.path, name, rows)
                    ours.write_many(insert, rows)
                    _add(digests[0], rows)
                    counts[name] += len(rows)
                    report(name, counts[name])
            for name, run in parts:
                for rows in pages(ours, name, run):
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


def _check_texts(path: str, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
    """Raises BadInput for the one character that no text of a server can have: it would be another text there."""
    for row in rows:
        for column, value in zip(TABLES[table], row, strict=True):
            if isinstance(value, str) and "\0" in value:
                of = f"run {row[TABLES[table].index('run')]!r}, " if table in OF_RUNS else ""
                where = printable(f"{path}: {of}table {table}, column {column}")
                raise BadInput(f"{where}: a text with U+0000, which no PostgreSQL server can hold: copy to a file")


def _add(digest: Any, rows: Sequence[tuple[Any, ...]]) -> None:
    for row in rows:
        for value in row:
            told = value if isinstance(value, bytes) else repr(value).encode()
            digest.update(f"{type(value).__name__} {len(told)} ".encode())
            digest.update(told)
