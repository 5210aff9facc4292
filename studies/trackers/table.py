"""The trackers beside each other: skies, seeds, medians with intervals."""

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

import cogradar
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.campaigns.pool import LocalPool, n_core
from cogradar.services.errors import check_stop
from studies.trackers.scores import OWN, TRACKERS, TURNS, Score, compare
from studies.trackers.skies import SKIES

Scores = Mapping[str, Sequence[Mapping[str, Score]]]  # by sky: of each seed the score of each tracker
N_RESAMPLE = 2000


def play(
    skies: Sequence[str], seeds: int, dwells: int, store: Path, tell: Callable[[str], None], stop: Event
) -> Scores:
    """Scores of seeds from 1; a run that the store, a folder, has is not played again. Raises BadInput, Interrupted."""
    store.mkdir(parents=True, exist_ok=True)
    files = {
        (sky, seed): store / f"{Path(sky).stem}-{dwells}-{seed}.json" for sky in skies for seed in range(1, seeds + 1)
    }
    missing = [one for one, file in files.items() if not file.exists()]
    with LocalPool(n_core()).open(max(len(missing), 1)) as executor:
        waiting = [executor.submit(_play, sky, seed, dwells, files[sky, seed]) for sky, seed in missing]
        for n, future in enumerate(as_completed(waiting), 1):
            future.result()
            check_stop(stop)
            tell(f"{n} of {len(missing)} runs")
    return {sky: [_read(files[sky, seed]) for seed in range(1, seeds + 1)] for sky in skies}


def _play(sky: str, seed: int, dwells: int, file: Path) -> None:
    """Play a run and write its scores, and a made sky beside them."""
    made = SKIES.get(sky)
    if made is not None:
        file.with_suffix(".toml").write_text(made(seed), encoding="utf-8")
    scenario = cogradar.load(sky if made is None else file.with_suffix(".toml"))
    scores = compare(scenario, seed, min(dwells, scenario.dwells))
    file.write_text(json.dumps({name: score._asdict() for name, score in scores.items()}), encoding="utf-8")


def _read(file: Path) -> dict[str, Score]:
    return {name: Score(**score) for name, score in json.loads(file.read_text(encoding="utf-8")).items()}


def table(scores: Scores) -> Table:
    """A row per sky and tracker: medians over runs, some with 95 % intervals; swaps are of all runs."""
    rows = [row for sky, runs in scores.items() for row in _rows(sky, runs)]
    headings = {
        "gospa_km": "GOSPA km",
        "ratio": "to the better other",
        "missed": "missed %",
        "false": "false %",
        "swaps": "swaps",
        "rmse_m": "RMSE m",
        "velocity_m_s": "velocity m/s",
        **{f"nees_{i}": f"NEES {flight.name}" for i, flight in enumerate(TURNS)},
    }
    columns = [Column("sky", "{sky}", left=True), Column("runs", "{runs}"), Column("tracker", "{tracker}", left=True)]
    columns += [Column(heading, f"{{{name}}}") for name, heading in headings.items()]
    return Table("Trackers on the same detections: medians over runs [95 %]", columns, rows, "sky")


def _rows(sky: str, runs: Sequence[Mapping[str, Score]]) -> list[dict[str, Any]]:
    better = [min(run[name].gospa_km for name in TRACKERS if name != OWN) for run in runs]
    rows = []
    for tracker in TRACKERS:
        scores = [run[tracker] for run in runs]
        row: dict[str, Any] = {"sky": Path(sky).stem, "runs": len(runs), "tracker": tracker, "ratio": None}
        row |= {name: _median([getattr(score, name) for score in scores], form) for name, form in _FORMS.items()}
        row |= {name: f"{np.median([getattr(score, name) for score in scores]):.1f}" for name in ("missed", "false")}
        row |= {"swaps": f"{sum(score.swaps for score in scores):.0f}"}
        row |= {f"nees_{i}": _median([score.nees[i] for score in scores], ".1f") for i in range(len(TURNS))}
        if tracker == OWN:
            ratios = [score.gospa_km / other for score, other in zip(scores, better, strict=True)]
            row["ratio"] = _median(ratios, ".2f")
        rows.append(row)
    return rows


_FORMS = {"gospa_km": ".2f", "rmse_m": ".0f", "velocity_m_s": ".0f"}


def _median(values: Sequence[float], form: str) -> str | None:
    """Median and percentile bootstrap interval over runs (Efron 1979); None: nothing is known."""
    known = np.array([value for value in values if not np.isnan(value)])
    if not known.size:
        return None
    drawn = np.random.default_rng(0).choice(known, (N_RESAMPLE, known.size))
    low, high = np.quantile(np.median(drawn, axis=1), [0.025, 0.975])
    return f"{np.median(known):{form}} [{low:{form}}, {high:{form}}]"
