"""Rules of looking compared: which runs there are to be, and what each rule came to beside the search.

All rules meet the same seeds, hence the same targets in the same disturbance.
"""

import hashlib
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, model_validator

from services.errors import BadInput
from shared.numerics.seeds import Purpose, generator
from shared.protocol.messages import RunStart
from shared.scenario.files import load
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario
from shared.scenario.tables import RULES, marked
from shared.scoring.errors import bootstrap_interval

SEARCH = "pomcp"  # what the other rules are compared with
SNRS_DB = (0.0, -3.0, -6.0)  # of world and radar alike, relative to the scenario's
FIDELITIES = ("paper", "robust")  # those with single looks, which a rule decides on
SIGMAS_KM_S2 = (0.004, 0.03)  # how unsteadily the targets fly, and are expected to
SHOWN = 2  # the target whose detections are compared: the weakest of the paper's
STRATEGY = Strategy.POWER_AWARE

Floats = NDArray[np.float64]
Row = dict[str, Any]  # of a table
Rows = list[Row]


class Setting(NamedTuple):
    """Where rules are compared."""

    snr_db: float
    fidelity: str
    sigma_s: float


SETTINGS = [Setting(*values) for values in product(SNRS_DB, FIDELITIES, SIGMAS_KM_S2)]


class Asked(NamedTuple):
    """One of the runs that there are to be."""

    setting: Setting
    rule: str
    seed: int


class Decisions(BaseModel):
    """The decisions of a run, looked into one by one: how many the bounds leave open, and what each rule gives away."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    n: int
    open: int  # not settled by the bound for depth 2
    open_any: int  # ... for any horizon
    loss: dict[str, float]  # in Q by rule, summed over all decisions
    loss_open: dict[str, float]  # ... over the open ones


class Result(BaseModel):
    """What one run came to."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    scenario: str
    dwells: int
    snr_db: float
    fidelity: str
    sigma_s: float
    rule: str
    seed: int
    document: str  # digest of what its scenario sets; what a program takes else, its digest says
    program: str  # that played it, and says what the following is
    digest: str | None = None  # over all its messages
    failed: str | None = None  # why it has no other results
    p_d: list[float | None] = []  # of each target: share of the dwells with a detection, None if it was never there,
    p_d_last: list[float | None] = []  # ... of the last ones,
    lost: list[int | None] = []  # ... 1 if its track was lost, None where none was begun for it
    decisions: Decisions | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.failed is None and not (
            self.digest is not None and self.p_d and len(self.p_d) == len(self.p_d_last) == len(self.lost)
        ):
            raise ValueError("neither what a run came to nor why it failed")
        if self.asked.setting not in SETTINGS or self.rule not in RULES:
            raise ValueError("none of the settings and rules that are compared")
        return self

    @property
    def asked(self) -> Asked:
        """Which run it is."""
        return Asked(Setting(self.snr_db, self.fidelity, self.sigma_s), self.rule, self.seed)


class Plan(NamedTuple):
    """How much is played."""

    scenario: str
    runs: int  # of each rule and setting at the scenario's SNR,
    weak_runs: int  # ... at lower ones,
    belief_runs: int  # ... and, by search, of those whose decisions are looked into one by one
    dwells: int | None  # None: the scenario's number

    def of(self, snr_db: float) -> int:
        """Runs of each rule and setting at an SNR."""
        return self.runs if snr_db == 0.0 else self.weak_runs

    def asked(self) -> list[Asked]:
        """The runs in their order: seed by seed, so that what is not finished has complete pairs."""
        return [
            Asked(setting, rule, seed)
            for seed in range(1, max(self.runs, self.weak_runs) + 1)
            for setting in SETTINGS
            for rule in RULES
            if seed <= self.of(setting.snr_db)
        ]

    def document(self, asked: Asked) -> str:
        """Digest of what the scenario of a run sets. Raises ScenarioError."""
        found = variant(self.scenario, asked.setting, asked.rule).model_dump_json(exclude_defaults=True)
        return hashlib.sha256(found.encode()).hexdigest()[:16]

    def is_looked_into(self, asked: Asked) -> bool:
        """Whether the decisions of a run are looked into one by one."""
        return asked.rule == SEARCH and asked.seed <= self.belief_runs

    def start(self, asked: Asked) -> RunStart:
        """What starts a run. Raises ScenarioError."""
        return RunStart.of(variant(self.scenario, asked.setting, asked.rule), STRATEGY, asked.seed, self.dwells)


def variant(name: str, setting: Setting, rule: str) -> Scenario:
    """A scenario played in a setting by a rule, with a name and a title of its own. Raises ScenarioError."""
    amplitude_db = load(name).radar.echo.amplitude_db + setting.snr_db
    number = 1 + SETTINGS.index(setting) * len(RULES) + list(RULES).index(rule)
    loaded = load(
        name,
        [
            f"radar.echo.amplitude_db={amplitude_db}",
            f"radar.fidelity={setting.fidelity}",
            f"radar.motion.sigma_s_km_s2={setting.sigma_s}",
            f"radar.planner.rule={rule}",
        ],
    )
    title = f"rule {rule}, {setting.fidelity}, {setting.snr_db:+g} dB, sigma_s = {setting.sigma_s:g}"
    return loaded.model_copy(update={"name": f"rules-{number}", "title": marked(title, rule)})


