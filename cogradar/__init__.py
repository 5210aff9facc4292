"""cogradar in Python: load a scenario, play it, ask about runs.

    import cogradar

    result = cogradar.run("paper", strategy="power-aware", seed=1)    # plays it here
    result.truth, result.estimates       # (dwells, targets, 4) of [x, vx, y, vy], km and km/s
    result.p_d, result.position_rmse_km  # (targets,)
    runs = cogradar.open("runs.db")      # a store; cogradar.connect("tcp/HOST:7447"): services that are up
    runs.summary(run="all"), runs.tracks(target=2, dwells="1:20")     # rows, as `cogradar query --json` has them
    runs.result()                        # the newest run as arrays
    cogradar.load("paper", ["radar.array.n_tx=32"])                   # a Scenario with other values, for run()

help(cogradar.run), help(cogradar.Result) and so on say more. Whatever goes wrong is a CogradarError: BadInput,
RunFailed or NoMetrics. What lives in `services` and `shared` may change with any version.
"""

import services  # noqa: F401 - fixes the linear-algebra thread count before NumPy is imported
from cogradar.api import Runs, connect, load, open, run  # noqa: A004 - read as cogradar.open
from services.analysis.run_arrays import Result
from services.errors import BadInput as BadInput
from services.errors import Failure
from services.errors import NoMetrics as NoMetrics
from services.errors import RunFailed as RunFailed
from shared.scenario.radar_config import Strategy as Strategy
from shared.scenario.scenario import Scenario as Scenario

CogradarError = Failure

# What help(cogradar) lists; of errors, Strategy and Scenario it would show mostly what Python and pydantic put there.
__all__ = ["Result", "Runs", "connect", "load", "open", "run"]
