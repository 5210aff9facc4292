"""A run as it was recorded: how it began, its messages in pages, the commands to it, and why none can be given."""

import base64
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from operator import itemgetter
from typing import Any

from cogradar.services.errors import BadInput
from cogradar.services.metrics.selection import ALL, LISTING, Run, Selection, number, selected, whole
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import order_of
from cogradar.services.recorder.store.tables import MAX_COMMANDS
from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform
from cogradar.shared.protocol.orders import (
    OF_TRACK,
    Accuracy,
    DropTrack,
    EndRun,
    Look,
    Order,
    SectorSearch,
    Setting,
    in_force,
)
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.protocol.words.orders import text_of
from cogradar.shared.scenario.faults import printable
from cogradar.shared.signal.array import across_km
from cogradar.shared.wire.codec import fields

TOPICS = tuple(BY_MESSAGE[message].name for message in (Scan, Truth, Plan, Waveform))
PAGE_BYTES = 1 << 20  # of payloads; a page that has so many is ended,
AT_ONCE = 16  # ... after so many dwells, which are read at a time
OPEN = "open"  # as the state that is asked for: what is not over and was not refused
NEWEST_DWELLS = 32  # in which the newest waveform is looked for: without one, the allocator is away
_COLUMNS = {name: name for name in ("run", "n", "by", "asked", "action", "k", "reason", "id", "over_k")}
_COLUMNS |= {"by": "asker", "asked": "asked_s"}


def utc(seconds: Any) -> str | None:
    """Seconds since 1970 as a date with its time; None of what a store cannot mean: it may come from anywhere."""
    try:
        return f"{datetime.fromtimestamp(int(seconds), UTC):%Y-%m-%dT%H:%M:%SZ}"
    except (TypeError, ValueError, OverflowError, OSError):
        return None


