"""Results made up so that every number of a report can be said beforehand."""

import json
from typing import Any

import pytest

from cogradar.services.analysis.report import report
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.scoring.scorer import Row
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.store.tables import Recording
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.loop import SMOKE
from tests.services.scored import pictures
from tests.services.scored import scores as named_scores

DWELLS = 60
TARGETS = 2
NEES = 4.5  # of every belief
TURNS_UNTIL = 15  # dwell; with 2 g


def made_recording(strategy: Strategy, seed: int, scores: list[Row], **other: Any) -> Recording:
    run = {
        "run": f"smoke-{strategy.value}-{seed}",
        "scenario": "smoke",
        "document": json.dumps(SMOKE.model_dump(mode="json"), sort_keys=True),
        "strategy": strategy.value,
        "seed": seed,
        "dwells": DWELLS,
        "dt_s": SMOKE.radar.motion.dt_s,
        "rate_hz": 0.0,
        "n_target": TARGETS,
        "n_track": TARGETS,
        "has_truth": 1,
        "acquisition_scans": 3 + seed,
        "conflicts": 0,
        "status": "complete",
        "reason": "",
        "digest": "0",
        "began_s": 0,
    } | other
    run.setdefault("acknowledged_t", run["dwells"])
    named = [score | {"run": run["run"]} for score in scores]
    return Recording(run, named, made_picture(str(run["run"]), seed), [])


def made_picture(run: str, seed: int) -> list[Row]:
    """Both targets followed, each off by so many km as the seed; in the last dwell one is missed.

    Of ten cells a dwell as many as the seed are blind in the last one.
    """
    rows = [
        (run, t, t, 2, 2, 2, 2, 2.0 * seed**2, 0.0, 0.0, 1.0 * seed**2, *(9 * [0]), 10, 0, 0, t - 1, 0)
        for t in range(1, DWELLS)
    ]
    squares = (1.0 * seed**2, 12.5, 0.0, 13.0)
    rows.append((run, DWELLS, DWELLS, 2, 1, 1, 1, *squares, 0, 0, 1, *(6 * [0]), 10, seed, 0, DWELLS - 1, 0))
    return pictures(rows)


OTHER = {
    "run": "other-uniform-2",
    "scenario": "other",
    "document": json.dumps(SMOKE.model_dump(mode="json") | {"name": "other"}, sort_keys=True),
}


def made_scores(seed: int, error_km: float, missed: int, lost_from: int = DWELLS + 1) -> list[Row]:
    """A run with a constant position error (times the seed), a velocity error of 5 m/s, misses at its end."""
    truth = (10.0, 0.1, 20.0, 0.2)
    estimate = (10.0 + 0.6 * error_km * seed, 0.103, 20.0 - 0.8 * error_km * seed, 0.196)
    return named_scores(
        # run, k, t, target, track, true_bin, bin, detected, snr_db, ..., share, signature_power, ...
        (
            "",
            t + 3,
            t,
            m,
            m,
            7,
            7 if t < lost_from else 9,
            t <= DWELLS - missed,
            -10.0,
            *truth,
            0.0,
            *estimate,
            0.25,
            9.0,
            0,
            0,
            t < lost_from,
            7 if t < lost_from else 9,
            max(t - lost_from + 1, 0),
            NEES,
            0.5 * NEES,
            0.6 * NEES,
            2.0 if t <= TURNS_UNTIL else 0.01,
            1,
            "[[7,0.25]]",
        )
        for t in range(1, DWELLS + 1)
        for m in range(1, TARGETS + 1)
    )


def report_of(store: Store) -> dict[str, Any]:
    """Of the one experiment there is."""
    (one,) = experiments(store, Selection(run="all"))
    return report(store, one)


@pytest.fixture
def store() -> Store:
    """Uniform: errors 2 seed km, 10 misses at the end. Power-aware: 1 seed km, 5 misses; seed 3 is lost at the end."""
    made, place = in_memory(), 0
    for seed in (2, 1, 3):
        for strategy, error_km, missed in ((Strategy.UNIFORM, 2.0, 10), (Strategy.POWER_AWARE, 1.0, 5)):
            place += 1
            lost_from = DWELLS - 19 if strategy is Strategy.POWER_AWARE and seed == 3 else DWELLS + 1
            made.journal.add_recording(
                made_recording(strategy, seed, made_scores(seed, error_km, missed, lost_from)), place
            )
    return made


def row_of(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    (row,) = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    return row
