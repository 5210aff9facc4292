"""Campaigns: scenarios played by several strategies over many seeds, on a pool of workers, into one store.

A run is a function of (scenario, strategy, seed), so it does not matter where or when it is made: an interrupted
campaign goes on with the runs that are missing. Seeds are the same for all scenarios and strategies, and random numbers
are keyed by the seed: strategies meet the same targets in the same disturbance (common random numbers).

Kept of each run: its row, with the digest over all its messages; its scores; and the waveforms of three dwells
(`snapshots`), for the beampatterns. All its messages would take about 3 MB; they come back with `cogradar run`.
Workers hand over finished runs; only this process writes to the store, a run per transaction.
"""

import hashlib
import json
import math
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, wait
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from typing import Any

from cogradar.services.campaigns.pool import Pool, interrupts_ignored, play_one
from cogradar.services.errors import BadInput, RunFailed, check_stop
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import Recording
from cogradar.services.runs.run import ending, loaded, strategy_of
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.trajectories.rows import Rows
from cogradar.shared.wire.codec import renamed

POLL_S = 0.2  # how soon a stop is noticed
MAX_BROKEN = 3  # times that workers may die; then it is not chance


@dataclass(frozen=True)
class Campaign:
    """Which runs there are to be."""

    scenarios: tuple[Scenario, ...]  # more than one: a sweep
    strategies: tuple[Strategy, ...]
    runs: int  # per scenario and strategy
    first_seed: int
    dwells: int | None  # None: of each scenario its own number

    def starts(self) -> list[RunStart]:
        """The runs in their order: seed by seed, so that an unfinished campaign has complete pairs. Raises BadInput."""
        return [
            ending(RunStart.of(scenario, strategy, seed, self.dwells))
            for seed in range(self.first_seed, self.first_seed + self.runs)
            for scenario in self.scenarios
            for strategy in self.strategies
        ]

    def document(self) -> dict[str, Any]:
        """What makes two campaigns the same, down to the program that plays them."""
        return {
            "scenarios": [scenario.model_dump(mode="json") for scenario in self.scenarios],
            "strategies": [strategy.value for strategy in self.strategies],
            "runs": self.runs,
            "first_seed": self.first_seed,
            "dwells": self.dwells,
            "program": build(),
        }


@dataclass
class Tally:
    """How far a campaign has come."""

    total: int
    done: int
    played: int = 0  # by this call
    wall_s: float = 0.0
    cpu_s: dict[str, list[float]] = field(default_factory=dict)  # per strategy, of each run played by this call


def parse_strategies(text: str) -> tuple[Strategy, ...]:
    """Strategies of a comma-separated list. Raises BadInput."""
    found = tuple(map(strategy_of, text.split(",")))
    if len(set(found)) < len(found):
        raise BadInput(f"strategies = {text!r}: must be each once")
    return found


def open_store(path: str, campaign: Campaign, *, resume: bool) -> Store:
    """Store of a campaign: a new one, or one to go on with. Raises BadInput, StoreFailed."""
    with ExitStack() as opened:
        journal = opened.enter_context(closing(Journal(path, owner="cogradar campaign")))
        if (fault := _fault(journal, campaign, resume=resume)) is not None:
            raise BadInput(f"{journal.path}: holds {fault}")
        store = Store(journal)
        opened.pop_all()
    return store


def _fault(journal: Journal, campaign: Campaign, *, resume: bool) -> str | None:
    """What a store holds, and what to do, if a campaign cannot go there; else it is a store of this campaign."""
    asked, there = campaign.document(), journal.campaign()
    (done,) = journal.read("SELECT COUNT(*) AS n FROM run")
    if there is None and done["n"]:
        return "runs that belong to no campaign; name another store"
    if there is None:
        journal.set_campaign(asked)
    elif (differs := _difference(there, asked)) is not None:
        return f"another campaign: {differs}; name another store or remove this one"
    elif not resume:
        n, cure = len(campaign.starts()), "go on"
        if done["n"] == n:
            cure = "see its tables again"
        return f"{done['n']} of the {n} runs of this campaign; add --resume to {cure}"
    return None


