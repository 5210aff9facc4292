"""The runs whose own rows are damaged: they are set aside when a recorder begins, and the others go on."""

import logging
from collections.abc import Iterator
from contextlib import suppress

from cogradar.services.errors import Damaged, DamagedIndex
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.check import OF_RUNS
from cogradar.services.recorder.store.seal import LISTED, QUARANTINED, verify

_ROWS = f"SELECT {LISTED['run']} FROM run WHERE status <> ?"
_KNOWN = "SELECT 1 FROM run WHERE run = ? UNION SELECT 1 FROM dropped WHERE run = ?"
log = logging.getLogger(__name__)


def set_aside(journal: Journal) -> list[tuple[str, str]]:
    """Set aside the runs whose own rows are damaged: names and reasons. Raises Damaged if it is the whole store."""
    try:
        rows, found = journal.read(_ROWS, [QUARANTINED]), list[tuple[str, str]]()
    except DamagedIndex:
        raise
    except Damaged as error:
        found = _made_anew(journal, error)
        rows = journal.read(_ROWS, [QUARANTINED])
    for row in rows:
        try:
            verify(journal.path, "run", row)
        except Damaged as error:
            journal.quarantine_place(row["place"], str(error))
            found.append((str(row["run"]), str(error)))
    return found


def _made_anew(journal: Journal, error: Damaged) -> list[tuple[str, str]]:
    """Go on with the rows of runs that can be read; the others, as far as something else in the store names them."""
    journal.rollback()  # what cannot be read is met again now, and would spoil a transaction
    names = {name for table in OF_RUNS for name in _named(journal, table)}
    old, lost = journal.made_anew("run")
    reason = f"its row is on a page that cannot be read, in table {old} now: {error}"
    found = [(name, reason) for name in sorted(names) if not journal.rows(_KNOWN, [name, name])]
    for name, why in found:
        journal.add_unknown(name, why)
    log.error(
        "%s: %s of table run cannot be read, and stay in table %s; runs that are named by other tables are set aside: "
        "%d. A run that has only begun may be on them, too: begin it again",
        *(journal.path, lost, old, len(found)),
    )
    return found


def _named(journal: Journal, table: str) -> Iterator[str]:
    """Names of runs in a table, as far as it can be read: in a file an index alone answers this."""
    name = ""
    with suppress(Damaged):
        while rows := journal.rows(f"SELECT run FROM main.{table} WHERE run > ? ORDER BY run LIMIT 1", [name]):
            name = rows[0][0]
            yield name
