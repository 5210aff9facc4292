"""A checksum in each row of a store: bytes that something else has changed are found when they are read.

It covers the row's key, so that a row which is found in the place of another one does not fit either. It is the same in
a file and on a server, and a copy keeps it. It protects against failing disks and memory, not against people.
"""

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any
from zlib import crc32

from cogradar.services.errors import Damaged
from cogradar.services.recorder.store.address import is_server
from cogradar.services.recorder.store.tables import described
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scoring.columns import PICTURE, SCORE

CHECKSUM, DOCUMENT = "checksum", "document"
QUARANTINED = "quarantined"  # status of a run that is set aside
_WHY = "Bytes of the store were changed, as by a failing disk"
_OF_RUN = re.compile(r"\bWHERE run = \?")
_NEW = re.compile("INSERT INTO (message|snapshot) VALUES")
_APART = {CHECKSUM, DOCUMENT}  # a scenario is long, and has a checksum of its own in the row of its run
_KINDS = {one.name: {column.name: column.kind for column in columns} for one, columns in described()}
SEALED = {
    table: tuple(name for name in columns if name not in _APART or (table != "run" and name != CHECKSUM))
    for table, columns in _KINDS.items()
    if CHECKSUM in columns
}
LISTED = {table: ", ".join((*columns, CHECKSUM)) for table, columns in SEALED.items()}  # all of a row that is sealed
_WHERE = {"message": "dwell {k}, {topic} {item}", "snapshot": "track {target}, dwell {k}", "command": "command {n}"}


def checksum(values: tuple[Any, ...], payload: Any = b"") -> int:
    """CRC-32 of the values of a row; of the last one its bytes, if it is a payload."""
    known = payload if isinstance(payload, bytes) else ascii(payload).encode()
    return crc32(known, crc32(ascii(values).encode()))


def message_checksum(run: str, k: int, topic: str, item: int, payload: bytes) -> int:
    """The same of a message: there are many of them, and it takes a third of the time."""
    try:
        return crc32(payload, (_seed(run, topic) + k * 65537 + item) & 0xFFFFFFFF)  # of another k or item it differs
    except TypeError:
        return -1  # no message: numbers and bytes are of another kind


@lru_cache(maxsize=1024)
def _seed(run: str, topic: str) -> int:
    return crc32(ascii((run, topic)).encode())


def scores_checksum(scores: Sequence[Mapping[str, Any]], picture: Sequence[Mapping[str, Any]]) -> int | None:
    """Of what a campaign keeps of a run, in the order of time and target; None: nothing."""
    sums = list[int]()
    for rows, columns in ((scores, SCORE), (picture, PICTURE)):
        found = 0
        for row in rows:
            found = crc32(ascii([_plain(row.get(one.name), one.kind.sql) for one in columns]).encode(), found)
        sums.append(found)
    return checksum(tuple(sums)) if scores or picture else None


def sealed(table: str, row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with its checksum, and of a run with the one of its document."""
    found = dict(row)
    if table == "run" and DOCUMENT in found:
        found["document_checksum"] = checksum((found[DOCUMENT],))
    return found | {CHECKSUM: _checksum(table, found)}


def verify(store: str, table: str, row: Mapping[str, Any]) -> None:
    """Raises Damaged if a row, or the document in it, is not as it was written."""
    fits = _checksum(table, row) == row[CHECKSUM]
    if fits and table == "run" and DOCUMENT in row:
        fits = checksum((row[DOCUMENT],)) == row["document_checksum"]
    if not fits:
        raise damaged(store, table, row)


def damaged(store: str, table: str, row: Mapping[str, Any], what: str = "its checksum does not fit") -> Damaged:
    """What is said of a row that cannot be believed, and what to do about it."""
    run = str(row.get("run", ""))
    where = ", ".join(part for part in (f"table {table}", _WHERE.get(table, "").format(**row)) if part)
    return damage(store, f"run {run!r}, {where}: {what}" if run else f"{where}: {what}", run)


def run_asked(query: str, parameters: Sequence[Any]) -> str:
    """The run that a statement is about; "": all, or none."""
    if _NEW.match(query):
        return str(parameters[0])
    found = _OF_RUN.search(query)
    return "" if found is None else str(parameters[query.count("?", 0, found.start())])


def damage(store: str, what: str, run: str = "") -> Damaged:
    """The same of something that is no row."""
    return Damaged(printable(f"{store}: {what}. {_WHY}: {cure(store)}"), run)


def cure(store: str) -> str:
    """What to do about a damaged store."""
    return f"`cogradar store check {store}` lists what is damaged, `store copy --intact` saves the other runs"


def without_cure(store: str, error: Damaged) -> str:
    """What is damaged, for a command that is the cure itself."""
    return str(error).removesuffix(printable(f". {_WHY}: {cure(store)}"))


def beyond_cure(store: str, what: str) -> str:
    """What is damaged in a store that has no whole run, and what is left to do."""
    rows = "" if is_server(store) else f"; `sqlite3 {store} .recover` may find some of its rows"
    return printable(f"{what}. {_WHY}, and no run can be read whole: use a backup or another copy{rows}")


def _checksum(table: str, row: Mapping[str, Any]) -> int:
    if table == "message":
        return message_checksum(*(row[name] for name in SEALED[table]))
    kinds = _KINDS[table]
    *values, last = [_plain(row[name], kinds[name]) for name in SEALED[table]]
    return checksum(tuple(values), last) if isinstance(last, bytes) else checksum((*values, last))


def _plain(value: Any, kind: str) -> Any:
    """A value as any store gives it back. What is of another kind than its column was not written by us."""
    match kind, value:
        case "REAL", int() | float():
            return float(value) + 0.0  # -0.0 is 0.0
        case "INTEGER", _ if hasattr(value, "__index__") or (isinstance(value, float) and value.is_integer()):
            return int(value)
        case "TEXT", str():
            return value.replace("\0", "\ufffd")
    return value
