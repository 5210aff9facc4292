"""One dwell of a run as data: all that a page shows of it."""

import json
from functools import lru_cache
from typing import Any, NamedTuple

from services.metrics.scores import Fields
from services.metrics.store import Store
from shared.signal.receiver import threshold

AT_ONCE = 10  # dwells that are read together
_COLUMNS = (
    "target, track, true_bin, bin, detected, snr_db, x, vx, y, vy, x_hat, vx_hat, y_hat, vy_hat, share, late, stale"
)


class State(NamedTuple):
    """How far a run is."""

    status: str
    reason: str
    k: int  # scans that are durable
    t: int  # clock of the last one


def state(store: Store, run: str) -> State | None:
    """How far a run is, with all of that scored; None if there is none."""
    rows = store.read("SELECT status, reason, acknowledged_k AS k, acknowledged_t AS t FROM run WHERE run = ?", [run])
    store.derive([run])  # afterwards: what is said to be there has its scores
    return State(**rows[0]) if rows else None


def following(store: Store, run: str, t: int) -> list[tuple[int, str]]:
    """The next dwells after dwell t that have scores, at most AT_ONCE: t, and JSON."""
    table = store.table(run)
    found = store.read(f"SELECT DISTINCT t FROM {table} WHERE run = ? AND t > ? ORDER BY t LIMIT {AT_ONCE}", [run, t])
    dwells: dict[int, list[dict[str, Any]]] = {row["t"]: [] for row in found}
    if dwells:
        columns = f"SELECT k, t, {_COLUMNS} FROM {table}"
        ends = [run, min(dwells), max(dwells)]
        for row in store.read(f"{columns} WHERE run = ? AND t BETWEEN ? AND ? ORDER BY t, target", ends):
            dwells[row.pop("t")].append(row)
    limit = _threshold(_p_fa(store, run))
    return [(t, _dwell(store, run, t, rows, limit)) for t, rows in dwells.items()]


def acquisition(store: Store, run: str, k: int) -> str:
    """Scan k, in which targets are still looked for."""
    stored = store.dwell(run, k)
    plans = [
        {
            "track": plan["target"] + 1,
            "status": plan["status"],
            "bin": plan["bin"] if plan["bin"] >= 0 else None,
            **dict(zip(("x_hat", "vx_hat", "y_hat", "vy_hat"), plan["estimate"].tolist(), strict=True)),
        }
        for plan in stored["plan"]
    ]
    cells = _cells(stored["scan"], _threshold(_p_fa(store, run)))
    return json.dumps({"run": run, "t": 0, "k": k, "scans": k + 1, "tracks": plans, "cells": cells})


def _dwell(store: Store, run: str, t: int, rows: list[dict[str, Any]], limit: float) -> str:
    k = rows[0]["k"]
    cells = _cells(store.dwell(run, k)["scan"], limit)
    tested = dict(zip(cells["bin"], cells["statistic"], strict=True)) if cells else {}
    targets = []
    for row in rows:
        del row["k"]
        flags = {name: None if row[name] is None else bool(row[name]) for name in ("detected", "late", "stale")}
        cell = row["bin"] if row["true_bin"] is None else row["true_bin"]
        targets.append(row | flags | {"statistic": tested.get(cell)})
    return json.dumps({"run": run, "t": t, "k": k, "threshold": limit, "targets": targets, "cells": cells})


def _cells(scans: list[Fields], limit: float) -> dict[str, list[Any]] | None:
    """The cells that were tested; None if the scan is not stored. A detection at no target's bin is a false alarm."""
    if not scans:
        return None
    (scan,) = scans
    is_over = scan["statistic"] >= limit
    return {"bin": scan["bins"].tolist(), "statistic": scan["statistic"].tolist(), "detected": is_over.tolist()}


def _p_fa(store: Store, run: str) -> float:
    (row,) = store.read(
        "SELECT json_extract(document, '$.radar.detector.p_fa') AS p_fa FROM run WHERE run = ?", [run]
    ) or [{"p_fa": 0.5}]
    return float(row["p_fa"])


@lru_cache(maxsize=64)
def _threshold(p_fa: float) -> float:
    return float(threshold(p_fa))
