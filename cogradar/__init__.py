"""cogradar in Python: load a scenario, play it, ask about runs; names, shapes and units of what comes back.

The whole public face is named here. What lives in `services` and `shared` may change with any version.
"""

import services  # noqa: F401 - fixes the linear-algebra thread count before NumPy is imported
from cogradar.api import Result, Runs, connect, load, run
from cogradar.api import open_store as open  # noqa: A004 - read as cogradar.open, as gzip.open is
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
