"""Scenarios with some settings changed."""

from typing import Any

from cogradar.shared.scenario.files import parse
from cogradar.shared.scenario.scenario import Scenario


def varied(scenario: Scenario, world: dict[str, Any] | None = None, **radar: dict[str, Any]) -> Scenario:
    """The scenario with these keys of tables of [radar] and these tables or lists of [world] changed."""
    document = scenario.model_dump()
    for section, keys in radar.items():
        document["radar"][section] |= keys
    document["world"] |= world or {}
    return parse(document, source="varied")
