"""A run as it was recorded: how it began, and its messages in pages, for programs that want more than its scores."""

import base64
import json
from collections.abc import Mapping
from itertools import groupby
from operator import itemgetter

from cogradar.services.errors import BadInput
from cogradar.services.metrics.selection import ALL, Run, Selection, number, selected
from cogradar.services.metrics.store import Store
from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE

TOPICS = tuple(BY_MESSAGE[message].name for message in (Scan, Truth, Plan, Waveform))
PAGE_BYTES = 1 << 20  # of payloads; a page that has so many is ended,
AT_ONCE = 16  # ... after so many dwells, which are read at a time


def one_run(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """The row of one run, with its scenario as a document."""
    runs = selected(store, Selection.of(parameters))
    if not runs:
        raise BadInput("there is no run yet")
    if parameters.get("run") == ALL:
        raise BadInput(f"run = {ALL!r}: one run, please")
    (row,) = runs
    (document,) = store.read("SELECT document FROM run WHERE run = ?", [row["run"]])
    return [row | {"document": json.loads(document["document"])}]


def orders(store: Store, parameters: Mapping[str, str]) -> list[Run]:
    """The commands of one run that were granted: number, dwell from which on, and action."""
    (run,) = one_run(store, parameters)
    query = "SELECT n, k, action FROM command WHERE run = ? AND k IS NOT NULL ORDER BY n"
    return [row | {"action": json.loads(row["action"])} for row in store.read(query, [run["run"]])]


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
        raise BadInput(f"run = {run!r}: no such run")
    for first in range(max(number(parameters, "k", 0) or 0, ends[0]["kept_k"]), ends[0]["k"], AT_ONCE):
        stored = store.messages(run, topics, first, min(first + AT_ONCE, ends[0]["k"]) - 1)
        for k, messages in groupby(stored, itemgetter(0)):
            payloads = [payload for _, _, payload in messages]
            rows.append({"k": k, "payloads": [base64.b64encode(payload).decode() for payload in payloads]})
            size += sum(map(len, payloads))
        if size >= PAGE_BYTES:
            break
    return rows
