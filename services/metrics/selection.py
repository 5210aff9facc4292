"""Which runs, targets and dwells a question is about: its parameters, checked, and the runs that they select."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Self

from cogradar.services.errors import BadInput, Damaged, NoSuchRun
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.store.tables import ALL_ROWS
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.plugins.names import N_HASH, may_be_own, names_of
from cogradar.shared.scenario.radar_config import Strategy

ALL = "all"  # as the name of a run: every run once
PARAMETERS = ("run", "scenario", "strategy", "seed", "target", "dwells", "limit", "offset")
MAX_NUMBER = 2**63 - 1
LISTING = "`cogradar query runs` lists those that are there"
GUESSES = 1000  # runs among which one of a similar name is looked for
Run = dict[str, Any]  # a row of the table `run`, without its document

# The oldest dwell that is kept of a run without an end; of others the first.
OLDEST_T = (
    "CASE WHEN kept_k > COALESCE(acquisition_scans, 0) THEN kept_k - COALESCE(acquisition_scans, 0) + 1 ELSE 1 END"
)
_RUN = (
    "SELECT run, scenario, strategy, seed, dwells, rate_hz, n_target, n_track, has_truth, status, reason, conflicts,"
    " digest, acquisition_scans, acknowledged_k AS k, acknowledged_t AS t,"
    f" kept_k, {OLDEST_T} AS oldest_t"
)
# Of runs that were asked to be the same, the newest complete one is the first, else the newest.
_RANKS = (
    ", DENSE_RANK() OVER (ORDER BY document, dwells) AS experiment, ROW_NUMBER() OVER"
    " (PARTITION BY document, strategy, seed, dwells ORDER BY status = 'complete' DESC, place DESC) AS repetition"
)


@dataclass(frozen=True)
class Selection:
    """What a question is about; None: anything."""

    run: str | None = None  # None: the newest that has begun to track, or any begun if there is none
    scenario: str | None = None
    strategy: str | None = None
    seed: int | None = None
    target: int | None = None
    first: int | None = None  # dwell
    last: int | None = None
    limit: int | None = None  # rows
    offset: int = 0

    @classmethod
    def of(cls, parameters: Mapping[str, str]) -> Self:
        """From the parameters of a query. Raises BadInput."""
        for name in parameters:
            if name not in PARAMETERS:
                raise BadInput(f"{name}: unknown parameter, must be one of {', '.join(PARAMETERS)}")
        strategy = parameters.get("strategy")
        if strategy is not None and strategy not in set(Strategy) and not may_be_own(strategy):
            raise BadInput(f"strategy = {strategy!r}: must be one of {names_of(list(Strategy))}")
        first, last = dwells_of(parameters["dwells"]) if "dwells" in parameters else (None, None)
        return cls(
            parameters.get("run"),
            parameters.get("scenario"),
            strategy,
            number(parameters, "seed", 0),
            number(parameters, "target", 1),
            first,
            last,
            number(parameters, "limit", 1),
            number(parameters, "offset", 0) or 0,
        )

    @property
    def filters(self) -> dict[str, str | int]:
        """What a run must be."""
        run = None if self.run == ALL else self.run
        found = {"run": run, "scenario": self.scenario, "strategy": self.strategy, "seed": self.seed}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def of_runs(self) -> tuple[str, list[str | int]]:
        """SQL condition on the rows of `run`, and its values."""
        terms, values = ["TRUE"], list[str | int]()
        for name, value in self.filters.items():
            if name == "strategy" and isinstance(value, str):  # also without its hash
                terms.append("(strategy = ? OR (length(strategy) = ? AND substr(strategy, 1, CAST(? AS INTEGER)) = ?))")
                values += [value, len(value) + N_HASH + 1, len(value), value]
            else:
                terms.append(f"{name} = ?")
                values.append(value)
        return " AND ".join(terms), values

    @property
    def of_scores(self) -> tuple[str, list[int]]:
        """SQL condition on the rows of `score`, and its values."""
        terms, values = ["TRUE"], list[int]()
        for term, value in (("target = ?", self.target), ("t >= ?", self.first), ("t <= ?", self.last)):
            if value is not None:
                terms.append(term)
                values.append(value)
        return " AND ".join(terms), values

    @property
    def most(self) -> int:
        """Rows that are asked for, at most."""
        return ALL_ROWS if self.limit is None else self.limit

    def page(self, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows that are asked for."""
        return rows[self.offset : None if self.limit is None else self.offset + self.limit]


def refuse(error: Damaged) -> None:
    """Of a damaged run: raise what is said of it."""
    raise error


