"""What is played: small skies that are over in some dwells, in which all that a run can meet happens.

They are small so that a schedule costs some milliseconds; a large sky would run the same code.
"""

from functools import cache

from cogradar.services.simulation.schedule import DWELLS, Schedule
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.world_config import TargetSection

_SMALL = ("radar.belief.n_particle=60", "radar.planner.n_sim=20", "radar.belief.max_tries=20")


def starts_of(schedule: Schedule) -> list[RunStart]:
    """The runs of a schedule, each with a world of its own."""
    seeds = [schedule.run_seed + i for i in range(schedule.runs)]
    return [start_of(schedule.sky, seed, schedule.rate_hz, schedule.dwells) for seed in seeds]


@cache
def start_of(sky: str, seed: int, rate_hz: float, dwells: int = DWELLS) -> RunStart:
    """A run of a sky, always of the same name: owners of tracks depend on it."""
    start = RunStart.of(_scenario(sky), Strategy.POWER_AWARE, seed, dwells, rate_hz)
    return start.model_copy(update={"run": f"{sky}-{seed}"})


@cache
def _scenario(sky: str) -> Scenario:
    """Two aircraft that are announced, or three that are not: one leaves, one comes, and two meet."""
    if sky == "known":
        return load("smoke", _SMALL)
    scenario = load("smoke", [*_SMALL, "radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2"])
    kept, other = scenario.simulated.targets
    targets = [
        kept,
        other.model_copy(update={"gone_s": 7.0}),
        TargetSection(state=[40.5, 0.05, -29.0, -0.2], born_s=3.0),
    ]
    return scenario.model_copy(update={"world": scenario.simulated.model_copy(update={"targets": targets})})
