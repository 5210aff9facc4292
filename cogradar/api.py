"""What `import cogradar` offers. Lengths are in km, velocities in km/s, times in dwells; in questions targets count
from 1, as in the paper.
"""

import logging
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from services.errors import BadInput
from shared.protocol.messages import RunStart
from shared.scenario.faults import explain
from shared.scenario.files import ScenarioError
from shared.scenario.files import load as load_file
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario
from shared.scoring.errors import position_error, rmse, velocity_error, wilson_interval

log = logging.getLogger("cogradar")

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Rows = list[dict[str, Any]]
_SCORES = "x_hat, vx_hat, y_hat, vy_hat, bin, share, detected, x, vx, y, vy, true_bin, snr_db"


@dataclass(frozen=True, eq=False)
class Result:
    """A finished run. T dwells, M targets; row i of an array is dwell t = i + 1, column m the target and its track.

    The truth is None where the scenario has no [world]; what is computed from it then raises BadInput.
    """

    scenario: Scenario
    strategy: Strategy
    seed: int
    acquisition_scans: int  # scans before dwell 1
    digest: str  # SHA-256 over all scans, plans and waveforms: equal for equal scenario, strategy, seed and dwells
    estimates: Floats  # (T, M, 4) mean of the belief after the dwell's scan, [x, vx, y, vy], km and km/s
    bins: Ints  # (T, M) angle bin that the track asked for
    shares: Floats  # (T, M) power on the track's beam, linear
    detections: Bools  # (T, M) the cell of the true bin (without truth: of the bin asked for) was over the threshold
    truth: Floats | None  # (T, M, 4) state of the target, [x, vx, y, vy], km and km/s
    true_bins: Ints | None  # (T, M) angle bin that the target was in
    snr_db: Floats | None  # (T, M) signal-to-noise ratio per virtual channel, before array gain

    @property
    def p_d(self) -> Floats:
        """Share of the dwells in which a target was detected, (M,)."""
        self._known_truth()
        return np.asarray(self.detections.mean(axis=0))

    @property
    def p_d_interval(self) -> Floats:
        """Wilson's 95 % interval of `p_d`, (M, 2): low and high. It takes dwells as independent; they are not quite."""
        self._known_truth()
        hits = self.detections.sum(axis=0)
        return np.stack(wilson_interval(hits, np.full(hits.shape, len(self.detections))), axis=-1)

    @property
    def position_rmse_km(self) -> Floats:
        """Root mean squared distance between estimate and truth over the dwells, (M,), km."""
        return rmse(position_error(self.estimates, self._known_truth()))

    @property
    def velocity_rmse_km_s(self) -> Floats:
        """Root mean squared error of the velocity over the dwells, (M,), km/s."""
        return rmse(velocity_error(self.estimates, self._known_truth()))

    def _known_truth(self) -> Floats:
        if self.truth is None:
            raise BadInput(f"{self.scenario.name}: there is no truth to compare with")
        return self.truth


class Which(TypedDict, total=False):
    """Which rows are asked for."""

    run: str  # name of one run, or "all"; if left out the newest, of the strategy if one is given
    target: int  # counted from 1
    strategy: str
    dwells: tuple[int, int]  # the first and the last


class Runs:
    """Runs of a store or of a metrics service, and what can be asked about them; rows as `cogradar query --json` has.

    A question that makes no sense raises BadInput; NoMetrics if nobody answers.
    """

    def __init__(self, ask: Callable[[str, dict[str, str]], Rows]) -> None:
        self._ask = ask

    def runs(self, **which: Unpack[Which]) -> Rows:
        """A row per run: what was asked for, how far it has come, how it ended; takes `run` and `strategy` only."""
        return self._asked("runs", which)

    def tracks(self, **which: Unpack[Which]) -> Rows:
        """A row per dwell and target: true state x, vx, y, vy; estimate x_hat ...; bins, SNR, share of the power."""
        return self._asked("tracks", which)

    def p_d(self, **which: Unpack[Which]) -> Rows:
        """A row per strategy and target: detection probability with Wilson's 95 % interval."""
        return self._asked("p_d", which)

    def rmse(self, **which: Unpack[Which]) -> Rows:
        """A row per strategy and target: root mean squared errors of position (km) and velocity (km/s)."""
        return self._asked("rmse", which)

    def summary(self, **which: Unpack[Which]) -> Rows:
        """A row per run and target: P_D, errors, bin hits, mean SNR and power, what came late, whether it was lost."""
        return self._asked("summary", which)

    def _asked(self, metric: str, which: Which) -> Rows:
        parameters = {key: str(value) for key, value in which.items()}
        if "dwells" in which:
            parameters["dwells"] = "{}:{}".format(*which["dwells"])
        return self._ask(metric, parameters)