class Runs:
    """What the runs of one rule in one setting came to, in the order of their seeds."""

    def __init__(self, results: Sequence[Result]) -> None:
        ordered = sorted(results, key=lambda result: result.seed)
        self.seeds = np.array([result.seed for result in ordered])
        # (n_run, n_target) each; NaN where there was nothing.
        self.p_d, self.p_d_last, self.lost = (
            np.array([getattr(result, name) for result in ordered], dtype=np.float64)
            for name in ("p_d", "p_d_last", "lost")
        )


class Played:
    """The complete runs, by setting and rule."""

    def __init__(self, results: Sequence[Result]) -> None:
        """Raises BadInput if no run is complete."""
        complete = [result for result in results if result.failed is None]
        if not complete:
            raise BadInput("no run is complete yet")
        self.n_failed = len(results) - len(complete)
        self.programs = sorted({result.program for result in complete})
        cells: dict[Setting, dict[str, list[Result]]] = {}
        for result in complete:
            cells.setdefault(result.asked.setting, {}).setdefault(result.rule, []).append(result)
        self.runs = {
            setting: {rule: Runs(of_rules[rule]) for rule in RULES if rule in of_rules}
            for setting, of_rules in sorted(cells.items())
        }

    def detection(self, snr_db: float) -> Rows:
        """A row per setting and rule: P_D of the target detected least and of target 2, tracks lost."""
        return [
            _keys(setting, rule) | _detection(runs)
            for setting, of_rules in self.runs.items()
            for rule, runs in of_rules.items()
            if setting.snr_db == snr_db
        ]

    def differences(self, snr_db: float) -> Rows:
        """A row per setting and rule but the search: what it detects more, over the seeds that both played."""
        return [
            _keys(setting, rule) | _difference(of_rules[SEARCH], runs)
            for setting, of_rules in self.runs.items()
            for rule, runs in of_rules.items()
            if setting.snr_db == snr_db and rule != SEARCH and SEARCH in of_rules
        ]


def _keys(setting: Setting, rule: str) -> Row:
    return {**setting._asdict(), "rule": rule, "name": marked(rule, rule)}


def _detection(runs: Runs) -> Row:
    worst, shown = int(np.nanargmin(np.nanmean(runs.p_d, axis=0))), min(SHOWN, runs.p_d.shape[1]) - 1
    row = {"runs": runs.seeds.size, "worst": worst + 1}
    row |= {"lost": int(np.nansum(runs.lost)), "tracks": int((~np.isnan(runs.lost)).sum())}
    row |= _with_interval("p_d_worst", runs.p_d[:, worst]) | _with_interval("p_d", runs.p_d[:, shown])
    return row | _with_interval("p_d_last", runs.p_d_last[:, shown])


def _difference(search: Runs, other: Runs) -> Row:
    _, of_search, of_other = np.intersect1d(search.seeds, other.seeds, return_indices=True)
    every = other.p_d[of_other] - search.p_d[of_search]
    last = other.p_d_last[of_other] - search.p_d_last[of_search]
    shown = min(SHOWN, every.shape[1]) - 1
    row = {"runs": every.shape[0]} | _with_interval("p_d", every[:, shown])
    return row | _with_interval("p_d_last", last[:, shown]) | _with_interval("p_d_all", np.nanmean(every, axis=1))


def _with_interval(name: str, values: Floats) -> Row:
    """Mean over runs that have a value, and its 95 % interval by bootstrap over runs; None from fewer than two."""
    values = values[~np.isnan(values)]
    if values.size < 2:
        return {name: float(values.mean()) if values.size else None, f"{name}_low": None, f"{name}_high": None}
    low, high = bootstrap_interval(values, generator(0, Purpose.BOOTSTRAP, 0, 1))
    return {name: float(values.mean()), f"{name}_low": float(low), f"{name}_high": float(high)}


def losses(results: Iterable[Result], rules: Sequence[str]) -> Rows:
    """A row per setting and rule: share of decisions that the bounds leave open, mean loss in Q."""
    looked_into: dict[Setting, list[Decisions]] = {}
    for result in results:
        if result.decisions is not None and result.decisions.n:
            looked_into.setdefault(result.asked.setting, []).append(result.decisions)
    found = []
    for setting, mine in sorted(looked_into.items()):
        n, n_open = sum(of.n for of in mine), sum(of.open for of in mine)
        for rule in rules:
            loss, loss_open = sum(of.loss[rule] for of in mine), sum(of.loss_open[rule] for of in mine)
            found.append(
                _keys(setting, rule)
                | {"runs": len(mine), "decisions": n}
                | {"open": n_open / n, "open_any": sum(of.open_any for of in mine) / n}
                | {"loss": 1e3 * loss / n, "loss_open": 1e3 * loss_open / n_open if n_open else None}
            )
    return found
