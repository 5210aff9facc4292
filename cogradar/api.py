"""What `import cogradar` offers. Lengths are in km, velocities in km/s, times in dwells; in questions targets count
from 1, as in the paper.
"""

import logging
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack

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

Array = TypeVar("Array", NDArray[np.float64], NDArray[np.bool_])
Rows = list[dict[str, Any]]


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
    estimates: NDArray[np.float64]  # (T, M, 4) mean of the belief after the dwell's scan, [x, vx, y, vy], km and km/s
    bins: NDArray[np.int64]  # (T, M) angle bin that the track asked for
    shares: NDArray[np.float64]  # (T, M) power on the track's beam, linear
    truth: NDArray[np.float64] | None  # (T, M, 4) state of the target, [x, vx, y, vy], km and km/s
    true_bins: NDArray[np.int64] | None  # (T, M) angle bin that the target was in
    detections: NDArray[np.bool_] | None  # (T, M) the cell of the true bin was tested and over the threshold
    snr_db: NDArray[np.float64] | None  # (T, M) signal-to-noise ratio per virtual channel, before array gain

    @property
    def p_d(self) -> NDArray[np.float64]:
        """Share of the dwells in which a target was detected, (M,)."""
        return np.asarray(self._known(self.detections).mean(axis=0))

    @property
    def p_d_interval(self) -> NDArray[np.float64]:
        """Wilson's 95 % interval of `p_d`, (M, 2): low and high. It takes dwells as independent; they are not quite."""
        detections = self._known(self.detections)
        hits = detections.sum(axis=0)
        return np.stack(wilson_interval(hits, np.full(hits.shape, len(detections))), axis=-1)

    @property
    def position_rmse_km(self) -> NDArray[np.float64]:
        """Root mean squared distance between estimate and truth over the dwells, (M,), km."""
        return rmse(position_error(self.estimates, self._known(self.truth)))

    @property
    def velocity_rmse_km_s(self) -> NDArray[np.float64]:
        """Root mean squared error of the velocity over the dwells, (M,), km/s."""
        return rmse(velocity_error(self.estimates, self._known(self.truth)))

    def _known(self, values: Array | None) -> Array:
        if values is None:
            raise BadInput(f"{self.scenario.name}: there is no truth to compare with")
        return values


class Which(TypedDict, total=False):
    """Which rows are asked for; all of them if nothing is given."""

    run: str  # name of one run
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


def load(name_or_path: str | Path) -> Scenario:
    """A scenario: the name of a built-in one, or the path of a TOML file. Raises BadInput if it cannot be used."""
    try:
        return load_file(str(name_or_path))
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
    from services.analysis.results import read_results
    from services.recorder.journal import Store
    from services.runs import in_process
    from services.runs.run import Progress, start_of

    loaded = scenario if isinstance(scenario, Scenario) else load(scenario)
    if strategy not in set(Strategy):
        raise BadInput(f"strategy = {strategy!r}: must be one of {', '.join(Strategy)}")
    if planners < 1:
        raise BadInput(f"planners = {planners}: must be at least 1")
    try:
        start = start_of(loaded, Strategy(strategy), operator.index(seed), dwells)
    except ValidationError as error:
        raise BadInput(explain(error, RunStart)) from None
    kernels.compile_all(log.warning)
    store = Store(":memory:")

    def report(now: Progress) -> None:
        if progress is not None:
            progress(now.t, now.dwells)

    done = in_process.play(start, planners=planners, store=store, report=report).run
    played = read_results(store).runs[start.strategy]  # the only one
    return Result(
        loaded,
        start.strategy,
        start.seed,
        acquisition_scans=done["acquisition_scans"],
        digest=done["digest"],
        estimates=played.estimate[0],
        bins=played.bin[0],
        shares=played.share[0],
        truth=played.truth[0],
        true_bins=played.true_bin[0],
        detections=played.detected[0],
        snr_db=played.snr_db[0],
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
