"""cogradar in Python: load a scenario, play it, ask about runs; names, shapes and units of what comes back.

The whole public face is named here. What lives in `services` and `shared` may change with any version.
"""

import services  # noqa: F401 - fixes the linear-algebra thread count before NumPy is imported
from cogradar.api import Runs, connect, load, open, run  # noqa: A004 - read as cogradar.open
from services.analysis.run_arrays import Result
from services.errors import BadInput, NoMetrics, RunFailed
from services.errors import Failure as CogradarError
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario

__all__ = [
    "BadInput",
    "CogradarError",
    "NoMetrics",
    "Result",
    "RunFailed",
    "Runs",
    "Scenario",
    "Strategy",
    "connect",
    "load",
    "open",
    "run",
]
