"""Tracker models that the tests begin with."""

import tomllib
from dataclasses import replace
from typing import Any

from shared.scenario.files import SCENARIO_DIR, load, parse
from shared.scenario.radar_config import RadarConfig, Strategy
from shared.tracking.model import TrackerModel
from tests.shared.tracking.scans import SEED


def paper_model(**belief: Any) -> TrackerModel:
    """Of the paper's radar with some settings of the belief changed."""
    model = TrackerModel.of(load("paper").radar, Strategy.POWER_AWARE, seed=5)
    return replace(model, belief=model.belief.model_copy(update=belief))


def smoke_radar(fidelity: str, **belief: Any) -> RadarConfig:
    """The small scenario's radar with all that a fidelity stands for, some settings of the belief changed."""
    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    document["radar"] |= {"fidelity": fidelity, "belief": document["radar"]["belief"] | belief}
    return parse(document, source="smoke").radar


def smoke_model(fidelity: str, strategy: Strategy = Strategy.UNIFORM, **belief: Any) -> TrackerModel:
    """Of that radar."""
    return TrackerModel.of(smoke_radar(fidelity, **belief), strategy, SEED)
