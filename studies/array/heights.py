"""Targets at a height, of which a linear array measures the cone: are the estimates on the ground what they claim?

The runs are from a sweep over `radar.assumes.height_max_km`. The last column is the error of a radar that knows
the plane of the array exactly: what the unknown height leaves.
"""

from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from cogradar.services.analysis.report import sample_of
from cogradar.services.analysis.results import Results, read_results
from cogradar.services.analysis.tables import Column, Row, Table
from cogradar.services.metrics import client
from cogradar.services.metrics.experiments import Experiment, experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scoring.errors import bootstrap_interval
from cogradar.shared.signal.array import in_plane, on_ground

Floats = NDArray[np.float64]


def measure(file: str) -> list[Row]:
    """A row per assumption. Raises BadInput."""
    with closing(client.open_store(file)) as store:
        return [_row(store, one) for one in experiments(store, Selection.of({"run": "all"}))]


def _row(store: Store, experiment: Experiment) -> Row:
    results, (strategy,) = read_results(store, experiment), experiment.strategies
    sample, assumed = sample_of(store, experiment, strategy), results.scenario.radar.assumes.height_max_km
    rng = generator(0, Purpose.BOOTSTRAP, 0, 0)
    nees, squares = (_of_runs(column) for column in (sample.nees, sample.position_sq))
    nees_low, nees_high = bootstrap_interval(nees, rng)
    rmse_low, rmse_high = bootstrap_interval(squares, rng, np.sqrt)
    return {
        "assumed": assumed,
        "runs": len(sample.seeds),
        "nees": nees.mean(),
        "nees_low": nees_low,
        "nees_high": nees_high,
        "rmse": np.sqrt(squares.mean()),
        "rmse_low": rmse_low,
        "rmse_high": rmse_high,
        "left": np.sqrt(np.mean(left(results, strategy, assumed) ** 2)),
    }


def _of_runs(values: Floats) -> Floats:
    """Mean of each run over its dwells and targets, (n_run,)."""
    return np.asarray(np.nanmean(values, axis=(1, 2)))


def left(results: Results, strategy: str, assumed_km: float) -> Floats:
    """Errors on the ground, km, if x' and y were known exactly, (n,); of the dwells with a track."""
    runs, heights = results.runs[strategy], [target.height_km for target in results.scenario.simulated.targets]
    truth = runs.truth[~np.isnan(runs.estimate[..., 0])]
    z = np.broadcast_to(heights, runs.truth.shape[:3])[~np.isnan(runs.estimate[..., 0])]
    known = in_plane(truth, z)
    certain = np.zeros((4, 4))
    estimates = np.array([on_ground(state, certain, assumed_km)[0] if assumed_km else state for state in known])
    return np.hypot(estimates[:, 0] - truth[:, 0], estimates[:, 2] - truth[:, 2])


def table(rows: list[Row]) -> Table:
    columns = (
        Column("heights assumed, km", "0 to {assumed:g}"),
        Column("runs", "{runs}"),
        Column("NEES, mean", "{nees:.1f}"),
        Column("95 %, runs", "{nees_low:.1f} {nees_high:.1f}"),
        Column("RMSE km", "{rmse:.2f}"),
        Column("95 %, runs", "{rmse_low:.2f} {rmse_high:.2f}"),
        Column("of the height alone, km", "{left:.2f}"),
    )
    return Table("Aircraft at 10 km, errors on the ground", columns, rows)
