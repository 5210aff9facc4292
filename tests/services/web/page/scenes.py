"""Runs that show what a page must show: a track that is lost and found again, and a hundred targets."""

import math

from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load, parse
from cogradar.shared.scenario.radar_config import Strategy
from tests.scenarios import varied

WANDERING_DWELLS = 190  # a run that is played by hand has no more, with its acquisition
HUNDRED_DWELLS = 70
N_BIN = 256


def wandering(dwells: int) -> RunStart:
    """Target 2 manoeuvres more than the radar believes: it is lost after some 125 dwells, and found after 148."""
    scenario = load("smoke", ["radar.fidelity=paper", "world.motion.sigma_s_km_s2=0.08"])
    return RunStart.of(scenario, Strategy.UNIFORM, 4, dwells)


def hundred(dwells: int) -> RunStart:
    """A hundred targets, each in a bin of its own, that stand at 30 to 90 km."""
    echo = {"amplitude_db": 90.0}
    smoke = varied(load("smoke"), {"echo": echo}, array={"n_tx": 64, "n_rx": 64, "n_bin": N_BIN}, echo=echo)
    document = smoke.model_dump()
    document["name"] = "hundred"
    document["radar"]["tracks"] = 100
    document["radar"]["belief"]["n_particle"] = 200
    document["radar"]["planner"]["n_sim"] = 20
    document["world"]["targets"] = [_standing(28 + 2 * i, 30.0 + (37 * i) % 60) for i in range(100)]
    return RunStart.of(parse(document, source="hundred"), Strategy.POWER_AWARE, 1, dwells)


def _standing(bin_: int, range_km: float) -> dict[str, list[float]]:
    angle = math.asin(2.0 * ((bin_ + 0.5) / N_BIN - 0.5))
    return {"state": [range_km * math.cos(angle), 0.0, range_km * math.sin(angle), 0.0]}
