"""What a store of runs shows: per strategy and target, with intervals, and strategies against each other.

Two intervals of P_D: Wilson's takes every dwell as a trial of its own, which dwells of one run are not (a lost track
misses them all), so it is too narrow. The other resamples whole runs (bootstrap) and is the one to quote. That one has
no width where all runs agree: then Wilson's over the number of runs still holds. Errors are resampled over runs too.
Differences are taken within a seed, where both strategies met the same targets and disturbance, and then resampled.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.campaigns.campaign import results_digest
from cogradar.services.metrics.answers import figures
from cogradar.services.metrics.experiments import Experiment
from cogradar.services.metrics.pools import confirmation
from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.scoring.antennas import AntennaPowers
from cogradar.services.metrics.scoring.sums import CONSISTENCY, OF_FLIGHTS
from cogradar.services.metrics.store import Store
from cogradar.services.runs.run import BLIND, window
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scoring.errors import FLIGHTS, NEES_99, bootstrap_interval, lost, nees_in_band, wilson_interval

Floats = NDArray[np.float64]
Rows = list[dict[str, Any]]

LAST = 20  # dwells at the end, over which strategies are compared
ROWS = 40  # in time, at most
WAVEFORMS = 16  # of each run, for the powers of the antennas
MEANS = ("p_d", "hit_rate", "in_bin", "share")
_N_PROBABILITY = 3  # of them are probabilities
ROOTS = ("position_rmse_km", "velocity_rmse_km_s")
_OUTAGE = len(MEANS + ROOTS)  # its place in a sample
FIRST = ("strategy", "seed", "dwells", "digest")  # what says how to repeat one of the runs
COMPARED = ("p_d", *ROOTS)
# Of all targets together: root mean squares over runs, and means.
PICTURED_ROOTS = ("gospa_km", "gospa_localisation_km", "gospa_missed_km", "gospa_false_km", "ospa_km")
PICTURED = ("completeness", "ambiguity", "spuriousness", "swaps", "breaks", "false_tracks_per_hour", "tracks", *BLIND)


@dataclass(frozen=True)
class Sample:
    """Runs of one strategy, in the order of their seeds."""

    seeds: NDArray[np.int64]  # (n_run,)
    scans: NDArray[np.int64]  # (n_run,) of the acquisition
    detected: Floats  # (n_run, dwells, n_target), 0 or 1; NaN, as all that follows: there was no target
    hit: Floats  # the true bin was lit for the track, 0 or 1
    in_bin: Floats  # the belief's most probable bin was the true one, 0 or 1
    share: Floats  # power on the track's beams
    position_sq: Floats  # squared error, km^2
    velocity_sq: Floats  # squared error, (km/s)^2
    outage: Floats  # dwells in a row out of the bin
    nees: Floats  # of the estimate; NaN of a belief that spans no volume
    nees_position: Floats  # of the position alone
    nees_velocity: Floats  # of the velocity alone

    def window(self, first: int, last: int) -> Floats:
        """Means over the dwells first .. last: (n_run, n_target, len(MEANS + ROOTS)), of squares for ROOTS."""
        columns = (self.detected, self.hit, self.in_bin, self.share, self.position_sq, self.velocity_sq)
        return np.stack([_mean(np.moveaxis(column[:, first - 1 : last], 1, 0)) for column in columns], axis=-1)

    def is_lost(self) -> Floats:
        """Whether each target's track was lost, 0 or 1: (n_run, n_target), NaN where none was begun for it."""
        outages = np.moveaxis(self.outage, 1, -1)
        return np.where(np.isnan(outages).all(axis=-1), np.nan, lost(outages))


def report(store: Store, experiment: Experiment) -> dict[str, Any]:
    """Everything about one experiment, ready for JSON."""
    samples = {strategy: sample_of(store, experiment, strategy) for strategy in experiment.strategies}
    runs, dwells = [*experiment.complete, *experiment.failed], experiment.dwells
    radar = json.loads(experiment.document)["radar"]
    return {
        "scenario": experiment.scenario,
        "title": experiment.title,
        "fidelity": radar["fidelity"],
        "rule": radar["planner"]["rule"],
        "dwells": dwells,
        "first": {key: experiment.complete[0][key] for key in FIRST} if _is_shipped(experiment) else None,
        "runs": {name: int(sample.seeds.size) for name, sample in samples.items()},
        "failed": [{"run": run["run"], "reason": run["reason"]} for run in experiment.failed],
        "conflicts": sum(run["conflicts"] for run in runs),
        "digest": results_digest(store, [run["run"] for run in runs]),
        "acquisition": [_acquisition(*named) for named in samples.items() if not experiment.is_unknown],
        "last": _by_target(samples, last_dwells(dwells)),
        "windows": [row for window in _windows(dwells) for row in _by_target(samples, window)],
        "lost": _ordered(row for name, sample in samples.items() for row in _lost(name, sample)),
        "overall": [_overall(name, sample) for name, sample in samples.items()],
        "picture": [_picture(store, experiment, name) for name in samples],
        "antennas": [row for name in samples for row in _antennas(store, experiment, name)],
        "consistency": _ordered(row for name, sample in samples.items() for row in _consistency(name, sample)),
        "flights": [row for name in samples for row in _flights(store, experiment, name)],
        "confirmation": [_confirmation(store, experiment, name) for name in samples if experiment.is_unknown],
        "differences": differences(samples, last_dwells(dwells)),
    }


