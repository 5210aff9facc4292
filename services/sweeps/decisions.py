"""Rules of looking compared: which runs there are to be, and what each rule came to beside the search.

All rules meet the same seeds, hence the same targets in the same disturbance. The runs at the scenario's own SNR are
one campaign, those at lower ones, of which fewer are played, another, in a store beside the first.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.analysis.report import LAST, Sample, sample_of
from services.campaigns.campaign import Campaign
from services.errors import BadInput
from services.metrics.experiments import experiments
from services.metrics.selection import Selection
from services.metrics.store import Store
from shared.numerics.seeds import Purpose, generator
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
Rows = list[dict[str, Any]]


class Setting(NamedTuple):
    """Where rules are compared."""

    snr_db: float
    fidelity: str
    sigma_s: float


class Plan(NamedTuple):
    """How much is played."""

    scenario: str
    runs: int  # of each rule and setting at the scenario's SNR,
    weak_runs: int  # ... at lower ones,
    belief_runs: int  # ... and, by search, of those whose decisions are looked into one by one
    dwells: int | None  # None: the scenario's number


SETTINGS = [Setting(*values) for values in product(SNRS_DB, FIDELITIES, SIGMAS_KM_S2)]


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


def campaigns(plan: Plan, file: str) -> dict[str, Campaign]:
    """At the scenario's SNR, and at lower ones, by store; without the one of which no run is asked for."""
    own = [setting for setting in SETTINGS if setting.snr_db == 0.0]
    weak = [setting for setting in SETTINGS if setting.snr_db != 0.0]
    found = {}
    for path, settings, runs in zip(stores(file), (own, weak), (plan.runs, plan.weak_runs), strict=True):
        if runs:
            scenarios = tuple(variant(plan.scenario, setting, rule) for setting in settings for rule in RULES)
            found[path] = Campaign(scenarios, (STRATEGY,), runs, 1, plan.dwells)
    return found


def stores(file: str) -> list[str]:
    """Where the campaigns are kept: the file itself, and one beside it."""
    return [file, str(beside(file, "-weak.db"))]


def beside(file: str, end: str) -> Path:
    """A file beside the store."""
    path = Path(file)
    return path.with_name(path.stem + end)


class Played:
    """The complete runs of the stores, by setting and rule."""

    def __init__(self, scenario: str, opened: Sequence[Store]) -> None:
        """Raises BadInput if no run is complete."""
        own_db = load(scenario).radar.echo.amplitude_db
        self.samples: dict[Setting, dict[str, Sample]] = {}
        asked = [store.journal.campaign() or {} for store in opened]
        self.programs = sorted({document.get("program", "unknown") for document in asked})
        self.asked = {  # runs of each cell that there are to be, by SNR
            round(document["radar"]["echo"]["amplitude_db"] - own_db, 6): campaign["runs"]
            for campaign in asked
            for document in campaign.get("scenarios", ())
        }
        for store in opened:
            if not store.read("SELECT 1 FROM run WHERE status = 'complete' LIMIT 1"):
                continue
            for experiment in experiments(store, Selection.of({"run": "all"})):
                radar = Scenario.model_validate_json(experiment.document).radar
                snr_db = round(radar.echo.amplitude_db - own_db, 6)
                setting = Setting(snr_db, radar.fidelity, radar.motion.sigma_s_km_s2)
                of_rules = self.samples.setdefault(setting, {})
                of_rules[radar.planner.rule] = sample_of(store, experiment, STRATEGY)
        if not self.samples:
            raise BadInput("no run is complete yet")

    def detection(self, snr_db: float) -> Rows:
        """A row per setting and rule: P_D of the target detected least and of target 2, tracks lost."""
        return [
            _keys(setting, rule) | _detection(sample)
            for setting, of_rules in sorted(self.samples.items())
            for rule, sample in sorted(of_rules.items(), key=_order)
            if setting.snr_db == snr_db
        ]

    def differences(self, snr_db: float) -> Rows:
        """A row per setting and rule but the search: what it detects more, over the seeds that both played."""
        return [
            _keys(setting, rule) | _difference(of_rules[SEARCH], sample)
            for setting, of_rules in sorted(self.samples.items())
            for rule, sample in sorted(of_rules.items(), key=_order)
            if setting.snr_db == snr_db and rule != SEARCH and SEARCH in of_rules
        ]


def _order(item: tuple[str, Sample]) -> int:
    return list(RULES).index(item[0])


def _keys(setting: Setting, rule: str) -> dict[str, Any]:
    return {**setting._asdict(), "rule": rule, "name": marked(rule, rule)}


def hits(sample: Sample, *, last: bool = False) -> Floats:
    """Share of the dwells, or of the last ones, in which each run detected each target, (n_run, M)."""
    dwells = sample.detected.shape[1]
    return sample.window(max(1, dwells - LAST + 1) if last else 1, dwells)[..., 0]


def _detection(sample: Sample) -> dict[str, Any]:
    every = hits(sample)
    worst, shown = int(np.argmin(every.mean(axis=0))), min(SHOWN, every.shape[1]) - 1
    is_lost = sample.is_lost()
    row = {"runs": every.shape[0], "worst": worst + 1}
    row |= {"lost": int(np.nansum(is_lost)), "tracks": int((~np.isnan(is_lost)).sum())}
    row |= _with_interval("p_d_worst", every[:, worst]) | _with_interval("p_d", every[:, shown])
    return row | _with_interval("p_d_last", hits(sample, last=True)[:, shown])


def _difference(search: Sample, other: Sample) -> dict[str, Any]:
    _, of_search, of_other = np.intersect1d(search.seeds, other.seeds, return_indices=True)
    every = hits(other)[of_other] - hits(search)[of_search]
    last = hits(other, last=True)[of_other] - hits(search, last=True)[of_search]
    shown = min(SHOWN, every.shape[1]) - 1
    row = {"runs": every.shape[0]} | _with_interval("p_d", every[:, shown])
    return row | _with_interval("p_d_last", last[:, shown]) | _with_interval("p_d_all", every.mean(axis=1))


def _with_interval(name: str, values: Floats) -> dict[str, float | None]:
    """Mean over runs, and its 95 % interval by bootstrap over runs; None from fewer than two."""
    if values.size < 2:
        return {name: float(values.mean()) if values.size else None, f"{name}_low": None, f"{name}_high": None}
    low, high = bootstrap_interval(values, generator(0, Purpose.BOOTSTRAP, 0, 1))
    return {name: float(values.mean()), f"{name}_low": float(low), f"{name}_high": float(high)}
