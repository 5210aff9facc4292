"""What the file of a store holds, read and closed again."""

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.seal import sealed

KEYS = {"run": ("run",), "message": ("run", "k", "topic", "item"), "command": ("run", "n")}


def rows(path: str | Path, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
    """Rows of a SELECT."""
    with closing(Journal(str(path), read_only=True)) as journal:
        return journal.read(query, parameters)


def seal(journal: Journal) -> None:
    """Give all rows the checksums of what they hold, as if a recorder had written them; durably."""
    for table, key in KEYS.items():
        for row in journal.read(f"SELECT * FROM {table}"):
            if table == "run":
                (row["messages"],) = journal.rows(
                    "SELECT COUNT(*) FROM message WHERE run = ? AND k < ?", [row["run"], row["acknowledged_k"]]
                )[0]
            new = sealed(table, row)
            names, where = ", ".join(f"{name} = ?" for name in new), " AND ".join(f"{name} = ?" for name in key)
            journal.write(f"UPDATE {table} SET {names} WHERE {where}", *new.values(), *(row[name] for name in key))
    journal.commit()


def answered(path: str | Path, metric: str, **parameters: str) -> list[dict[str, Any]]:
    """Rows of a metric."""
    with closing(Store(Journal(str(path), read_only=True))) as store:
        return answer(store, metric, parameters)


def result(path: str | Path) -> Result:
    """The newest run, with whose last reference the file is closed."""
    store = Store(Journal(str(path), read_only=True))
    return Result(StoredRun(partial(answer, store)), close=store.close)
