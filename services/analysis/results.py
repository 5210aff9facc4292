"""What the runs of a store came to, as arrays: one experiment, several strategies, many seeds."""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput
from cogradar.services.metrics.experiments import Experiment
from cogradar.services.metrics.store import Store
from cogradar.shared.protocol.messages import Waveform
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.bounds import RangeBound, range_bound, range_information
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.wire.codec import decode
from cogradar.shared.world.disturbance import power_spectrum

Floats = NDArray[np.float64]

_SCORES = (
    "detected, COALESCE(true_bin, -1), snr_db, share, signature_power, x, vx, y, vy, x_hat, vx_hat, y_hat, vy_hat,"
    " nees, track, visible"
)


@dataclass(frozen=True)
class StrategyRuns:
    """All complete runs of one strategy. Axes: run, dwell t = 1 .. T, target."""

    names: tuple[str, ...]
    seeds: tuple[int, ...]
    acquisition_scans: Floats  # (n,)
    detected: Floats  # (n, T, M) the true cell was tested and over the threshold, 0 or 1; NaN: there was no target
    true_bin: NDArray[np.int64]  # (n, T, M); -1: there was no target
    snr_db: Floats  # (n, T, M); NaN: there was no target
    share: Floats  # (n, T, M)
    signature_power: Floats  # (n, T, M) ||v||^2 of the cell of the true bin; 0 if it was not tested
    truth: Floats  # (n, T, M, 4)
    estimate: Floats  # (n, T, M, 4)
    nees: Floats  # (n, T, M); NaN: there was no track or no target
    track: Floats  # (n, T, M) number of the track that follows it; NaN: none
    visible: Floats  # (n, T, M) the radar could have seen it, 0 or 1; NaN: there was no target


@dataclass(frozen=True)
class Results:
    """The runs of one experiment by strategy, the paper's own first."""

    scenario: Scenario
    dwells: int
    runs: dict[str, StrategyRuns]

    @property
    def t(self) -> NDArray[np.int64]:
        """Dwells 1 .. T."""
        return np.arange(1, self.dwells + 1)

    @property
    def is_single(self) -> bool:
        """Whether there is one run of each strategy: what is drawn is that run's own, without an interval."""
        return all(len(runs.seeds) == 1 for runs in self.runs.values())

    def bound(self, strategy: str, target: int, velocity_sigma: float) -> RangeBound:
        """Floor under the errors of a strategy's track, given what lit its target's cell (scoring.bounds)."""
        runs, array = self.runs[strategy], self.scenario.radar.array
        world, dt_s = self.scenario.simulated, self.scenario.radar.motion.dt_s
        spectrum = power_spectrum(world.disturbance.model, bin_centres(array.n_bin))
        snr = 10.0 ** (runs.snr_db[:, :, target] / 10.0) / spectrum[runs.true_bin[:, :, target]]
        range_km = np.hypot(runs.truth[:, :, target, 0], runs.truth[:, :, target, 2])
        isotropic = float(array.n_rx * array.power)  # ||v||^2 of the orthogonal waveform
        lit = runs.signature_power[:, :, target]  # ... of what was sent, whichever track asked for it
        information = range_information(range_km, np.sqrt(snr * lit)).mean(axis=0)
        # The targets are held at their start while they are acquired; the first dwell is a second away from it.
        acquired = range_information(range_km[:, 0], np.sqrt(snr[:, 0] * isotropic))
        initial = float(np.mean(runs.acquisition_scans * acquired))
        return range_bound(information, initial, velocity_sigma, dt_s, world.motion.sigma_s_km_s2)

    def floor(self, strategy: str, target: int) -> RangeBound:
        """`bound` where it applies to targets that all start alike; NaN before.

        The bound is an average over starts drawn from the prior. Here every run starts in one state, and until the data
        outweigh the prior an estimate near the prior's mean may be better than that. So the floor begins where a prior
        ten times as wide changes it by less than 5 %. NaN with range cells, and of a target that comes or goes.
        """
        sigma = self.scenario.radar.acquisition.v_max_km_s / np.sqrt(3.0)  # of the uniform prior
        comes_or_goes = bool(np.isnan(self.runs[strategy].detected[:, :, target]).any())
        # With range cells ranges are measured; the bound is of amplitudes.
        if self.scenario.radar.receiver.range_cell_km > 0.0 or comes_or_goes:
            return RangeBound(*np.full((2, self.dwells), np.nan))
        bound, wider = self.bound(strategy, target, sigma), self.bound(strategy, target, 10.0 * sigma)
        position, velocity = (np.where(b > 0.95 * w, b, np.nan) for b, w in zip(bound, wider, strict=True))
        return RangeBound(position, velocity)


