"""What a run is asked to be and what it comes to, however its processes are started."""

import math
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.errors import BadInput, Interrupted, RunFailed
from cogradar.services.topology import Start
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.limits import NO_END, UNLIMITED
from cogradar.shared.scenario.plugins.kinds import STRATEGY
from cogradar.shared.scenario.plugins.names import PluginError
from cogradar.shared.scenario.plugins.resolver import load_for, named
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import TRUE_RULES
from cogradar.shared.wire.queries import NoAnswer

Rows = list[dict[str, Any]]
Ask = Callable[[str, dict[str, str]], Rows]  # (metric, parameters) -> rows, as metrics answers them


@dataclass(frozen=True)
class Progress:
    """How far a run has come."""

    t: int  # tracking dwells done
    dwells: int
    k: int | None  # newest scan
    waiting_for: str
    targets: Rows
    complete: bool = False
    confirmed: int | None = None  # tracks, if their number is unknown
    hindered: str = ""  # which processes cannot do their part, and why
    fault: str = ""  # why nothing was measured in the newest dwell


class RunStopped(RunFailed):
    """A run that was ended before its time; with what it came to until then, if anything was scored."""

    def __init__(self, reason: str, result: "Result | None" = None) -> None:
        super().__init__(reason)
        self.result = result


class RunInterrupted(Interrupted):
    """A run that the user has ended, with what it came to until then."""

    def __init__(self, text: str, result: "Result") -> None:
        super().__init__(text)
        self.result = result


@dataclass(frozen=True)
class Result:
    """A run that is over: its row of `runs`, its targets overall, and per window of dwells if it is longer than one."""

    run: dict[str, Any]
    targets: Rows
    windows: list[Rows]
    picture: dict[str, Any]  # row of `picture`; empty if no dwell was scored
    elapsed_s: float

    def as_json(self) -> dict[str, Any]:
        """The object that `cogradar run --json` prints."""
        from cogradar.services.metrics.answers import LIFE  # and with it the store, which most processes have not

        keys: tuple[str, ...] = ("run", "scenario", "strategy", "seed", "dwells", "acquisition_scans", "digest")
        columns = ["target", *LIFE, "p_d", "p_d_low", "p_d_high", "hit_rate", "in_bin"]
        columns += ["outage", "outage_longest", "position_rmse_km", "velocity_rmse_km_s", "lost"]
        if pacing_at(self.run["rate_hz"]).has_deadlines:
            keys += ("rate_hz",)
            columns += ["n", "late", "stale"]
        targets = [{column: row[column] for column in columns} for row in self.targets]
        found = {"elapsed_s": round(self.elapsed_s, 3), "false_tracks": self.false_tracks}
        of_picture = {key: self.picture.get(key) for key in (*PICTURE, "unmeasured_fault")}
        return {key: self.run[key] for key in keys} | found | of_picture | {"targets": targets}

    @property
    def false_tracks(self) -> int | None:
        """Tracks that began near no target, and so the number of targets that are not tracked.

        Of an unknown number: those that never became a target's; None without truth.
        """
        of_picture: int | None = self.picture.get("false_tracks")
        return of_picture if self.is_unknown else sum(row["false_track"] for row in self.targets)

    @property
    def is_unknown(self) -> bool:
        """Whether the radar was not told how many targets there are."""
        return self.run["tracks"] is None

    @property
    def has_truth(self) -> bool:
        """Whether errors are known: of targets, or of a sky in which there was none."""
        return self.picture.get("gospa_km") is not None or any(row["p_d"] is not None for row in self.targets)


WINDOW, ROWS = 50, 6  # dwells in a row of the table; rows at most: a long run has longer ones
# Columns of it.
BLIND = ("blind_cells", "blind_dwells", "blind_share", "unmeasured_looks", "unmeasured_dwells")
PICTURE = ("gospa_km", "completeness", "spuriousness", "swaps", "false_tracks_per_hour", "tracks", *BLIND)


def as_played(scenario: Scenario, front_end: str) -> Scenario:
    """The scenario as a front end plays it: only the simulated one has a world. Raises BadInput if that is missing."""
    if front_end != Start.front_end:
        return scenario.model_copy(update={"world": None})
    if scenario.world is None:
        raise BadInput(
            f"{scenario.name} has no [world] to simulate: add one, or use `run --front-end` with a recording or with a"
            " receiver of your own"
        )
    return scenario


