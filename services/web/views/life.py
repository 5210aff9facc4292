"""The life of one track, where nobody knows how many targets there are: what a chart over time shows of it."""

from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from services.metrics import queries
from services.metrics.store import Store
from services.web.parameters import asked
from services.web.problem_documents import missing
from services.web.run_answers import headers_of, run_of, store_of, unchanged
from services.web.views.column_response import columns
from services.web.views.history import MAX_POINTS
from services.web.views.radar import Facts, facts
from services.web.views.tracks import track_of

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
    lived = queries.track_dwells(store, name, track, first, last)
    if not lived:
        raise missing(f"run = {name!r}: no track {track} in dwells {first} to {last}")
    every = max(1, -(-len(lived) // MAX_POINTS))
    rows = _rows(store, known, track, lived[::-1][::every][::-1])
    return columns({"run": name, "track": track, "every": every}, NAMES, rows, headers)


def _rows(store: Store, known: Facts, track: int, dwells: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The track in these dwells, as far as their scans are stored."""
    run = known.row["run"]
    followed = queries.followed_by(store, run, track, [dwell["t"] for dwell in dwells])
    ks = [dwell["k"] for dwell in dwells]
    sent_k = {k: truth["waveform_k"] for k, truth in queries.messages(store, run, "truth", ks).items()}
    waveforms = queries.messages(store, run, "waveform", [sent_k.get(k, k - 1) for k in ks])
    scans, plans = queries.messages(store, run, "scan", ks), queries.messages(store, run, "plan", ks, track)
    found = []
    for k, t in ((dwell["k"], dwell["t"]) for dwell in dwells):
        if k in scans:
            after = plans[k], followed.get(t)
            one = track_of(known, scans[k], waveforms.get(sent_k.get(k, k - 1)), track - 1, after)
            found.append({"t": t, **one})
    return found
