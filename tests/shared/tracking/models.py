"""Tracker models that the tests begin with."""

import tomllib
from typing import Any

from shared.scenario.files import SCENARIO_DIR, load, parse
from shared.scenario.radar_config import RadarConfig, Strategy
from shared.tracking.model import TrackerModel
from shared.tracking.sensor import STEP
from tests.shared.tracking.scans import SEED


def paper_model(**belief: Any) -> TrackerModel:
    """Of the paper's radar with some settings of the belief changed."""
    radar = load("paper").radar
    radar = radar.model_copy(update={"belief": radar.belief.model_copy(update=belief)})
    return TrackerModel.of(radar, Strategy.POWER_AWARE, seed=5)


def in_level(level: int) -> float:
    """An amplitude in the middle of a level."""
    return (level + 0.5) * STEP


def smoke_radar(fidelity: str, **belief: Any) -> RadarConfig:
    """The small scenario's radar with all that a fidelity stands for, some settings of the belief changed."""
    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    document["radar"] |= {"fidelity": fidelity, "belief": document["radar"]["belief"] | belief}
    return parse(document, source="smoke").radar


def smoke_model(fidelity: str, strategy: Strategy = Strategy.UNIFORM, **belief: Any) -> TrackerModel:
    """Of that radar."""
    return TrackerModel.of(smoke_radar(fidelity, **belief), strategy, SEED)