def ending(start: RunStart) -> RunStart:
    """The run, if it ends by itself. Raises BadInput."""
    if start.dwells == NO_END:
        raise BadInput(
            f"dwells = {UNLIMITED}: a run in one process, of a campaign or a sweep must end: set a number of dwells,"
            " or let services run it, with `run` without --in-process"
        )
    return start


def strategy_of(thing: Any) -> Strategy:
    """The strategy of this name, or a user's own one, with the hash of its source. Raises BadInput."""
    try:
        return Strategy(named(STRATEGY, thing, Path()))
    except PluginError as error:
        raise BadInput(f"strategy = {thing!r}: {error}") from None


def loaded(start: RunStart) -> RunStart:
    """The run, if all of a user's own things in it can be loaded in this process. Raises BadInput."""
    try:
        load_for("", start.scenario["radar"], start.strategy, start.scenario["world"])
    except PluginError as error:
        raise BadInput(str(error)) from None
    return start


def untold(scenario: Scenario) -> Scenario:
    """The scenario, if processes can play it that are not told the truth. Raises BadInput."""
    rule = scenario.radar.planner.rule
    if rule in TRUE_RULES:
        raise BadInput(
            f"radar.planner.rule = {rule}: knows the truth, which no message may tell a planner: run it in one"
            " process, with `run --in-process`, `campaign` or `sweep`"
        )
    return scenario


def progress(ask: Ask, start: RunStart, before: Progress | None = None) -> Progress | None:
    """Progress of a run, None before metrics knows it. Raises RunFailed if the run ended badly, RunStopped if early.

    before : as it was when it was asked last: the targets are asked for only if there are more dwells to sum
    """
    rows = ask("runs", {"run": start.run})
    if not rows:
        return None
    if rows[0]["status"] == "stopped":
        raise RunStopped(f"stopped {rows[0]['reason']}")
    if rows[0]["status"] in {"failed", "quarantined"}:
        raise RunFailed(rows[0]["reason"])
    row, targets = rows[0], before.targets if before is not None else []
    if before is None or before.t != row["t"]:
        with suppress(NoAnswer):  # a metrics that came back sums all dwells first; meanwhile the run goes on
            targets = ask("summary", {"run": start.run})
    return Progress(
        row["t"],
        start.dwells,
        row["k"],
        row["waiting_for"],
        targets,
        row["status"] == "complete",
        row["confirmed"],
        row["reason"] if row["status"] == "running" else "",
        row["fault"] or "",
    )


def window(dwells: int, rows: int = ROWS) -> int:
    """Dwells in each row of a table of a run with so many dwells, which has this many rows at most."""
    return WINDOW * math.ceil(dwells / (WINDOW * rows))


def result(ask: Ask, start: RunStart, began: float) -> Result | None:
    """Result of a run once it is complete, else None; `began` is a reading of time.monotonic()."""
    return _result(ask, start, began, "complete")


def so_far(ask: Ask, start: RunStart, began: float) -> Result | None:
    """Result of a run that was stopped, up to its last dwell; None if it has none."""
    found = _result(ask, start, began, "stopped")
    return found if found is not None and found.run["t"] else None


def _result(ask: Ask, start: RunStart, began: float, status: str) -> Result | None:
    rows = ask("runs", {"run": start.run})
    if not rows or rows[0]["status"] != status:
        return None
    width, last = window(start.dwells), rows[0]["t"]  # fewer dwells, if it was ended before
    firsts = range(1, last + 1, width) if width < start.dwells < NO_END else ()
    spans = (f"{first}:{min(first + width - 1, last)}" for first in firsts)
    asked = (ask("summary", {"run": start.run, "dwells": span}) for span in spans)
    windows = [found for found in asked if found]  # in real time all dwells of a window may be lost
    picture = next(iter(ask("picture", {"run": start.run})), {})
    return Result(rows[0], ask("summary", {"run": start.run}), windows, picture, time.monotonic() - began)


def program() -> str:
    """How this program is called, for a hint that can be pasted: its script need not be on the PATH."""
    return sys.argv[0] if Path(sys.argv[0]).name == "cogradar" else f"{sys.executable} -m cogradar"
