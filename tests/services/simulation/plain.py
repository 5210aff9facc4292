"""A schedule of one run in lockstep, with two planners and no fault."""

from dataclasses import replace
from typing import Any

from cogradar.services.simulation.schedule import Fault, Schedule
from cogradar.services.simulation.simulator import Outcome, play

PLAIN = Schedule(
    seed=1,
    sky="known",
    run_seed=1,
    rate_hz=0.0,
    planners=2,
    runs=1,
    checkpoint_dwells=4,
    snapshot_dwells=4,
    prepares=False,
    faults=(),
)


def played(*faults: Fault, **changed: Any) -> Outcome:
    """What becomes of it under these faults, with some of it changed."""
    return play(replace(PLAIN, faults=faults, **changed))
