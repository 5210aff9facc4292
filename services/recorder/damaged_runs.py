"""The runs whose own rows are damaged: they are set aside when a recorder begins, and the others go on."""

from collections.abc import Iterator
from contextlib import suppress

from cogradar.services.errors import Damaged, DamagedIndex
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.seal import LISTED, QUARANTINED, verify

_ROWS = f"SELECT {LISTED['run']} FROM run WHERE status <> ?"
_KNOWN = "SELECT 1 FROM run WHERE run = ? UNION SELECT 1 FROM dropped WHERE run = ?"


def set_aside(journal: Journal) -> list[tuple[str, str]]:
    """Set aside the runs whose own rows are damaged: names and reasons. Raises Damaged if it is the whole store."""
    try:
        rows, found = journal.read(_ROWS, [QUARANTINED]), list[tuple[str, str]]()
    except DamagedIndex:
        raise
    except Damaged as error:
        if not (old := journal.made_anew("run")):
            raise
        reason = f"its row is on a page that cannot be read, in table {old} now: {error}"
        rows, found = journal.read(_ROWS, [QUARANTINED]), [(name, reason) for name in _lost(journal)]
        for name, why in found:
            journal.add_unknown(name, why)
    for row in rows:
        try:
            verify(journal.path, "run", row)
        except Damaged as error:
            journal.quarantine_place(row["place"], str(error))
            found.append((str(row["run"]), str(error)))
    return found


def _lost(journal: Journal) -> list[str]:
    """Runs that have messages and no row, as far as messages can be read."""
    return [name for name in _recorded(journal) if not journal.rows(_KNOWN, [name, name])]


def _recorded(journal: Journal) -> Iterator[str]:
    name = ""
    with suppress(Damaged):
        while rows := journal.rows("SELECT run FROM message WHERE run > ? ORDER BY run LIMIT 1", [name]):
            name = rows[0][0]
            yield name
