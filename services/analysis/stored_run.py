"""One run as it was recorded, read through questions to metrics: the same from a store file and over Zenoh."""

import base64
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import Rows
from cogradar.services.planner.owned_track import born_of, detections_of
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import RunStart, Scan
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import coast, follow, observe
from cogradar.shared.wire.codec import decode

Ask = Callable[[str, dict[str, str]], Rows]  # (metric, parameters) -> rows, as metrics answers them
PAGE = 10_000  # rows of scores that are asked for at a time, about 4 MB


class StoredRun:
    """A run's row, its scores, its messages, and the beliefs that follow from its scans."""

    def __init__(self, ask: Ask, run: str | None = None) -> None:
        """`run` is its name; None: the newest. Raises BadInput if there is none."""
        (row,) = ask("one_run", {} if run is None else {"run": run})
        self._ask, self.row = ask, row
        self.name: str = row["run"]
        self.scenario = Scenario.model_validate(row["document"])
        keys = ("run", "strategy", "seed", "dwells", "rate_hz")
        self.start = RunStart.model_validate({"scenario": row["document"], **{key: row[key] for key in keys}})

    def scores(self) -> Rows:
        """Rows of `tracks`, in the order of dwell and target."""
        return self._paged("tracks")

    def pictures(self) -> Rows:
        """Rows of the table `picture`, in the order of dwells."""
        return self._paged("pictures")

    def figures(self) -> dict[str, Any]:
        """The row of `picture`; empty before the first dwell."""
        return next(iter(self._ask("picture", {"run": self.name})), {})

    def _paged(self, metric: str) -> Rows:
        rows = Rows()
        while True:
            page = self._ask(metric, {"run": self.name, "limit": str(PAGE), "offset": str(len(rows))})
            rows += page
            if len(page) < PAGE:
                return rows

    def messages(self, *topics: str) -> Iterator[tuple[int, list[bytes]]]:
        """Dwells k with their messages of these topics, encoded, in the order of topic and track."""
        k = 0
        while page := self._ask("messages", {"run": self.name, "topics": ",".join(topics), "k": str(k)}):
            for row in page:
                yield row["k"], [base64.b64decode(payload) for payload in row["payloads"]]
            k = page[-1]["k"] + 1

    def states(self, tracks: Sequence[int] | None = None, last_k: int | None = None) -> Iterator[dict[int, TrackState]]:
        """What these tracks, counted from 0, were after each dwell, from the one that confirmed the last target on.

        Of an unknown number: what those of them were that are there, from the first dwell to `last_k`.

        A track is a function of the scans: it is worked out anew, at the cost of the planner's updates without its
        searches. In real time a planner that missed a scan may have had another belief.
        """
        radar = self.scenario.radar
        model = TrackerModel.of(radar, self.start.strategy, radar_seed(self.start.seed))
        if radar.is_unknown:
            yield from self._alive(model, tracks, last_k)
            return
        chosen = range(radar.announced) if tracks is None else tracks
        yield from follow(model, (detections_of(model, scan) for scan in self._scans()), chosen)

    def _alive(
        self, model: TrackerModel, tracks: Sequence[int] | None, last_k: int | None
    ) -> Iterator[dict[int, TrackState]]:
        states: dict[int, TrackState] = {}
        for scan in self._scans():
            if last_k is not None and scan.k > last_k:
                return
            ids = [] if scan.roster is None else scan.roster.ids.tolist()
            begun = {m: state for m in ids if m not in states and (state := born_of(model, scan, m)) is not None}
            states = {
                m: observe(model, coast(model, state, scan.k), detections_of(model, scan))
                for m, state in sorted((states | begun).items())
                if m in ids and (tracks is None or m in tracks)
            }
            yield states

    def _scans(self) -> Iterator[Scan]:
        is_stored = False
        for _, (payload,) in self.messages("scan"):
            message = decode(payload)
            if not isinstance(message, Scan):
                raise BadInput(f"{self.name}: a {type(message).__name__} is stored among the scans")
            is_stored = True
            yield message
        if not is_stored:
            raise BadInput(f"{self.name}: no scan is stored, as in the store of a campaign")
