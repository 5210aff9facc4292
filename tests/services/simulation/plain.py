"""A schedule of one run in lockstep, with two planners and no fault."""

from cogradar.services.simulation.schedule import Schedule

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