def _is_shipped(experiment: Experiment) -> bool:
    """Whether the scenario is what its name means on a command line, and its runs end by themselves."""
    if experiment.was_ended:
        return False
    try:
        shipped = load(experiment.scenario)
    except ScenarioError:
        return False
    return bool(shipped.model_dump(mode="json") == json.loads(experiment.document))


def sample_of(store: Store, experiment: Experiment, strategy: str) -> Sample:
    """The complete runs of a strategy."""
    columns = experiment.scores(
        store,
        strategy,
        "detected, hit, COALESCE(best_bin, -1) = true_bin, CASE WHEN detected IS NOT NULL THEN share END,"
        " (x - x_hat) * (x - x_hat) + (y - y_hat) * (y - y_hat),"
        " (vx - vx_hat) * (vx - vx_hat) + (vy - vy_hat) * (vy - vy_hat), outage, nees, nees_position, nees_velocity",
    )
    if experiment.is_unknown:  # of the dwells since a target was followed first, in which alone there are outages
        columns[np.isnan(columns[..., _OUTAGE])] = np.nan
    runs = experiment.of(strategy)
    seeds, scans = (np.array([run[key] for run in runs]) for key in ("seed", "acquisition_scans"))
    return Sample(seeds, scans, *np.moveaxis(columns, -1, 0))


def last_dwells(dwells: int) -> tuple[int, int]:
    """First and last of the dwells in which the end of a run is judged."""
    return max(1, dwells - LAST + 1), dwells


def _windows(dwells: int) -> list[tuple[int, int]]:
    """First and last dwell of each row in time, and of the whole run."""
    width = window(dwells, ROWS)
    parts = [(first, min(first + width - 1, dwells)) for first in range(1, dwells + 1, width)]
    return parts if len(parts) == 1 else [*parts, (1, dwells)]


def _resampler(first: int) -> np.random.Generator:
    """Same resamples for every strategy and on every machine."""
    return generator(0, Purpose.BOOTSTRAP, 0, first)


def _roots(means: Floats) -> Floats:
    """Means of squares become root mean squares; (..., len(MEANS + ROOTS))."""
    return np.concatenate((means[..., : len(MEANS)], np.sqrt(means[..., len(MEANS) :])), axis=-1)


def _mean(values: Floats) -> Floats:
    """Mean over the first axis of what is known: a target without a track has no error, one that is away nothing."""
    is_known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):  # 0/0: nothing is known
        return np.asarray(np.where(is_known, values, 0.0).sum(axis=0) / is_known.sum(axis=0))


def _interval(values: Floats, first: int, statistic: Any) -> tuple[Floats, Floats]:
    """Bootstrap over runs; unknown (NaN) from a single run."""
    if values.shape[0] < 2:
        unknown = np.full(np.shape(statistic(_mean(values))), np.nan)
        return unknown, unknown
    return bootstrap_interval(values, _resampler(first), statistic)


def _widen_if_certain(values: Floats, low: Floats, high: Floats) -> None:
    """Where a probability, (n_run, ..., n), is 0 or 1 in all runs, resampling has no width: Wilson's over runs holds.

    low, high : (..., n or more), whose first n are changed
    """
    n_run, n = values.shape[0], values.shape[-1]
    agreed = ((values == 0.0).all(axis=0) | (values == 1.0).all(axis=0)) & ~np.isnan(low[..., :n])
    of_runs = wilson_interval(values[0] * n_run, np.full(values.shape[1:], n_run))
    for ends, wilson in zip((low, high), of_runs, strict=True):
        ends[..., :n] = np.where(agreed, wilson, ends[..., :n])