def play(
    campaign: Campaign,
    store: Store,
    pool: Pool,
    *,
    report: Callable[[Tally], None] = lambda _: None,
    notify: Callable[[str], None] = lambda _: None,
    stop: threading.Event,
) -> Tally:
    """Play the runs that the store does not have yet.

    Raises Interrupted when `stop` is set, RunFailed if workers keep dying, StoreFailed, BadInput if something of a
    user's own cannot be loaded; the store is good in any case.
    """
    starts = campaign.starts()
    for start in starts[: len(campaign.scenarios) * len(campaign.strategies)]:
        loaded(start)
    tally, began, broken = Tally(len(starts), _n_done(store)), time.monotonic(), 0
    report(tally)
    while missing := missing_runs(starts, store):
        try:
            with pool.open(len(missing)) as executor:
                for place, recording, cpu_s in _play_on(executor, missing, stop):
                    store.journal.add_recording(recording, place)
                    tally.done, tally.played, tally.wall_s = _n_done(store), tally.played + 1, time.monotonic() - began
                    tally.cpu_s.setdefault(recording.run["strategy"], []).append(cpu_s)
                    report(tally)
        except BrokenExecutor:
            broken += 1
            if broken > MAX_BROKEN:
                raise RunFailed(f"worker processes died {broken} times (out of memory?); go on with --resume") from None
            notify("a worker process died; its run is made again")
    return tally


def _play_on(
    executor: Executor, missing: list[tuple[int, RunStart]], stop: threading.Event
) -> Iterator[tuple[int, Recording, float]]:
    """Finished runs as they come: place, recording, CPU seconds."""
    with interrupts_ignored():
        places = {executor.submit(play_one, start, build()): place for place, start in missing}
    waiting = set(places)
    while waiting:
        done, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
        check_stop(stop, "; go on with --resume")
        for future in done:
            yield places[future], *future.result()


def results_digest(store: Store, runs: Sequence[str] | None = None) -> str:
    """SHA-256 over all results of a store, or of these runs, bit for bit, without their ids; equal on all machines."""
    total = hashlib.sha256()
    for run in store.read(
        "SELECT run, strategy, seed, status, reason, acquisition_scans, digest FROM run"
        " ORDER BY document, strategy, seed, run"
    ):
        if runs is not None and run["run"] not in runs:
            continue
        name = run.pop("run")
        total.update(json.dumps(run, sort_keys=True).encode())
        for score in store.all_scores(name):
            # Counted from 0, as the messages do.
            track = None if score["track"] is None else score["track"] - 1
            total.update(score.pop("cells").encode())
            numbers = score | {"target": score["target"] - 1, "track": track}
            values = [math.nan if value is None else value for value in list(numbers.values())[1:]]
            total.update(struct.pack(f"<{len(values)}d", *values))
        for message in store.stored("message", "WHERE run = ? ORDER BY topic, k, item", [name]):
            total.update(renamed(message["payload"], name, "-"))
    return total.hexdigest()


def conflicts(store: Store) -> int:
    """Messages that differed from those that other processes sent for the same dwell, over all runs."""
    return sum(run["conflicts"] for run in store.read("SELECT conflicts FROM run"))


def _n_done(store: Store) -> int:
    return int(store.read("SELECT COUNT(*) AS n FROM run")[0]["n"])


def missing_runs(starts: list[RunStart], store: Store) -> list[tuple[int, RunStart]]:
    """Runs that the store does not have, with their place among all of them, from 1."""
    rows = store.read("SELECT document, strategy, seed FROM run")
    there = {(row["document"], row["strategy"], row["seed"]) for row in rows}
    # The document as a journal has it.
    asked = [
        (json.dumps(start.scenario, sort_keys=True, default=Rows.tolist), start.strategy, start.seed)
        for start in starts
    ]
    return [(place, start) for place, start in enumerate(starts, 1) if asked[place - 1] not in there]


def _difference(there: dict[str, Any], asked: dict[str, Any]) -> str | None:
    """The first thing in which two campaigns differ, for the user."""
    for name in ("runs", "first_seed", "strategies", "dwells"):
        if there[name] != asked[name]:
            return f"{name} = {_text(there[name])} there, {_text(asked[name])} asked for"
    if there["scenarios"] != asked["scenarios"]:
        return f"its scenario, {there['scenarios'][0]['name']}, is not the one asked for"
    return None if there["program"] == asked["program"] else "another version of the program made it"


def _text(value: Any) -> str:
    return ",".join(value) if isinstance(value, list) else str(value)
