"""One run as it was recorded, read through questions to metrics: the same from a store file and over Zenoh."""

import base64
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import Rows
from cogradar.services.planner.track_source import follow, source_of
from cogradar.services.runs.dwell import DwellMessages
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.orders import Order
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.scan_rows import radiated_k
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.wire.codec import decode

Ask = Callable[[str, dict[str, str]], Rows]  # (metric, parameters) -> rows, as metrics answers them
Kind = TypeVar("Kind")
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

    def dwells(self) -> Iterator[DwellMessages]:
        """All messages about each dwell that has a scan, one dwell at a time. Raises BadInput if no scan is stored."""
        made, is_stored = dict[int, Waveform](), False
        for k, payloads in self.messages("scan", "truth", "plan", "waveform"):
            messages = [decode(payload) for payload in payloads]
            scan, truth, waveform = _only(Scan, messages), _only(Truth, messages), _only(Waveform, messages)
            if scan is not None:
                sent_k = radiated_k(k, vars(scan), None if truth is None else vars(truth))
                made = {at: one for at, one in made.items() if at >= sent_k}  # no older one is radiated again
                plans = [message for message in messages if isinstance(message, Plan)]
                is_stored = True
                yield DwellMessages(k, scan, made.get(sent_k), truth, plans, waveform)
            if waveform is not None:
                made[k] = waveform
        if not is_stored:
            raise BadInput(f"{self.name}: no scan is stored yet, or none ever, as in the store of a campaign")

    def orders(self) -> list[Order]:
        """All commands that were granted, in the order of their numbers."""
        return [Order.model_validate(row) for row in self._ask("orders", {"run": self.name})]

    def states(self, tracks: Sequence[int] | None = None, last_k: int | None = None) -> Iterator[dict[int, TrackState]]:
        """What these tracks, counted from 0, were after each dwell up to `last_k`, as far as they are there; None: all.

        A track is a function of the scans: it is worked out anew, at the cost of the planner's updates without its
        searches. In real time a planner that missed a scan may have had another belief.
        """
        radar, start = self.scenario.radar, self.start
        model = TrackerModel.of(radar, start.strategy, radar_seed(start.seed))
        source = source_of(self.name, radar, model, pacing_at(start.rate_hz))
        scans = itertools.takewhile(lambda scan: last_k is None or scan.k <= last_k, self._scans())
        return follow(source, model, scans, tracks)

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


def _only(kind: type[Kind], messages: Sequence[Any]) -> Kind | None:
    return next((message for message in messages if isinstance(message, kind)), None)
