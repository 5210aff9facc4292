"""cogradar in Python: load a scenario, run it, ask about runs.

    import cogradar

    result = cogradar.run("paper", strategy="power-aware", seed=1)    # runs it here
    result.true_states, result.estimates       # (dwells, targets, 4) of [x, vx, y, vy], km and km/s
    result.p_d, result.position_rmse_km  # (targets,)
    result.detections().to_pandas()      # and tracks(), truth(), waveforms(): tables, a row per thing and dwell
    result.plot.scope(10)                # pictures: scope, track, beampattern
    for dwell in cogradar.play("paper", set={"radar.array.n_tx": 32}): ...    # the same, dwell by dwell
    runs = cogradar.open("runs.db")      # a store; cogradar.connect("tcp/HOST:7447"): services that are up
    runs.summary(run="all"), runs.tracks(target=2, dwells="1:20")     # rows, as `cogradar query --json` has them
    runs.result()                        # the newest run as arrays
    cogradar.load("paper", ["radar.array.n_tx=32"])                   # a Scenario with other values, for run()

help(cogradar.run), help(cogradar.Result) and so on say more. Whatever goes wrong is a CogradarError: BadInput,
RunFailed or NoMetrics. What lives in `cogradar.services` and `cogradar.shared` may change with any version.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# One thread per process for linear algebra: matrices are small, processes are many, and a run's digest must not
# depend on how many cores a reduction was split over. Read by the libraries when NumPy is first imported.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_variable] = "1"

if TYPE_CHECKING:
    from cogradar.api import BadInput as BadInput
    from cogradar.api import CogradarError as CogradarError
    from cogradar.api import Dwell as Dwell
    from cogradar.api import NoMetrics as NoMetrics
    from cogradar.api import Player as Player
    from cogradar.api import Records as Records
    from cogradar.api import Result as Result
    from cogradar.api import RunFailed as RunFailed
    from cogradar.api import Runs as Runs
    from cogradar.api import Scenario as Scenario
    from cogradar.api import Strategy as Strategy
    from cogradar.api import connect as connect
    from cogradar.api import load as load
    from cogradar.api import open as open  # noqa: A004 - read as cogradar.open
    from cogradar.api import play as play
    from cogradar.api import run as run

# What help(cogradar) lists; of errors, Strategy and Scenario it would show mostly what Python and pydantic put there.
__all__ = ["Player", "Result", "Runs", "connect", "load", "open", "play", "run"]
_OTHERS = ("BadInput", "CogradarError", "Dwell", "NoMetrics", "Records", "RunFailed", "Scenario", "Strategy")


def __getattr__(name: str) -> Any:
    """Load `cogradar.api` when it is first used: each process imports this package, few need the public interface."""
    if name not in __all__ and name not in _OTHERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module("cogradar.api"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_OTHERS})
