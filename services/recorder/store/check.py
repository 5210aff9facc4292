"""Whether what a store holds is what was written to it."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

from cogradar.services.errors import Damaged
from cogradar.services.recorder.store.database import Database
from cogradar.services.recorder.store.seal import SEALED, damage, scores_checksum, verify, without_cure
from cogradar.services.recorder.store.tables import described, statements

AT_ONCE = 512  # rows; a message has at most 4 MiB, most have some kB
TABLES = {table.name: [column.name for column in columns] for table, columns in described()}
OF_RUNS = [table for table, columns in TABLES.items() if "run" in columns and table != "dropped"]
Row = tuple[Any, ...]
_KEYS = {
    re.findall(r"CREATE TABLE (\w+)", text)[0]: re.findall(r"PRIMARY KEY \((.*?)\)|(\w+) \w+ PRIMARY KEY", text)
    for text in statements()
}


def check(name: str, report: Callable[[str], None] = lambda _: None) -> list[Damaged]:
    """What is damaged in a store: of each run the first that is found.

    report : gets the name of each run before it is checked; what it raises ends the check

    Raises BadInput if it is no store, StoreFailed.
    """
    with held_still(name) as store:
        found = list[Damaged]()
        try:
            found += [damage(store.path, fault) for fault in store.faults()]
        except Damaged as error:
            found.append(error)
        try:
            for run in names(store):
                report(run)
                found += damages(check_run, store, run)
        except Damaged as error:
            return [*found, error]
        for table in TABLES:
            found += damages(check_known if table in OF_RUNS else check_table, store, table)
    return found


@contextmanager
def held_still(name: str) -> Iterator[Database]:
    """A store as it is now, to be read only."""
    with closing(Database(name, read_only=True)) as store:
        store.hold_still()
        try:
            yield store
        finally:
            store.rollback()  # what is damaged may not be committed, though nothing was written


def names(store: Database) -> list[str]:
    """The runs of a store, in the order in which they began; by name if rows of some cannot be read. Raises Damaged."""
    try:
        rows = store.rows("SELECT run FROM run ORDER BY place")
    except Damaged:
        rows = store.rows("SELECT run FROM run ORDER BY run")  # in a file an index alone answers this
    return [row[0] for row in rows]


def damages(look: Callable[[Database, str], object], store: Database, at: str) -> list[Damaged]:
    """What a look at a run, or at a table, finds."""
    try:
        look(store, at)
    except Damaged as error:
        is_of_run = not error.run and look is check_run
        what = without_cure(store.path, error).removeprefix(f"{store.path}: ")
        return [damage(store.path, f"run {at!r}: {what}", at) if is_of_run else error]
    return []


def check_run(store: Database, run: str) -> None:
    """Raises Damaged if any row of a run is not as it was written."""
    for table in OF_RUNS:
        for _ in pages(store, table, run):
            pass
    check_whole(store, run)
    check_scores(store, run)


def check_table(store: Database, table: str) -> None:
    """Raises Damaged if any row of a table is not as it was written."""
    for _ in pages(store, table):
        pass


def check_known(store: Database, table: str) -> None:
    """Raises Damaged if a table has rows of a run that is not there."""
    others = f"SELECT run FROM {table} WHERE run NOT IN (SELECT run FROM run UNION SELECT run FROM dropped) LIMIT 1"
    for (run,) in store.rows(others):
        raise damage(store.path, f"run {run!r}, table {table}: there is no such run")


def check_whole(store: Database, run: str) -> dict[str, Any]:
    """The row of a run. Raises Damaged if messages of acknowledged dwells are missing, or commands."""
    row = check_row(store, run)
    check_count(store, run, row["acknowledged_k"], row["messages"])
    return row


def check_row(store: Database, run: str) -> dict[str, Any]:
    """The row of a run. Raises Damaged if commands to it are missing."""
    rows = store.stored("run", "WHERE run = ?", [run])
    if not rows:
        raise damage(store.path, f"run {run!r}, table run: there is no such run", run)
    (row,) = rows
    for column in ("*", "checksum"):  # the first count is of an index in SQLite, the second one of the table
        ((found,),) = store.rows(f"SELECT COUNT({column}) FROM command WHERE run = ?", [run])
        if found != row["commands"]:
            what = f"table command: {found} are there, {row['commands']} were recorded"
            raise damage(store.path, f"run {run!r}, {what}", run)
    return row


def check_count(store: Database, run: str, k: int, n_message: int) -> None:
    """Raises Damaged unless a run has so many messages of the dwells below k."""
    ((found,),) = store.rows("SELECT COUNT(*) FROM message WHERE run = ? AND k < ?", [run, k])
    if found != n_message:
        raise missing(store, run, found, k, n_message)


def missing(store: Database, run: str, found: int, k: int, n_message: int) -> Damaged:
    """That a run has not as many messages of the dwells below k as were recorded."""
    what = f"{found} messages of the dwells below {k} are there, {n_message} were recorded"
    return damage(store.path, f"run {run!r}, table message: {what}", run)


def check_scores(store: Database, run: str) -> None:
    """Raises Damaged if the scores that are kept of a run are not as they were written."""
    for row in store.stored("run", "WHERE run = ?", [run]):
        found = scores_checksum(
            store.read("SELECT * FROM main.score WHERE run = ? ORDER BY t, target", [run]),
            store.read("SELECT * FROM main.picture WHERE run = ? ORDER BY t", [run]),
        )
        if found != row["scores_checksum"]:
            what = "their checksum does not fit"
            raise damage(store.path, f"run {run!r}, tables score and picture: {what}", run)


def pages(store: Database, table: str, run: str | None = None) -> Iterator[list[Row]]:
    """Rows of a table, or of a run in it, in the order of its key, some at a time. Raises Damaged."""
    columns = TABLES[table]
    key = [name.strip() for found in _KEYS[table] for part in found for name in part.split(",") if part]
    at = [columns.index(name) for name in key]
    order = f"ORDER BY {', '.join(key)} LIMIT {AT_ONCE}" if key else ""
    which, values = ("TRUE", []) if run is None else ("run = ?", [run])
    after = f"({', '.join(key)}) > ({','.join('?' * len(key))})"
    listed = f"SELECT {', '.join(columns)} FROM {table} WHERE {which}"
    rows = store.rows(f"{listed} {order}", values)
    last: Row = ()
    while rows:
        yield [_checked(store, table, row) for row in rows]
        if not key or len(rows) < AT_ONCE:
            return
        before, last = last, tuple(rows[-1][i] for i in at)
        if not before < last:  # or it would never end
            raise damage(store.path, f"table {table}: its rows are not in order")
        rows = store.rows(f"{listed} AND {after} {order}", [*values, *last])


def _checked(store: Database, table: str, row: Sequence[Any]) -> Row:
    if table in SEALED:
        verify(store.path, table, dict(zip(TABLES[table], row, strict=True)))
    return tuple(row)
