"""Deleting one run from a store, while no process writes it."""

from collections.abc import Callable
from contextlib import closing

from cogradar.services.errors import BadInput, Busy, Damaged, InUse, NoSuchRun
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.check import held_still
from cogradar.services.recorder.store.database import Database
from cogradar.services.recorder.store.seal import damage
from cogradar.shared.scenario.faults import printable


def delete(name: str, run: str, report: Callable[[int], None] = lambda _: None) -> None:
    """Delete a run with all that belongs to it; its messages some at a time, so that a full disk has room for each.

    It is no run any more before the first of them goes. If this ends early, the next recorder deletes the rest, or the
    next call with any run, this one included. What was dropped before goes as well.

    report : gets the number of messages that are deleted, after each step; what it raises ends the deletion

    Raises BadInput if there is no such run or it has not ended, InUse if another process has the store, StoreFailed.
    """
    try:
        with held_still(name) as store:  # a writer would make a store where there is none
            _check(store, run)
        with closing(Journal(name, owner="cogradar store")) as journal:
            try:
                _delete(journal, run, report)
            except BaseException:
                journal.rollback()
                raise
    except Busy:
        said = "another process reads or writes this store; try again when it is over"
        raise InUse(f"{printable(name)}: {said}") from None


def _delete(journal: Journal, run: str, report: Callable[[int], None]) -> None:
    _check(journal, run)
    journal.drop(run)
    journal.commit()
    n = 0
    report(n)
    while before := journal.dropped():
        n += journal.delete_dropped()
        try:
            journal.commit()
        except Damaged:
            journal.rollback()
            if journal.dropped() == before:  # else the journal knows which run that is, and goes on with the others
                raise
        report(n)
    if journal.rows("SELECT run FROM dropped WHERE run = ?", [run]):
        raise damage(journal.path, f"run {run!r} is deleted, but not all of its messages: some cannot be read", run)


def _check(store: Database, run: str) -> None:
    found = store.rows("SELECT status FROM run WHERE run = ?", [run])
    if not found and not store.rows("SELECT run FROM dropped WHERE run = ?", [run]):
        raise NoSuchRun(printable(f"{store.path}: no such run: {run}; `cogradar query runs --store` lists them"))
    if found and found[0][0] == "running":
        raise BadInput(
            printable(
                f"{store.path}: run {run} has not ended: end it with `cogradar cancel {run}`, at the services of"
                " this store, before it is deleted; if its processes are gone, the next `cogradar run --store` on it"
                " marks it as failed, and so does a recorder with --no-resume"
            )
        )
