"""A whole run in at most MAX_BUCKETS pieces: what the bar below all views shows."""

from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.metrics import queries
from cogradar.services.metrics.scoring import sums
from cogradar.services.web.run_answers import Question, about_run
from cogradar.services.web.views.column_response import columns
from cogradar.services.web.views.radar import facts

MAX_BUCKETS = 600
MIN_BLOCKS = 2  # of a bucket, which has more dwells then than a track is judged by
MAX_ROWS = 30_000  # of scores that are read one by one, some 50 ms; of more there are sums over blocks of dwells
NAMES = ("first", "last", "detected", "lost", "late", "stale", "error_km", "missed", "swaps", "gospa_km")


@about_run()
def timeline(_: Request, question: Question) -> Response:
    """What a run came to, piece by piece."""
    name, store, headers = question.run, question.store, question.headers
    known = facts(store, name)
    n = known.newest - known.oldest + 1
    width = -(-(n + 1) // MAX_BUCKETS)  # t / width: a bucket more
    if not known.radar.is_unknown and n * known.row["n_target"] > MAX_ROWS:
        width = sums.DWELLS * max(MIN_BLOCKS, -(-width // sums.DWELLS))
    rows = (queries.picture_timeline if known.radar.is_unknown else queries.timeline)(store, name, width)
    return columns({"run": name, "t": known.newest, "oldest_t": known.oldest, "width": width}, NAMES, rows, headers)