def distinct(store: Store, selection: Selection, left_out: Callable[[Damaged], None] = refuse) -> list[Run]:
    """The runs that a selection allows, in the order in which they began; of equal ones the newest complete one.

    Equal are runs of one scenario document, strategy, seed and number of dwells: to pool them would count the same
    random numbers twice. Runs of one scenario document and number of dwells have one number as their `experiment`.

    left_out : gets what is damaged of each run that is left out; a row that is damaged may be one that was asked for
    """
    condition, values = selection.of_runs
    there = store.read(f"SELECT run, {condition} AS is_chosen FROM run ORDER BY place", values)
    damaged = store.damaged_rows(row["run"] for row in there if row["is_chosen"] or "run" not in selection.filters)
    damaged |= store.damaged_scores(row["run"] for row in there if row["is_chosen"])
    for error in damaged.values():
        left_out(error)
    if damaged:
        condition, values = f"{condition} AND run NOT IN ({','.join('?' * len(damaged))})", [*values, *damaged]
    runs = store.read(f"{_RUN}{_RANKS} FROM run WHERE {condition} ORDER BY place", values)
    return [run for run in runs if run["repetition"] == 1]


def selected(store: Store, selection: Selection) -> list[Run]:
    """The runs that are asked about: one, the newest, or with `all` every one (`distinct`).

    Raises BadInput if there is none, or if none has such a target or such dwells.
    """
    if selection.run == ALL:
        runs = distinct(store, selection)
    else:
        condition, values = selection.of_runs
        newest = f"WHERE {condition} ORDER BY acknowledged_t > 0 DESC, place DESC LIMIT 1"
        runs = store.read(f"{_RUN}, 0 AS experiment FROM run {newest}", values)
        store.check_rows([run["run"] for run in runs])
    if runs:
        _check(selection, runs)
    elif set(selection.filters) == {"run"}:
        raise NoSuchRun(f"run = {selection.run!r}: no such run{_meant(store, 'run', selection.run) or f'; {LISTING}'}")
    elif selection.filters:
        chosen = ", ".join(f"{name} = {value}" for name, value in selection.filters.items())
        raise NoSuchRun(f"no run with {chosen}{_meant(store, 'scenario', selection.scenario)}")
    return runs


def whole(metric: str, selection: Selection) -> None:
    """Refuse a target and dwells where a question is about whole runs. Raises BadInput."""
    if selection.target is not None or selection.first is not None or selection.last is not None:
        raise BadInput(f"`{metric}` is about whole runs: it takes no target and no dwells")


def _meant(store: Store, column: str, text: str | None) -> str:
    """The name of a run or a scenario, among the newest, that was probably meant."""
    newest = store.read(f"SELECT {column} AS name FROM run GROUP BY 1 ORDER BY MAX(place) DESC LIMIT {GUESSES}")
    close = get_close_matches(text, [row["name"] for row in newest], n=1) if text is not None else []
    return f" (did you mean {close[0]}?)" if close and close[0] != text else ""


def _check(selection: Selection, runs: list[Run]) -> None:
    """Refuse a target, or a dwell, that no run can have."""
    who = f"run {runs[0]['run']} has" if len(runs) == 1 else "these runs have at most"
    targets = max(run["n_target"] for run in runs)
    if selection.target is not None and selection.target > targets:
        raise BadInput(f"target = {selection.target}: {who} {targets} targets")
    dwells = max(_last_dwell(run) for run in runs)
    for dwell in (selection.first, selection.last):
        if dwell is not None and not 1 <= dwell <= dwells:
            raise BadInput(f"dwells = {dwell}: {who} {f'dwells 1 to {dwells}' if dwells else 'no dwell'}")
    oldest = min(run["oldest_t"] for run in runs)
    if selection.last is not None and selection.last < oldest:
        raise BadInput(f"dwells up to {selection.last}: {who} dwells {oldest} to {dwells}; the ones before were cut")


def _last_dwell(run: Run) -> int:
    """The last dwell that a run can have been asked about: one that goes on will come to the dwells it has not."""
    is_known = run["status"] in {"running", "complete"} and run["dwells"] != NO_END
    return int(run["dwells"] if is_known else run["t"])


def number(parameters: Mapping[str, str], name: str, least: int) -> int | None:
    """A number among the parameters, None if it is not there. Raises BadInput."""
    text = parameters.get(name)
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and len(text) <= 19 and least <= int(text) <= MAX_NUMBER):
        raise BadInput(f"{name} = {text!r}: must be a number from {least}")
    return int(text)


def dwells_of(text: str) -> tuple[int | None, int | None]:
    """First and last dwell of a range a:b, None where it is open. Raises BadInput."""
    first, colon, last = text.partition(":")
    ends = {name: part for name, part in (("first", first), ("last", last)) if part}
    if not colon or not all(part.isascii() and part.isdecimal() and len(part) <= 9 for part in ends.values()):
        raise BadInput(f"dwells = {text!r}: must be a:b, first and last dwell, either may be empty")
    numbers = {name: int(part) for name, part in ends.items()}
    if len(numbers) == 2 and numbers["first"] > numbers["last"]:
        raise BadInput(f"dwells = {text!r}: the first must not be after the last")
    return numbers.get("first"), numbers.get("last")