def one_run(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """The row of one run, with its scenario as a document."""
    runs = selected(store, Selection.of(parameters))
    if not runs:
        raise BadInput("there is no run yet")
    if parameters.get("run") == ALL:
        raise BadInput(f"run = {ALL!r}: one run, please")
    (row,) = runs
    found = store.whole_row(row["run"])
    return [] if found is None else [row | {"document": json.loads(found["document"])}]


def orders(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """The commands of one run that were granted: number, dwell from which on, and action."""
    (run,) = one_run(store, parameters)
    rows = store.stored("command", "WHERE run = ? ORDER BY n", [run["run"]])
    return [_order(run["run"], row).model_dump() for row in rows if row["k"] is not None]


def page(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """Messages of a run from dwell k on: `k`, and `payloads` in the order of topic and track; no row after the last.

    Parameters: run, topics (comma-separated), k.
    """
    topics = parameters.get("topics", "").split(",")
    if set(parameters) - {"run", "topics", "k"} or not set(topics) <= set(TOPICS):
        raise BadInput(f"`messages` takes run, topics of {','.join(TOPICS)}, and k")
    run, rows, size = parameters.get("run", ""), list[Run](), 0
    ends = store.read("SELECT acknowledged_k AS k, kept_k FROM run WHERE run = ?", [run])
    if not ends:
        raise BadInput(f"run = {run!r}: no such run; {LISTING}")
    for first in range(max(number(parameters, "k", 0) or 0, ends[0]["kept_k"]), ends[0]["k"], AT_ONCE):
        stored = store.messages(run, topics, first, min(first + AT_ONCE, ends[0]["k"]) - 1)
        for k, messages in groupby(stored, itemgetter(0)):
            payloads = [payload for _, _, payload in messages]
            rows.append({"k": k, "payloads": [base64.b64encode(payload).decode() for payload in payloads]})
            size += sum(map(len, payloads))
        if size >= PAGE_BYTES:
            break
    return rows


def commands(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """One row per command of a run: who asked for what, when, and what became of it.

    Parameters as of a selection, without target and dwells; state = "open". Raises BadInput.
    """
    parameters = dict(parameters)
    state = parameters.pop("state", None)
    if state not in {None, OPEN}:
        raise BadInput(f"state = {state!r}: must be {OPEN}")
    selection = Selection.of(parameters)
    whole("commands", selection)
    found = list[Run]()
    for run in selected(store, selection):
        if state is None:
            found += _rows(store, run)
        elif run["status"] == "running":
            rows = _rows(store, run, "k IS NOT NULL AND over_k IS NULL")
            found += [row for row in rows if row["state"] != "over"]
    return selection.page(found)


def command(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """The row of the command with this id, if the journal of the run has it. Parameters: run, id."""
    (run,) = selected(store, Selection(run=parameters.get("run", "")))
    return _rows(store, run, "id = ?", [parameters.get("id", "")])


def refusal(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """Why no command can be given to a run: `fault`, missing, ended, full or held, and `reason`; no row if one can.

    Parameters: run; kept, how many commands must be left for more urgent ones (`order_book.commands_kept_free`).
    """
    name, kept = parameters.get("run", ""), number(parameters, "kept", 0) or 0
    query = "SELECT status, (SELECT COUNT(*) FROM command WHERE command.run = run.run) AS n FROM run WHERE run = ?"
    rows = store.read(query, [name])
    if not rows:
        return [{"fault": "missing", "reason": f"run = {name!r}: no such run; {LISTING}"}]
    if (status := rows[0]["status"]) != "running":
        return [{"fault": "ended", "reason": f"run = {name!r}: has ended already ({status})"}]
    if (n := rows[0]["n"]) >= MAX_COMMANDS - kept:
        others = f"; {MAX_COMMANDS - n} more are kept for what is more urgent" if n < MAX_COMMANDS else ""
        return [{"fault": "full", "reason": f"run = {name!r}: has {n} commands, which is all it can have{others}"}]
    if name in store.held:
        return [{"fault": "held", "reason": f"run = {name!r}: is held, the recorder cannot write its journal"}]
    return []


def _rows(store: Store, run: Run, condition: str = "TRUE", values: Sequence[str] = ()) -> list[Run]:
    """list[Run] of `commands` of one run."""
    stored = store.stored("command", f"WHERE run = ? AND {condition} ORDER BY n", [run["run"], *values])
    rows = [{shown: row[name] for shown, name in _COLUMNS.items()} for row in stored]
    if not rows:
        return []
    (newest,) = store.read("SELECT MAX(k) AS k FROM message WHERE run = ? AND topic = 'scan'", [run["run"]])
    k = -1 if newest["k"] is None else newest["k"]
    missing, unmet, over = set[int](), dict[int, str](), set[int]()
    if run["status"] == "running":
        asked = store.stored("command", "WHERE run = ? AND k <= ? AND over_k IS NULL", [run["run"], k])
        begun = [_order(run["run"], row) for row in asked]
        there = in_force(begun, k)
        # The recorder notes an end with its next checkpoint, some dwells later.
        over = {order.n for order in begun if order not in there and not isinstance(order.action, DropTrack | EndRun)}
        missing, unmet = _missing(store, run["run"], k, there), _unmet(store, run["run"], k, there)
    return [_row(run, row, k, unmet, is_missing=row["n"] in missing, is_over=row["n"] in over) for row in rows]


def _order(run: str, row: Run) -> Order:
    """The order in a row of `command`. Raises BadInput: a store may come from anywhere."""
    try:
        return order_of(row)
    except (ValueError, TypeError) as error:
        what = " ".join(str(error).split())[:200]
        raise BadInput(printable(f"run = {run!r}: command {row['n']} cannot be read: {what}")) from None


def _row(
    run: Run, row: dict[str, Any], newest_k: int, unmet: Mapping[int, str], *, is_missing: bool, is_over: bool
) -> dict[str, Any]:
    is_over = row.pop("over_k") is not None or is_over or run["status"] != "running"
    if row["k"] is None or is_over:
        state = "refused" if row["k"] is None else "over"
    elif row["k"] > newest_k:
        state = "pending"
    else:
        state = "awaits the allocator" if is_missing else "in force"
        if row["n"] in unmet and not is_missing:
            state, row["reason"] = "not met", unmet[row["n"]]
    action = _order(run["run"], {"n": row["n"], "k": 0, "action": row["action"]}).action
    t = None if None in {row["k"], run["acquisition_scans"]} else row["k"] + 1 - run["acquisition_scans"]
    row["asked"] = utc(row["asked"])
    return row | {"t": t, "action": text_of(action), "state": state}


def _missing(store: Store, run: str, newest_k: int, there: Sequence[Order]) -> set[int]:
    """Numbers of orders in force in the newest dwell that change its beams, and that the newest waveform does not obey.

    In real time the front end goes on with an old waveform while the allocator is away. Limits it knows itself.
    """
    asked = {order.n for order in there if isinstance(order.action, SectorSearch | Look | OF_TRACK | Setting)}
    if not asked:
        return asked
    newest = _newest(store, run, "waveform", 0, newest_k)
    obeyed = newest.get("orders") if newest else None
    return asked - set([] if obeyed is None else obeyed.tolist())


def _unmet(store: Store, run: str, newest_k: int, there: Sequence[Order]) -> dict[int, str]:
    """Number of each order in force for an accuracy that its track's newest plan lacks, and what it has instead."""
    found = {}
    for order in there:
        if not isinstance(order.action, Accuracy) or order.action.km is None:
            continue
        plan = _newest(store, run, "plan", order.action.track + 1, newest_k)
        if plan and plan["status"] == "tracking":
            plane = "plane_" if plan.get("plane_estimate") is not None else ""
            km = across_km(plan[f"{plane}estimate"], plan[f"{plane}covariance"])
            if km > order.action.km:
                found[order.n] = f"known to {km:.3g} km across the line of sight in dwell {plan['k']}"
    return found


def _newest(store: Store, run: str, topic: str, item: int, newest_k: int) -> dict[str, Any] | None:
    """The newest message of a topic, of a track if there is one for each, unless it is old."""
    rows = store.stored(
        "message",
        "WHERE run = ? AND k BETWEEN ? AND ? AND topic = ? AND item = ? ORDER BY k DESC LIMIT 1",
        [run, newest_k - NEWEST_DWELLS, newest_k, topic, item],
    )
    return fields(rows[0]["payload"]) if rows else None
