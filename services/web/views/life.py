"""The life of one track, where nobody knows how many targets there are: what a chart over time shows of it."""

import json
from collections.abc import Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from services.metrics.scores import Fields
from services.metrics.store import Store
from services.web.parameters import asked
from services.web.problems import missing
from services.web.rows import headers_of, run_of, store_of, unchanged
from services.web.views.columns import columns
from services.web.views.history import MAX_POINTS
from services.web.views.radar import Facts, facts
from services.web.views.tracks import track_of
from shared.wire.codec import fields

NAMES = (*("t", "share", "existence", "confirmed", "statistic", "threshold", "detected", "target", "error_km", "late"),)


def life(request: Request) -> Response:
    """The course of a track, from its first dwell to its last."""
    parameters, name = asked(request, ("track", "dwells"), required=("track",)), run_of(request)
    if answered := unchanged(request, name):
        return answered
    store, headers = store_of(request), headers_of(request, name)
    known = facts(store, name)
    track = known.track(parameters["track"])
    first, last = known.dwells(parameters.get("dwells", ":"))
    lived = store.read(
        "SELECT p.k, p.t FROM picture AS p CROSS JOIN message AS m ON m.run = p.run AND m.k = p.k AND m.topic = 'plan'"
        " AND m.item = ? WHERE p.run = ? AND p.t BETWEEN ? AND ? ORDER BY p.t",
        [track, name, first, last],
    )
    if not lived:
        raise missing(f"run = {name!r}: no track {track} in dwells {first} to {last}")
    every = max(1, -(-len(lived) // MAX_POINTS))
    rows = _rows(store, known, track, lived[::-1][::every][::-1])
    return columns({"run": name, "track": track, "every": every}, NAMES, rows, headers)


def _rows(store: Store, known: Facts, track: int, dwells: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The track in these dwells, as far as their scans are stored."""
    run = known.row["run"]
    targets = store.read(
        f"SELECT t, target, x, y FROM json_each(?) AS dwell CROSS JOIN {store.table(run)} AS s"
        " ON s.run = ? AND s.t = dwell.value AND s.track = ?",
        [json.dumps([dwell["t"] for dwell in dwells]), run, track],
    )
    followed = {row["t"]: row for row in targets}
    ks = [dwell["k"] for dwell in dwells]
    sent_k = {k: truth["waveform_k"] for k, truth in _stored(store, run, "truth", 0, ks).items()}
    waveforms = _stored(store, run, "waveform", 0, [sent_k.get(k, k - 1) for k in ks])
    scans, plans = _stored(store, run, "scan", 0, ks), _stored(store, run, "plan", track, ks)
    found = []
    for k, t in ((dwell["k"], dwell["t"]) for dwell in dwells):
        if k in scans:
            after = plans[k], followed.get(t)
            one = track_of(known, scans[k], waveforms.get(sent_k.get(k, k - 1)), track - 1, after)
            found.append({"t": t, **one})
    return found


def _stored(store: Store, run: str, topic: str, item: int, ks: list[int]) -> Mapping[int, Fields]:
    rows = store.read(
        "SELECT m.k, m.payload FROM json_each(?) AS dwell CROSS JOIN message AS m"
        " ON m.run = ? AND m.k = dwell.value AND m.topic = ? AND m.item = ?",
        [json.dumps(ks), run, topic, item],
    )
    return {row["k"]: fields(row["payload"]) for row in rows}
