"""A small sky of which the radar is told nothing: aircraft come, go and meet."""

from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario

BORN_S, GONE_S = 8.0, 16.0  # of the one that comes and of the one that goes


def small_sky(*settings: str) -> Scenario:
    """Two aircraft from the start, of which one goes; a third comes."""
    scenario = load("smoke", ["radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2", *settings])
    kept, other = scenario.simulated.targets
    targets = [
        kept,
        other.model_copy(update={"gone_s": GONE_S}),
        other.model_copy(update={"state": [30.0, 0.1, 5.0, 0.05], "born_s": BORN_S}),
    ]
    world = scenario.simulated.model_copy(update={"targets": targets})
    return scenario.model_copy(update={"world": world})


def crossing_start(dwells: int) -> RunStart:
    """Two aircraft whose directions cross in the fifteenth dwell, some kilometres apart in range: in one main lobe."""
    sky = small_sky()
    first, *_ = sky.simulated.targets
    states = [first.model_copy(update={"state": state}) for state in ([50.0, 0.0, -3.0, 0.2], [54.0, 0.0, 3.0, -0.2])]
    crossing = sky.model_copy(update={"world": sky.simulated.model_copy(update={"targets": states})})
    return RunStart.of(crossing, Strategy.POWER_AWARE, 1, dwells).model_copy(update={"run": "r"})


def sky_start(*settings: str, dwells: int = 30, seed: int = 1, strategy: Strategy = Strategy.POWER_AWARE) -> RunStart:
    """A run of it."""
    return RunStart.of(small_sky(*settings), strategy, seed, dwells).model_copy(update={"run": "r"})