def _by_target(samples: dict[str, Sample], window: tuple[int, int]) -> Rows:
    """Rows of a window of dwells, target by target."""
    rows = []
    for name, sample in samples.items():
        values = sample.window(*window)
        estimate = _roots(_mean(values))
        low, high = _interval(values, window[0], _roots)
        _widen_if_certain(values[..., :_N_PROBABILITY], low, high)
        detected = sample.detected[:, window[0] - 1 : window[1]]
        hits, n = np.nansum(detected, axis=(0, 1)), (~np.isnan(detected)).sum(axis=(0, 1))
        wilson_low, wilson_high = wilson_interval(hits, n)
        for m in range(hits.size):
            row: dict[str, Any] = {"target": m + 1, "strategy": name, "runs": values.shape[0]}
            row |= {"first_dwell": window[0], "last_dwell": window[1], "n": n[m]}
            row |= {"p_d_wilson_low": wilson_low[m], "p_d_wilson_high": wilson_high[m]}
            for i, metric in enumerate(MEANS + ROOTS):
                row |= _with_interval(metric, estimate[m, i], low[m, i], high[m, i])
            rows.append(_plain(row))
    return _ordered(rows)


def _acquisition(name: str, sample: Sample) -> dict[str, Any]:
    low, high = _interval(sample.scans.astype(np.float64), 0, np.asarray)
    row = {"strategy": name, "runs": sample.scans.size, "median": np.median(sample.scans), "max": sample.scans.max()}
    return _plain(row | _with_interval("mean", sample.scans.mean(), low, high))


def _lost(name: str, sample: Sample) -> Rows:
    """Tracks that were lost, and how long tracks were out of their targets' bins."""
    is_lost, rows = sample.is_lost(), []
    longest = np.nan_to_num(sample.outage).max(axis=(0, 1))
    total = (sample.outage > 0).sum(axis=(0, 1))
    n_lost, n_track = np.nansum(is_lost, axis=0).astype(np.int64), (~np.isnan(is_lost)).sum(axis=0)
    for m, n in enumerate(n_track):
        row: dict[str, Any] = {"target": m + 1, "strategy": name, "runs": is_lost.shape[0], "tracks": n}
        known = {"lost": n_lost[m], "outage": total[m] / max(n, 1), "outage_longest": int(longest[m])}
        known |= _with_interval("share", n_lost[m] / max(n, 1), *wilson_interval(int(n_lost[m]), int(n)))
        rows.append(_plain(row | (known if n else dict.fromkeys(known))))
    return rows


def _overall(name: str, sample: Sample) -> dict[str, Any]:
    """All targets and dwells of a strategy: how often beliefs were right about the bin, and how many tracks were lost.

    Tracks of one run are not independent either: both intervals resample runs.
    """
    is_lost = sample.is_lost()
    in_bins = _mean(np.moveaxis(sample.in_bin.reshape(len(is_lost), -1), 1, 0))
    values = np.stack((in_bins, _mean(is_lost.T)), axis=-1)
    (in_bin, share), (lows, highs) = _mean(values), _interval(values, 0, np.asarray)
    _widen_if_certain(values, lows, highs)
    row: dict[str, Any] = {"strategy": name, "runs": values.shape[0]}
    row |= {"lost": int(np.nansum(is_lost)), "tracks": (~np.isnan(is_lost)).sum()}
    row |= _with_interval("in_bin", in_bin, lows[0], highs[0])
    return _plain(row | _with_interval("share", share, lows[1], highs[1]))


def _picture(store: Store, experiment: Experiment, name: str) -> dict[str, Any]:
    """All tracks and targets of a strategy's runs together, over all dwells."""
    runs, n = [run["run"] for run in experiment.of(name)], len(PICTURED_ROOTS)
    found = figures(store, runs)
    columns = [[found[run][metric] for metric in (*PICTURED_ROOTS, *PICTURED)] for run in runs]
    values = np.array(columns, dtype=np.float64)  # (n_run, metrics)
    values[:, :n] **= 2

    def rooted(means: Floats) -> Floats:
        return np.concatenate((np.sqrt(means[..., :n]), means[..., n:]), axis=-1)

    row: dict[str, Any] = {"strategy": name, "runs": len(runs)}
    for metric, *of_metric in zip(
        (*PICTURED_ROOTS, *PICTURED), rooted(_mean(values)), *_interval(values, 0, rooted), strict=True
    ):
        row |= _with_interval(metric, *of_metric)
    return _plain(row)


def _antennas(store: Store, experiment: Experiment, name: str) -> Rows:
    """The hottest antenna over the mean, and the largest peak over the mean, both averages over stored waveforms."""
    found = [AntennaPowers.of(store, run["run"], None, None, WAVEFORMS) for run in experiment.of(name)]
    kept = [one for one in found if one.ts.size]
    if not kept:
        return []
    values = np.array(
        [
            (10.0 * np.log10(one.powers.max(axis=1) / one.powers.mean(axis=1)).mean(), one.papr_db.max(axis=1).mean())
            for one in kept
        ]
    )
    row: dict[str, Any] = {"strategy": name, "runs": len(kept), "n": sum(one.ts.size for one in kept)}
    for metric, *of_metric in zip(
        ("hottest_db", "papr_db"), _mean(values), *_interval(values, 0, np.asarray), strict=True
    ):
        row |= _with_interval(metric, *of_metric)
    return [_plain(row)]