@dataclass(frozen=True)
class Snapshot:
    """What one run of a strategy radiated in a dwell."""

    strategy: str
    t: int
    waveform: Waveform
    true_bin: NDArray[np.int64]  # (M,)
    snr_db: Floats  # (M,)


def read_results(store: Store, experiment: Experiment) -> Results:
    """Complete runs of an experiment, first the paper's own strategy."""
    scenario = Scenario.model_validate(json.loads(experiment.document))
    others = [strategy for strategy in experiment.strategies if strategy not in set(Strategy)]
    known = [strategy.value for strategy in reversed(Strategy) if strategy in experiment.strategies]
    runs = {strategy: _read_runs(store, experiment, strategy) for strategy in (*known, *others)}
    return Results(scenario, experiment.dwells, runs)


def _read_runs(store: Store, experiment: Experiment, strategy: str) -> StrategyRuns:
    runs, table = experiment.of(strategy), experiment.scores(store, strategy, _SCORES)
    return StrategyRuns(
        names=tuple(run["run"] for run in runs),
        seeds=tuple(run["seed"] for run in runs),
        acquisition_scans=np.array([run["acquisition_scans"] for run in runs], dtype=np.float64),
        detected=table[..., 0],
        true_bin=table[..., 1].astype(np.int64),
        snr_db=table[..., 2],
        share=table[..., 3],
        signature_power=table[..., 4],
        truth=table[..., 5:9],
        estimate=table[..., 9:13],
        nees=table[..., 13],
        track=table[..., 14],
        visible=table[..., 15],
    )


def read_snapshots(store: Store, results: Results, dwells: tuple[int, ...]) -> tuple[int, list[Snapshot]]:
    """Seed and waveforms of these dwells, one run per strategy: of the first seed for which they are all kept.

    (-1, []) if there is no such seed.
    """
    for seed in next(iter(results.runs.values())).seeds:
        taken = [
            _snapshot(store, results.runs[strategy], strategy, seed, t) for strategy in results.runs for t in dwells
        ]
        if all(taken):
            return seed, [snapshot for snapshot in taken if snapshot is not None]
    return -1, []


def _snapshot(store: Store, runs: StrategyRuns, strategy: str, seed: int, t: int) -> Snapshot | None:
    if seed not in runs.seeds:
        return None
    i = runs.seeds.index(seed)
    # Waveform k is radiated at dwell k+1; dwell t is scan acquisition_scans - 1 + t, counted from 0.
    k = int(runs.acquisition_scans[i]) - 2 + t
    payload = store.journal.message(runs.names[i], k, "waveform", 0)
    if payload is None:
        return None
    waveform = decode(payload)
    if not isinstance(waveform, Waveform):
        raise BadInput(f"dwell {t} of seed {seed}: the store has no waveform where one belongs")
    return Snapshot(strategy, t, waveform, runs.true_bin[i, t - 1], runs.snr_db[i, t - 1])


def running_mean(values: Floats, window: int) -> Floats:
    """Mean over a centred window, over what is known of it; NaN where a value is; (T,) -> (T,)."""
    ones, is_known = np.ones(window), ~np.isnan(values)
    # "same" gives as many values as the longer of the two has: cut if the window is longer than the series.
    total = np.convolve(np.where(is_known, values, 0.0), ones, "full")
    count = np.convolve(is_known.astype(np.float64), ones, "full")
    within = slice((window - 1) // 2, (window - 1) // 2 + values.size)
    return np.where(is_known, total[within] / np.maximum(count[within], 1.0), np.nan)
