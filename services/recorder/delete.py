"""Deleting one run from a store, while no process writes it."""

from contextlib import closing

from cogradar.services.errors import BadInput, NoSuchRun
from cogradar.services.recorder.store.check import OF_RUNS, held_still
from cogradar.services.recorder.store.database import Database
from cogradar.shared.scenario.faults import printable


def delete(name: str, run: str) -> dict[str, int]:
    """Delete a run with all that belongs to it, or nothing of it; how many rows of each table.

    Raises BadInput if there is no such run or it has not ended, InUse if a process writes the store, StoreFailed.
    """
    with held_still(name) as store:  # a writer would make a store where there is none
        _check(store, run)
    with closing(Database(name, owner="cogradar store")) as store:
        try:
            _check(store, run)
            counts = {table: store.write(f"DELETE FROM {table} WHERE run = ?", run) for table in OF_RUNS}
            store.commit()
        except BaseException:
            store.rollback()
            raise
    return counts


def _check(store: Database, run: str) -> None:
    found = store.rows("SELECT status FROM run WHERE run = ?", [run])
    if not found:
        raise NoSuchRun(printable(f"{store.path}: no such run: {run}; `cogradar query runs --store` lists them"))
    if found[0][0] == "running":
        raise BadInput(
            printable(
                f"{store.path}: run {run} has not ended: end it with `cogradar cancel {run}`, at the services of"
                " this store, before it is deleted"
            )
        )