def _consistency(name: str, sample: Sample) -> Rows:
    """Whether beliefs are what they claim to be: NEES, 4 on average; how often its mean over runs is in its band."""
    n_run, n_target = sample.seeds.size, sample.nees.shape[-1]
    beyond = np.where(np.isnan(sample.nees), np.nan, sample.nees > NEES_99)
    columns = (sample.nees, sample.nees_position, sample.nees_velocity, beyond)
    means = np.stack([_mean(column.reshape(-1, n_target)) for column in columns], axis=-1)
    there = (~np.isnan(sample.detected)).any(axis=0).mean(axis=0)  # share of the dwells; elsewhere nothing is in band
    with np.errstate(invalid="ignore"):
        in_band = nees_in_band(sample.nees) / there
    return [
        _plain(
            {"target": m + 1, "strategy": name, "runs": n_run, "in_band": in_band[m]}
            | dict(zip(CONSISTENCY[1:], means[m], strict=True))
        )
        for m in range(n_target)
    ]


def _flights(store: Store, experiment: Experiment, name: str) -> Rows:
    """NEES of all targets of a strategy's runs in straight flight and in turns, with intervals over runs."""
    runs = [run["run"] for run in experiment.of(name)]
    store.derive(runs)
    found = store.summed(*sums.query({run: i for i, run in enumerate(runs)}, None, None, None))
    columns = [column for columns in OF_FLIGHTS for column in columns]
    totals = np.zeros((len(runs), len(FLIGHTS), len(CONSISTENCY)))
    for row in found:
        totals[row["place"]] += np.array([row[column] or 0.0 for column in columns]).reshape(totals.shape[1:])

    def ratios(means: Floats) -> Floats:
        with np.errstate(invalid="ignore"):  # 0/0: no target flies so
            return np.asarray(means[..., 1:] / means[..., :1])

    estimate, (lows, highs) = ratios(totals.mean(axis=0)), _interval(totals, 0, ratios)
    rows = Rows()
    for i, flight in enumerate(FLIGHTS):
        of_flight: dict[str, Any] = {"strategy": name, "runs": len(runs), "flight": flight.name}
        of_flight |= {"n": int(totals[:, i, 0].sum())}
        for j, metric in enumerate(CONSISTENCY[1:]):
            of_flight |= _with_interval(metric, estimate[i, j], lows[i, j], highs[i, j])
        rows.append(_plain(of_flight))
    return rows


def _confirmation(store: Store, experiment: Experiment, name: str) -> dict[str, Any]:
    """How soon the targets of a strategy's runs were found, and how many never."""
    runs = experiment.of(name)
    found = confirmation(store, runs)
    ends = wilson_interval(found.never_found, found.long_visible)
    row = {"strategy": name, "runs": len(runs)} | found._asdict()
    share = found.never_found / found.long_visible if found.long_visible else None
    return _plain(row | _with_interval("share", share, *(ends if found.long_visible else (None, None))))


def differences(samples: dict[str, Sample], window: tuple[int, int]) -> Rows:
    """Second strategy minus first, over the seeds that both played."""
    rows = []
    for (name_a, a), (name_b, b) in combinations(samples.items(), 2):
        _, of_a, of_b = np.intersect1d(a.seeds, b.seeds, return_indices=True)
        if not of_a.size:
            continue
        pairs = np.stack((a.window(*window)[of_a], b.window(*window)[of_b]))
        values = np.moveaxis(pairs, 0, 1)  # (n_run, 2, n_target, metrics)
        estimate = _minus(_mean(values))
        low, high = _interval(values, window[0], _minus)
        for m in range(estimate.shape[0]):
            row: dict[str, Any] = {"target": m + 1, "strategy": name_b, "minus": name_a, "runs": of_a.size}
            row |= {"first_dwell": window[0], "last_dwell": window[1]}
            for metric in COMPARED:
                i = (MEANS + ROOTS).index(metric)
                row |= _with_interval(metric, estimate[m, i], low[m, i], high[m, i])
            rows.append(_plain(row))
    return _ordered(rows)


def _ordered(rows: Iterable[dict[str, Any]]) -> Rows:
    """Target by target, strategies as they were."""
    return sorted(rows, key=lambda row: row["target"])


def _minus(means: Floats) -> Floats:
    """Second of a pair minus the first, (..., 2, n_target, metrics) -> (..., n_target, metrics)."""
    rooted = _roots(means)
    return np.asarray(rooted[..., 1, :, :] - rooted[..., 0, :, :])


def _with_interval(name: str, value: Any, low: Any, high: Any) -> dict[str, Any]:
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """Numbers that JSON has; unknown is null."""
    plain = {key: value.item() if isinstance(value, np.ndarray | np.generic) else value for key, value in row.items()}
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in plain.items()}
