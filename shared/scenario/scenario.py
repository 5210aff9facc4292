"""A whole scenario: everything that defines a run except its seed and strategy."""

from typing import Annotated, Any

from pydantic import Field, model_validator

from cogradar.shared.scenario.cross_checks import at_start
from cogradar.shared.scenario.document import NAME, NAME_IN_WORDS
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.section import Section
from cogradar.shared.scenario.tables import TRUE_RULES, marked
from cogradar.shared.scenario.world_config import WorldConfig

MAX_TITLE = 200  # characters

# What nature does where the file says nothing of it: as the radar assumes.
_ASSUMED = (("motion", "sigma_s_km_s2"), ("echo", "amplitude_db"))


class Scenario(Section):
    """A whole scenario file."""

    name: Annotated[str, Field(pattern=NAME, description=NAME_IN_WORDS)]
    title: Annotated[str, Field(max_length=MAX_TITLE, description="one line for people")]
    dwells: Annotated[int, Field(ge=1, le=1_000_000)]
    radar: RadarConfig
    world: WorldConfig | None = None  # None: a real front end, whose truth nobody knows

    @property
    def simulated(self) -> WorldConfig:
        """The world of a simulated front end; ValueError for a real one, whose world nobody knows."""
        if self.world is None:
            raise ValueError(f"{self.name} has no [world]")
        return self.world

    @property
    def n_target(self) -> int:
        """Targets of the world, whenever they are there; where nobody knows them, the tracks that are announced."""
        if self.world is not None:
            return len(self.world.targets)
        return self.radar.announced

    @property
    def starting(self) -> dict[int, list[float]]:
        """Index and state of the targets that are there when a run begins: those that the radar acquires."""
        return at_start([vars(target) for target in self.world.targets]) if self.world is not None else {}

    @model_validator(mode="before")
    @classmethod
    def _fill_from_assumptions(cls, data: Any) -> Any:
        match data:
            case {"world": dict(world), "radar": dict(radar)}:
                filled = dict(world)
                for section, key in _ASSUMED:
                    assumed = radar.get(section)
                    if section not in filled and isinstance(assumed, dict) and key in assumed:
                        filled[section] = {key: assumed[key]}
                return data | {"world": filled}
        return data

    @model_validator(mode="before")
    @classmethod
    def _say_who_knows_the_truth(cls, data: Any) -> Any:
        match data:
            case {"title": str(title), "radar": {"planner": {"rule": str(rule)}}} if rule in TRUE_RULES:
                return data | {"title": marked(title, rule, MAX_TITLE)}
        return data
