"""Copying a store into an empty one, from a file to a server or back: all rows, or none."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

from cogradar.services.errors import BadInput, Damaged, StoreFailed
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

Part = tuple[str, str | None]  # table, and the run whose rows of it are copied; None: all rows


def copy(
    source: str,
    target: str,
    report: Callable[[str, int], None] = lambda *_: None,
    *,
    only_intact: bool = False,
    left_out: Callable[[Damaged], None] = lambda _: None,
) -> dict[str, int]:
    """Copy what is committed at this moment; how many rows each table has.

    The copy is read again, and compared row by row, before it is committed.

    report : gets the table and how many rows of it are copied; what it raises ends the copy; the target is then empty
    only_intact : leave out runs with a damaged row, and what belongs to no run if it is damaged
    left_out : gets what is damaged of each run, or of each table, that is left out

    Raises BadInput if the target is not empty or cannot hold a text, Damaged, StoreFailed.
    """
    with held_still(source) as theirs, closing(Database(target, owner="cogradar store")) as ours:
        if full := [name for name in TABLES if ours.rows(f"SELECT 1 FROM {name} LIMIT 1")]:
            raise BadInput(f"{ours.path}: its table {full[0]} has rows: copy to a new file or an empty schema")
        try:
            parts = _intact(theirs, left_out) if only_intact else _all(theirs)
            counts = dict.fromkeys(TABLES, 0)
            digests = hashlib.sha256(), hashlib.sha256()
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


def _all(store: Database) -> list[Part]:
    """Every table. Raises Damaged if a run is."""
    for run in names(store):
        for error in damages(check_run, store, run):
            raise error
    return [(table, None) for table in TABLES]


def _intact(store: Database, left_out: Callable[[Damaged], None]) -> list[Part]:
    """The runs and tables that are whole. Raises Damaged if no run is."""
    of_runs = {run: damages(check_run, store, run) for run in names(store)}
    others = {table: damages(check_table, store, table) for table in TABLES if table not in OF_RUNS}
    lost = [error for found in (of_runs, others) for errors in found.values() for error in errors]
    runs = [run for run, errors in of_runs.items() if not errors]
    if of_runs and not runs:
        raise lost[0]
    for error in lost:
        left_out(error)
    # A recorder begins without the other tables; with a damaged one it would not.
    return [
        (table, run)
        for table in TABLES
        for run in (runs if table in OF_RUNS else [None])
        if table in OF_RUNS or not others[table]
    ]


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
