"""Campaigns over services that are up: many runs at once share the planners behind a router.

A run is a function of its scenario, strategy and seed, so its results equal those of a run on this machine bit for bit.
"""

import json
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from services.campaigns.campaign import Campaign, Tally, missing_runs
from services.errors import CANCELLED, INTERRUPTED, RunFailed, check_stop
from services.metrics.answers import Rows
from services.metrics.recording import unpack
from services.metrics.store import Store
from services.recorder.journal import Recording
from services.runs.cancel import cancelled_unless_over
from services.runs.cluster import ALIVE_WITHIN_S, ANSWER_WITHIN_S, CONNECT_WITHIN_S, STALL_S, wait_until_alive
from shared.protocol.messages import RunStart
from shared.protocol.topics import Role
from shared.wire.queries import NoAnswer, ask
from shared.wire.session import open_session
from shared.wire.zenoh_bus import ZenohBus

POLL_S = 0.1
RUNS_PER_PLANNER = 2  # at once: while one run waits for its emulator or allocator, another one plans
GONE = {  # a run that failed for one of these reasons is no result
    INTERRUPTED: "metrics was started anew meanwhile",
    CANCELLED: "somebody cancelled it",
}


@dataclass
class _Playing:
    """A run that the services play."""

    place: int
    start: RunStart
    k: int | None = None  # its newest dwell
    since: float = 0.0  # when that came


def play(
    campaign: Campaign,
    store: Store,
    endpoint: str,
    at_once: int | None,
    *,
    report: Callable[[Tally], None] = lambda _: None,
    notify: Callable[[str], None] = lambda _: None,
    stop: threading.Event,
) -> Tally:
    """Play the runs that the store does not have yet, `at_once` at a time (two per planner if left out).

    Raises RunFailed if a role is missing or nothing moves, Interrupted when `stop` is set; the store is good in any
    case, and the runs on their way are cancelled.
    """
    check = partial(check_stop, stop, "; go on with --resume")
    session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check)
    bus = ZenohBus(session, Role.OPERATOR, f"operator-{uuid.uuid4().hex[:8]}", reads=False)

    def query(metric: str, run: str) -> Rows:
        rows: Rows = json.loads(ask(session, metric, {"run": run}, ANSWER_WITHIN_S, check))
        return rows

    try:
        wait_until_alive(bus.alive, (), check, notify, ALIVE_WITHIN_S)
        window = at_once or RUNS_PER_PLANNER * max(1, len(bus.alive().get(Role.PLANNER, [])))
        connected = _Connected(campaign, store, bus, query)
        with cancelled_unless_over(session, bus, connected.going_on):
            return connected.play(window, report, notify, check)
    finally:
        bus.close()


class _Connected:
    """A campaign on its way."""

    def __init__(self, campaign: Campaign, store: Store, bus: ZenohBus, query: Callable[[str, str], Rows]) -> None:
        self._store, self._bus, self._query = store, bus, query
        starts = campaign.starts()
        self._waiting = missing_runs(starts, store)[::-1]
        self._playing: list[_Playing] = []
        self._tally = Tally(len(starts), len(starts) - len(self._waiting))

    def play(
        self, window: int, report: Callable[[Tally], None], notify: Callable[[str], None], check: Callable[[], None]
    ) -> Tally:
        """Keep `window` runs going until none is left."""
        began = time.monotonic()
        report(self._tally)
        while self._waiting or self._playing:
            while self._waiting and len(self._playing) < window:
                self._begin()
            check()
            for playing in list(self._playing):
                if (recording := self._ended(playing)) is None:
                    continue
                if recording.run["status"] == "failed":
                    notify(f"{playing.start.run} failed: {recording.run['reason']}")
                self._store.journal.add_recording(recording, playing.place)
                self._playing.remove(playing)
                self._tally.done, self._tally.played = self._tally.done + 1, self._tally.played + 1
                self._tally.wall_s = time.monotonic() - began
                report(self._tally)
            time.sleep(POLL_S)
        return self._tally

    def going_on(self) -> list[str]:
        """Names of the runs that the services play for us."""
        return [playing.start.run for playing in self._playing]

    def _begin(self) -> None:
        place, start = self._waiting.pop()
        self._playing.append(_Playing(place, start, since=time.monotonic()))
        self._bus.publish(start)

    def _ended(self, playing: _Playing) -> Recording | None:
        """The recording of a run that has ended, None while it goes on. Raises RunFailed if it stands still."""
        try:
            rows = self._query("runs", playing.start.run)
            if not rows:  # the start was lost, or is on its way
                self._bus.publish(playing.start)
            status, k = (rows[0]["status"], rows[0]["k"]) if rows else ("unknown", None)
            if status in {"complete", "failed"}:
                if rows[0]["reason"] in GONE:
                    raise RunFailed(f"{playing.start.run}: {GONE[rows[0]['reason']]}; go on with --resume")
                (document,) = self._query("recording", playing.start.run)
                return unpack(document)
        except NoAnswer:
            k = playing.k
        if k != playing.k:
            playing.k, playing.since = k, time.monotonic()
        elif time.monotonic() - playing.since > STALL_S:
            raise RunFailed(f"{playing.start.run}: no progress for {STALL_S:.0f} s; go on with --resume")
        return None