def load(name_or_path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """A scenario: the name of a built-in one, or the path of a TOML file. Raises BadInput if it cannot be used.

    settings : of `--set`: "radar.array.n_tx=32", "world.targets.2.state=[60.0, 0.2, 7.5, 0.1]"
    """
    try:
        return load_file(str(name_or_path), settings)
    except ScenarioError as error:
        raise BadInput(str(error)) from None


def run(
    scenario: Scenario | str | Path,
    strategy: str = Strategy.POWER_AWARE,
    seed: int = 1,
    dwells: int | None = None,
    planners: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> Result:
    """Play one run in this process, as `cogradar run --in-process` does: the same digest for the same arguments.

    scenario : a Scenario, or what `load` takes
    strategy : "orthogonal", "uniform" or "power-aware"
    seed     : of all that is random, 0 .. 2^63 - 1
    dwells   : tracking dwells, the scenario's number if left out
    planners : how many share the tracks; they take turns, and the result is the same for any number
    progress : called some four times a second with the dwells done and those to do

    Raises BadInput for arguments that make no sense, RunFailed if the run does not reach its end. The first call after
    an installation compiles for about a minute, and logs that.
    """
    from services import kernels
    from services.metrics.store import in_memory
    from services.runs import in_process
    from services.runs.run import Progress

    loaded = scenario if isinstance(scenario, Scenario) else load(scenario)
    if strategy not in set(Strategy):
        raise BadInput(f"strategy = {strategy!r}: must be one of {', '.join(Strategy)}")
    if planners < 1:
        raise BadInput(f"planners = {planners}: must be at least 1")
    try:
        start = RunStart.of(loaded, Strategy(strategy), operator.index(seed), dwells)
    except ValidationError as error:
        raise BadInput(explain(error, RunStart)) from None
    kernels.compile_all(log.warning)

    def report(now: Progress) -> None:
        if progress is not None:
            progress(now.t, now.dwells)

    store = in_memory()
    played = in_process.play(start, planners=planners, store=store, report=report).run
    rows = store.read(f"SELECT {_SCORES} FROM score WHERE run = ? ORDER BY t, target", [start.run])
    table = np.array([tuple(row.values()) for row in rows], dtype=np.float64)  # NaN: unknown
    table = table.reshape(start.dwells, loaded.radar.tracks, -1)
    is_known = loaded.world is not None
    return Result(
        scenario=loaded,
        strategy=start.strategy,
        seed=start.seed,
        acquisition_scans=played["acquisition_scans"],
        digest=played["digest"],
        estimates=table[..., :4],
        bins=table[..., 4].astype(np.int64),
        shares=table[..., 5],
        detections=table[..., 6].astype(np.bool_),
        truth=table[..., 7:11] if is_known else None,
        true_bins=table[..., 11].astype(np.int64) if is_known else None,
        snr_db=table[..., 12] if is_known else None,
    )


def connect(endpoint: str = "tcp/127.0.0.1:7447") -> Runs:
    """Runs of the metrics service behind the Zenoh router at an endpoint; one session per question."""
    from services.metrics.client import ask_service

    return Runs(partial(ask_service, endpoint))


def open_store(file: str | Path) -> Runs:
    """Runs of a store file, as `cogradar run --store` and `campaign` write it. Raises BadInput if it is none."""
    from services.metrics import client

    client.open_store(str(file)).close()
    return Runs(partial(client.ask_store, str(file)))
