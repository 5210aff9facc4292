"""A whole run in at most MAX_BUCKETS pieces: what the bar below all views shows."""

from starlette.requests import Request
from starlette.responses import Response

from services.metrics import sums
from services.web.parameters import asked
from services.web.rows import headers_of, run_of, store_of, unchanged
from services.web.views.columns import columns
from services.web.views.radar import facts

MAX_BUCKETS = 600
MIN_BLOCKS = 2  # of a bucket, which has more dwells then than a track is judged by
MAX_ROWS = 30_000  # of scores that are read one by one, some 50 ms; of more there are sums over blocks of dwells
NAMES = ("first", "last", "detected", "lost", "late", "stale", "error_km", "missed", "swaps")
_KNOWN = {"missed": None, "swaps": None}  # where the number of tracks is
# ... where it is not: what all tracks and targets come to.
_OF_PICTURES = (
    "SELECT MIN(t) AS first, MAX(t) AS last, NULL AS detected, NULL AS lost, NULL AS late, NULL AS stale,"
    " sqrt(SUM(localisation_km2) / SUM(followed)) AS error_km, 1.0 - 1.0 * SUM(followed) / SUM(targets) AS missed,"
    " SUM(swaps) AS swaps FROM picture WHERE run = ? GROUP BY t / {width} ORDER BY 1"
)


def timeline(request: Request) -> Response:
    """What a run came to, piece by piece."""
    asked(request, ())
    name = run_of(request)
    if answered := unchanged(request, name):
        return answered
    store, headers = store_of(request), headers_of(request, name)
    known = facts(store, name)
    width = -(-(known.newest + 1) // MAX_BUCKETS)  # t / width: a bucket more
    if known.is_unknown:
        rows = store.read(_OF_PICTURES.format(width=width), [name])
        return columns({"run": name, "t": known.newest, "width": width}, NAMES, rows, headers)
    if known.newest * known.row["n_target"] > MAX_ROWS:
        width = sums.DWELLS * max(MIN_BLOCKS, -(-width // sums.DWELLS))
    rows = [row | _KNOWN for row in store.read(*sums.timeline(name, store.table(name), width))]
    if rows:  # its newest bucket may be short: what is lost now is what the newest dwell says
        (now,) = store.read(*sums.lost(name, store.table(name), rows[-1]["last"]))
        rows[-1] |= now
    return columns({"run": name, "t": known.newest, "width": width}, NAMES, rows, headers)
